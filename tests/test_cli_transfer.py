"""The commands of style transfer: results on the content's own terms, and bad input as one line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.motion.bvh import read_bvh, read_whole, write_bvh
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.reading import ReadOptions
from pfnn_jax.run_config import check_finished
from pfnn_jax.transfer.config import OptimisationConfig, TransformationTrainingConfig
from pfnn_jax.transfer.finish import MAX_STRENGTH
from pfnn_jax.transfer.run import list_transformations, load_transfer_run
from pfnn_jax.workflows import transfer as workflow
from pfnn_jax.workflows.samples import sample_clips
from pfnn_jax.workflows.transfer import transfer_clip
from pfnn_jax.workflows.transfer_training import train_transfer
from tests.raising import assert_refused
from tests.trained import made_once
from tests.transfer_runs import make_transfer_run, make_walk

DECIMALS = 2e-5  # metres and radians: numbers in a BVH file have 6 decimals, in centimetres and degrees
SHORTEST = 25  # frames at 60 per second: the width of the filters
QUICK = "--epochs 1 --batch-size 4".split()


def run(*words: object) -> None:
    main([str(word) for word in words])


@pytest.fixture
def refused(capsys) -> Callable[..., str]:
    """Runs a command that must end with exit code 2 and one line on standard error; returns the line."""

    def check(*words: object) -> str:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            run(*words)
        assert stopped.value.code == 2
        lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("transferring:")]
        assert len(lines) == 1 and lines[0].startswith("pfnn-jax: "), lines
        return lines[0]

    return check


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `run` (one style, `old`), `walk.bvh`, `old.bvh`, and `clips` of two styles."""

    def make(folder: Path) -> None:
        make_transfer_run(folder)
        make_walk(folder / "walk.bvh")
        make_walk(folder / "old.bvh", "old", speed=0.8)
        for style in ("neutral", "old"):
            (folder / "clips" / style).mkdir(parents=True)
            make_walk(folder / "clips" / style / "walk.bvh", style, seconds=5.0, speed=1.0)
        run("train-transfer", folder / "clips", "--style", "old", "--out", folder / "run", *QUICK)

    return made_once(tmp_path_factory, "transfer", make)


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, empty but for what the test writes."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def few_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few iterations: whether the style is taken is tested elsewhere."""
    quick = OptimisationConfig(iterations=3, constraint_iterations=2)
    monkeypatch.setattr(workflow, "OptimisationConfig", lambda: quick)


def transferred(made: Path, content: Path, *words: object) -> MotionClip:
    """Returns the clip that the command writes with the small run, whose networks move nobody as a person would."""
    run("transfer", content, "--run", made / "run", "--out", "out.bvh", "--overwrite", *words)
    return read_whole(Path("out.bvh"), ReadOptions(up="y"))


def assert_same_motion(clip: MotionClip, other: MotionClip) -> None:
    assert clip.skeleton.names == other.skeleton.names and clip.fps == pytest.approx(other.fps)
    np.testing.assert_allclose(clip.root_positions, other.root_positions, atol=DECIMALS)
    same = np.abs(np.sum(clip.rotations * other.rotations, axis=-1))
    np.testing.assert_allclose(same, 1.0, atol=DECIMALS)


@pytest.mark.parametrize("how", [["--style", "old"], [], ["--style", "CLIP"]], ids=["network", "only style", "clip"])
@pytest.mark.parametrize("sample", ["walk", *sample_clips()])
def test_the_result_has_the_contents_skeleton_rate_and_unit(made, folder, how, sample):
    content = made / "walk.bvh" if sample == "walk" else sample_clips()[sample]
    result = transferred(made, content, *[word.replace("CLIP", str(made / "old.bvh")) for word in how])
    own = read_bvh(content)
    assert result.reading is not None and own.reading is not None
    assert result.skeleton.names == own.skeleton.names
    np.testing.assert_allclose(result.skeleton.offsets, own.skeleton.offsets, atol=DECIMALS)
    assert (result.num_frames, result.reading.unit) == (own.num_frames, own.reading.unit)
    assert result.fps == pytest.approx(own.fps)
    assert np.isfinite(result.root_positions).all() and np.isfinite(result.rotations).all()


def test_without_strength_the_content_is_unchanged(made, folder):
    content = made / "walk.bvh"
    assert_same_motion(transferred(made, content, "--strength", 0), read_bvh(content))


def test_only_the_chosen_parts_change(made, folder):
    own = read_bvh(made / "walk.bvh")
    arms = transferred(made, made / "walk.bvh", "--parts", "arms", "--no-foot-ik")
    legs = [own.skeleton.names.index(name) for name in own.skeleton.names if "Leg" in name or "Foot" in name]
    np.testing.assert_allclose(arms.root_positions, own.root_positions, atol=DECIMALS)
    same = np.abs(np.sum(arms.rotations[:, legs] * own.rotations[:, legs], axis=-1))
    np.testing.assert_allclose(same, 1.0, atol=DECIMALS)


def test_the_same_command_writes_the_same_file(made, folder):
    words = ("transfer", made / "walk.bvh", "--style", made / "old.bvh", "--run", made / "run")
    run(*words, "--out", "a.bvh")
    run(*words, "--out", "b.bvh")
    assert (folder / "a.bvh").read_bytes() == (folder / "b.bvh").read_bytes()


def test_notes_are_printed_and_written(made, folder, capsys):
    content = sample_clips()["ape"]
    run("transfer", content, "--run", made / "run", "--out", "out.bvh", "--json", "out.json")
    notes = json.loads((folder / "out.json").read_text())["notes"]
    printed = capsys.readouterr().out
    assert all(f"note: {note}\n" in printed for note in notes)


def test_several_style_clips_are_taken(made, folder):
    clips = [made / "old.bvh", made / "clips" / "old" / "walk.bvh"]
    assert transferred(made, made / "walk.bvh", "--style", *clips).num_frames == 120


def test_a_run_takes_a_second_style_and_keeps_the_first(made, folder):
    shutil.copytree(made / "run", "run")
    run("train-transfer", made / "clips", "--style", "neutral", "--out", "run", *QUICK)
    assert list_transformations("run") == ("neutral", "old")
    assert load_transfer_run("run").fingerprint == load_transfer_run(made / "run").fingerprint


BAD_OPTIONS = {
    "neither style nor run": (["WALK"], "style"),
    "a name without a run": (["WALK", "--style", "old"], "style"),
    "names and clips": (["WALK", "--run", "RUN", "--style", "old", "OLD"], "style"),
    "several names": (["WALK", "--run", "RUN", "--style", "old", "older"], "style"),
    "a style never trained": (["WALK", "--run", "RUN", "--style", "proud"], "style"),
    "strength too large": (["WALK", "--run", "RUN", "--strength", 1.51], "strength"),
    "strength negative": (["WALK", "--run", "RUN", "--strength=-0.1"], "strength"),
    "strength no number": (["WALK", "--run", "RUN", "--strength", "nan"], "strength"),
    "the content as style": (["WALK", "--run", "RUN", "--style", "WALK"], "style"),
    "a copy of the content as style": (["WALK", "--run", "RUN", "--style", "COPY"], "style"),
    "a content too short": (["SHORT", "--run", "RUN"], "length"),
    "a style too short": (["WALK", "--run", "RUN", "--style", "SHORT"], "length"),
    "a content that is not finite": (["NAN", "--run", "RUN"], "line"),
    "an absent content": (["ABSENT", "--run", "RUN"], "file"),
    "an absent run": (["WALK", "--run", "ABSENT"], "ABSENT"),
    "a run of a controller": (["WALK", "--run", "CONTROLLER"], "kind"),
    "a run without styles": (["WALK", "--run", "BARE"], "style"),
}


@pytest.mark.parametrize(("words", "place"), BAD_OPTIONS.values(), ids=BAD_OPTIONS)
def test_bad_input_is_one_line_and_writes_nothing(made, folder, refused, tmp_path_factory, words, place):
    from pfnn_jax.workflows.base import BASE_NETWORK

    inputs = tmp_path_factory.mktemp("inputs")
    walk = read_bvh(made / "walk.bvh")
    write_bvh(inputs / "short.bvh", cut(walk, 0, SHORTEST - 1))
    (inputs / "copy.bvh").write_bytes((made / "walk.bvh").read_bytes())
    text = (made / "walk.bvh").read_text().splitlines()
    (inputs / "nan.bvh").write_text("\n".join([*text[:-1], text[-1].replace(text[-1].split()[4], "nan", 1)]))
    paths = {"WALK": made / "walk.bvh", "OLD": made / "old.bvh", "RUN": made / "run", "BARE": made / "bare"}
    paths |= {"SHORT": inputs / "short.bvh", "COPY": inputs / "copy.bvh", "NAN": inputs / "nan.bvh"}
    paths |= {"CONTROLLER": BASE_NETWORK, "ABSENT": inputs / "absent"}
    line = refused("transfer", *[paths.get(str(word), word) for word in words], "--out", "out.bvh")
    assert place.lower() in line.lower()
    assert list(folder.iterdir()) == []


def test_an_output_that_exists_is_kept(made, folder, refused):
    (folder / "out.bvh").write_text("mine")
    assert "--overwrite" in refused("transfer", made / "walk.bvh", "--run", made / "run", "--out", "out.bvh")
    assert (folder / "out.bvh").read_text() == "mine"


@pytest.mark.parametrize(
    "words", [("generate", "--out", "walk.bvh"), ("few-shot", "clip.bvh", "--name", "a"), ("play",)]
)
def test_commands_of_a_controller_refuse_a_run_of_style_transfer(made, folder, refused, words):
    command, *options = words
    assert "style transfer" in refused(command, made / "run", *options)
    assert_refused(partial(check_finished, made / "run"), file="config.json", place="kind", value="transfer")


BAD_TRAINING = {
    "a style that the data do not have": (["CLIPS", "--style", "proud", "--out", "new"], "must be one of neutral, old"),
    "data of one style": (["ONE", "--style", "old", "--out", "new"], "another style"),
    "a style that exists": (["CLIPS", "--style", "old", "--out", "RUN"], "--overwrite"),
    "a run of a controller": (["CLIPS", "--style", "old", "--out", "CONTROLLER"], "kind: controller"),
    "an autoencoder of a controller": (
        ["CLIPS", "--style", "old", "--out", "new", "--autoencoder", "CONTROLLER"],
        "kind",
    ),
    "no data": (["ABSENT", "--style", "old", "--out", "new"], "absent"),
    "another autoencoder": (["CLIPS", "--style", "neutral", "--out", "RUN", "--autoencoder", "OTHER"], "autoencoder"),
}


@pytest.mark.parametrize(("words", "says"), BAD_TRAINING.values(), ids=BAD_TRAINING)
def test_bad_training_input_is_one_line_and_writes_nothing(made, folder, refused, tmp_path_factory, words, says):
    from pfnn_jax.transfer.run import BASE_AUTOENCODER
    from pfnn_jax.workflows.base import BASE_NETWORK

    inputs = tmp_path_factory.mktemp("one")
    (inputs / "old").mkdir()
    make_walk(inputs / "old" / "walk.bvh", "old")
    paths = {"CLIPS": made / "clips", "RUN": made / "run", "ONE": inputs, "ABSENT": folder / "absent"}
    paths |= {"CONTROLLER": BASE_NETWORK, "OTHER": BASE_AUTOENCODER}
    before = list_transformations(made / "run")
    assert says in refused("train-transfer", *[paths.get(word, word) for word in words], *QUICK)
    assert list(folder.iterdir()) == [] and list_transformations(made / "run") == before


def test_refusals_name_file_place_and_value(made, tmp_path):
    walk, old, run_path = read_bvh(made / "walk.bvh"), read_bvh(made / "old.bvh"), made / "run"
    short = cut(walk, 0, SHORTEST - 1)
    quick = partial(transfer_clip, run=run_path)
    assert_refused(lambda: quick(short), file="walk.bvh", place="length", value="24 frames at 60 per second")
    assert_refused(lambda: quick(walk, short), file="walk.bvh", place="length")
    assert_refused(lambda: quick(walk, walk), file="walk.bvh", place="style", rule_mentions="same motion")
    assert_refused(lambda: quick(walk, [old, walk]), file="walk.bvh", place="style")
    assert_refused(lambda: quick(walk, strength=1.6), place="strength", value=1.6, rule_mentions=f"{MAX_STRENGTH:g}")
    assert_refused(lambda: quick(walk, parts="tail"), place="parts", value="tail", rule_mentions="arms")  # type: ignore[arg-type]
    assert_refused(
        lambda: quick(walk, style_name="proud"), file="run", place="style", value="proud", rule_mentions="old"
    )
    assert_refused(lambda: quick(walk, old, style_name="old"), place="style_name")
    assert_refused(lambda: quick(walk, []), place="style", value="no clips")
    assert_refused(lambda: transfer_clip(walk, run=made / "bare"), file="bare", place="style", rule_mentions="trained")
    for name in ("root_positions", "rotations"):
        broken = replace(walk, **{name: getattr(walk, name).copy()})
        getattr(broken, name)[7] = np.nan
        assert_refused(lambda clip=broken: quick(clip), file="walk.bvh", place="frame 7")
    train = partial(train_transfer, made / "clips")
    assert_refused(lambda: train("proud", tmp_path / "new"), file="clips", place="style", value="proud")
    assert_refused(lambda: train("old", run_path), file="old", place="output", value="exists")


def test_the_shortest_clip_is_a_filter_long(made):
    walk = cut(read_bvh(made / "walk.bvh"), 0, SHORTEST)
    assert transfer_clip(walk, run=made / "run").clip.num_frames == SHORTEST
    assert transfer_clip(read_bvh(made / "old.bvh"), walk, run=made / "run").clip.num_frames == 120


def test_a_long_clip_is_done_in_pieces_of_bounded_size(made, monkeypatch):
    from pfnn_jax.transfer.pieces import PIECE

    lengths: list[int] = []
    applied = workflow.apply_network

    def apply(run, network, rows, **options):
        lengths.append(len(rows))
        return applied(run, network, rows, **options)

    monkeypatch.setattr(workflow, "apply_network", apply)
    walk = read_bvh(made / "walk.bvh")
    times = PIECE // walk.num_frames + 1
    long = replace(
        walk, root_positions=np.tile(walk.root_positions, (times, 1)), rotations=np.tile(walk.rotations, (times, 1, 1))
    )
    result = transfer_clip(long, run=made / "run").clip
    assert result.num_frames == long.num_frames and max(lengths) == PIECE and len(lengths) == 2
    assert np.isfinite(result.root_positions).all()


def test_style_clips_are_paired_by_gait_and_this_is_said(made, tmp_path):
    walk = read_bvh(made / "walk.bvh")
    old, dash = read_bvh(made / "old.bvh"), read_bvh(make_walk(tmp_path / "dash.bvh", speed=4.0))
    quick = partial(transfer_clip, walk, run=made / "run")
    alone, both = quick(old), quick([old, dash])
    assert alone.notes == () and len(both.notes) == 1 and "walk.bvh: no label" in both.notes[0]
    np.testing.assert_array_equal(alone.clip.rotations, both.clip.rotations)  # the dash is left out
    (note,) = quick(dash).notes
    assert "is that of a walk" in note and "all of it is used" in note


def test_a_labelled_content_takes_the_clips_of_its_label(made):
    walk, old = (replace(read_bvh(made / name), content="walk") for name in ("walk.bvh", "old.bvh"))
    other = replace(read_bvh(made / "clips" / "old" / "walk.bvh"), content="limp")
    quick = partial(transfer_clip, walk, run=made / "run")
    both = quick([old, other])
    assert both.notes == ()
    np.testing.assert_array_equal(both.clip.rotations, quick(old).clip.rotations)


def test_short_clips_of_the_data_are_left_out_and_named(made, tmp_path):
    shutil.copytree(made / "clips", tmp_path / "clips")
    walk = read_bvh(made / "walk.bvh")
    for name in ("a", "b"):
        write_bvh(tmp_path / "clips" / "neutral" / f"{name}.bvh", cut(walk, 0, SHORTEST - 1))
    quick = TransformationTrainingConfig(epochs=1, batch_size=4)
    info = train_transfer(tmp_path / "clips", "old", tmp_path / "run", quick, autoencoder=made / "bare")
    (note,) = [note for note in info["notes"] if "shorter" in note]
    assert "a.bvh (and 1 more): shorter than a filter" in note and info["contents"] == 1
    assert list_transformations(tmp_path / "run") == ("old",)


def test_a_damaged_note_of_a_style_is_refused(made, tmp_path):
    shutil.copytree(made / "run", tmp_path / "run")
    file = tmp_path / "run" / "styles" / "old" / "style.json"
    note = json.loads(file.read_text())
    del note["info"]["config"]
    file.write_text(json.dumps(note))
    assert_refused(lambda: transfer_clip(made / "walk.bvh", run=tmp_path / "run"), file="style.json", place="config")
