"""From clips to rows on disk: splits, windows, 100STYLE, and the same bytes from any number of processes."""

from __future__ import annotations

import dataclasses
import os
import shutil
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.io.npy import NpyWriter
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.clip_rows import has_hand_ends, labelled_features, load_for_layout
from pfnn_jax.motion.datasets.dataset import Dataset, load_dataset
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.datasets.splits import clip_generator, row_windows, split_blocks
from pfnn_jax.motion.features.layout import mason2022
from pfnn_jax.motion.features.normaliser import NO_ROWS, moments_of
from pfnn_jax.motion.synthetic.walks import mixed_schedule, synthesise
from tests.raising import assert_refused

FLOAT64 = 1e-12  # rounding of sums over some hundred rows
TENTHS = PrepareConfig(layout="mason2022", validation=0.1, test=0.1)


def take(style: str, content: str, seconds: float, seed: int) -> LabelledClip:
    clip, labels = synthesise(style, *mixed_schedule(style, seconds, seed), seed=seed)
    name = f"{style}-{content}-{seed}.bvh"
    return LabelledClip(dataclasses.replace(clip, content=content, source=name), labels)


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@pytest.fixture(scope="module")
def takes() -> list[LabelledClip]:
    """Returns two walks and a transition of one style, and of another a walk longer than two windows."""
    return [take("proud", "walk", 3, 1), take("proud", "walk", 4, 2), take("proud", "transition-1", 3, 3)] + [
        take("angry", "walk", 7, 4)
    ]


@pytest.fixture(scope="module")
def split(takes, tmp_path_factory) -> Dataset:
    return prepare(takes, tmp_path_factory.mktemp("data") / "set", TENTHS)


@pytest.mark.parametrize("count", [1, 7, 100, 1001])
@pytest.mark.parametrize(("validation", "test"), [(0.1, 0.1), (0.3, 0.0), (0.0, 0.45), (0.0, 0.0)])
def test_validation_and_test_rows_are_contiguous_blocks_of_their_share(count, validation, test):
    for seed in range(5):
        parts = split_blocks(count, validation, test, np.random.default_rng(seed))
        for index, share in ((1, validation), (2, test)):
            rows = np.flatnonzero(parts == index)
            assert len(rows) == round(share * count)
            assert len(rows) == 0 or rows[-1] - rows[0] == len(rows) - 1


def test_blocks_lie_at_any_position_in_either_order():
    firsts = [
        [int(np.argmax(split_blocks(100, 0.1, 0.1, np.random.default_rng(seed)) == part)) for part in (1, 2)]
        for seed in range(400)
    ]
    validation, test = np.array(firsts).T
    assert 0.4 < (validation < test).mean() < 0.6
    for first in (validation, test):
        assert first.min() == 0 and first.max() == 90  # 90 places of a block of 10


def test_windows_hold_consecutive_frames():
    np.testing.assert_array_equal(row_windows(np.arange(500)), [[0, 240], [120, 240], [240, 240]])
    broken = np.concatenate([np.arange(100), np.arange(150, 400)])
    np.testing.assert_array_equal(row_windows(broken), [[100, 240]])
    short = np.concatenate([np.arange(50), np.arange(60, 180)])
    np.testing.assert_array_equal(row_windows(short), [[50, 120]])  # the longest run
    assert row_windows(np.arange(0)).shape == (0, 2)


def test_every_row_is_in_one_split_with_its_mirror_image(takes, split, tmp_path):
    whole = prepare(takes, tmp_path / "set", PrepareConfig(layout="mason2022"))
    for style in whole.styles:
        pairs = {name: np.stack(split.sources(style, name), axis=1) for name in split.rows}
        together = np.concatenate(list(pairs.values()))
        order = np.lexsort(together.T[::-1])
        np.testing.assert_array_equal(together[order], np.stack(whole.sources(style), axis=1))
        x = np.concatenate([split.arrays(style, name)[0] for name in split.rows])[order]
        np.testing.assert_array_equal(x, whole.arrays(style)[0])
        for clips, frames in (rows.T for rows in pairs.values()):
            twins = [index for index in np.unique(clips) if split.clips[index]["mirrored"]]
            for index in twins:
                np.testing.assert_array_equal(frames[clips == index], frames[clips == index - 1])


def test_a_tenth_of_every_clip_is_one_block_but_transitions_are_all_training_rows(split):
    transitions = [i for i, clip in enumerate(split.clips) if clip["content"] == "transition-1"]
    assert len(transitions) == 2
    for name in ("validation", "test"):
        for style in split.styles:
            clips, frames = split.sources(style, name)
            for index in np.unique(clips):
                block = frames[clips == index]
                assert len(block) == round(0.1 * (split.clips[index]["frames"] - 2))
                assert (np.diff(block) == 1).all() and index not in transitions


def test_windows_lie_within_one_clip(split):
    for name in split.rows:
        for style in split.styles:
            clips, frames = split.sources(style, name)
            for first, rows in split.windows(style, name):
                assert len(set(clips[first : first + rows])) == 1
                assert frames[first + rows - 1] - frames[first] == rows - 1
            assert set(clips) == {clips[first] for first, _ in split.windows(style, name)}
    assert (split.windows("proud")[:, 1] < 240).sum() == split.takes_without_window["train"]["proud"] == 6
    assert split.windows("proud").dtype == np.int32


def test_the_order_of_clips_changes_no_byte(takes, split, tmp_path):
    prepare(takes[::-1], tmp_path / "reversed", TENTHS)
    assert files_of(tmp_path / "reversed") == files_of(split.path)


def test_blocks_depend_on_the_seed_and_the_name_of_the_clip_only(takes, split, tmp_path):
    other = prepare(takes, tmp_path / "set", dataclasses.replace(TENTHS, seed=1))
    assert (other.sources("angry", "test")[1] != split.sources("angry", "test")[1]).any()
    fewer = prepare(takes[1:], tmp_path / "fewer", TENTHS)
    ours, theirs = (dataset.sources("proud", "test")[1][-40:] for dataset in (split, fewer))
    np.testing.assert_array_equal(ours, theirs)
    assert clip_generator(0, "a", "b").random() != clip_generator(0, "a", "c").random()


def test_a_dataset_holds_what_labelled_features_returns(split):
    written = take("angry", "walk", 7, 4)
    features = labelled_features(written, split.layout, mirror=True)
    clips, frames = split.sources("angry")
    for index, rows in enumerate(features):
        chosen = np.isin(rows.frames, frames[clips == index])
        for found, wanted in zip(split.arrays("angry"), (rows.x, rows.y, rows.phase), strict=True):
            np.testing.assert_array_equal(found[clips == index], wanted[chosen])


def test_100style_as_published(mocap, tmp_path):
    """25 joints, 348 inputs, 342 outputs, 8 local phases; the idle clip is skipped; cuts beyond the end are noted."""
    files = list_clips(mocap / "100style")
    dataset = prepare(files, tmp_path / "set", TENTHS)
    assert (dataset.layout.input_size, dataset.layout.output_size) == (348, 342)
    assert dataset.skeleton.num_joints == 25 and dataset.layout.ends == (16, 11, 24, 20)
    (skipped,) = dataset.skipped
    assert skipped["file"].endswith("Neutral_ID.bvh") and skipped["reason"].startswith("an idle clip")
    assert len(dataset.notes) == 3 and all("1200 frames, its end is used" in note["note"] for note in dataset.notes)
    x, y, phase = dataset.arrays("Angry")
    assert sum(rows["Angry"] for rows in dataset.rows.values()) == 2 * (4407 - 569 - 2)
    assert phase.shape == (len(x), 8) and np.isfinite(phase).all() and len(y) == dataset.frames["Angry"]
    assert dataset.normaliser.phases is not None and len(dataset.normaliser.phases.mean) == 8
    mirrored = [clip["mirrored"] for clip in dataset.clips]
    assert sum(mirrored) == 4 and len(dataset.windows("Angry")) > 20
    assert load_dataset(dataset.path).layout == dataset.layout


def test_a_clip_of_another_skeleton_in_100style_is_refused(mocap, tmp_path):
    folder = tmp_path / "takes"
    folder.mkdir()
    for path in (mocap / "100style").glob("*.csv"):
        shutil.copy(path, folder)
    shutil.copy(mocap / "100style" / "Neutral_FW.bvh", folder / "Neutral_FW.bvh")
    write_bvh(folder / "Old_FW.bvh", take("proud", "walk", 12, 0).clip)
    call = partial(prepare, folder, tmp_path / "set", TENTHS)
    assert_refused(call, file="Old_FW.bvh", place="skeleton", rule_mentions="of 25 joints")
    assert not (tmp_path / "set").exists()


def test_hand_ends_are_joints_only_if_all_clips_have_them(mocap, tmp_path):
    """Four of the Bandai-Namco files have End Sites away from the wrists, the others at them."""
    normal = [clip for clip in list_clips(mocap / "bandai-namco-1") if clip.style == "normal"]
    assert [has_hand_ends(clip) for clip in normal].count(True) == 4
    assert prepare(normal, tmp_path / "all", TENTHS).skeleton.num_joints == 21
    alone = prepare([clip for clip in normal if has_hand_ends(clip)], tmp_path / "four", TENTHS)
    assert alone.skeleton.num_joints == 23
    assert all(has_hand_ends(clip) for clip in list_clips(mocap / "100style"))


def test_clips_without_steps_are_used_if_no_phase_is_needed(mocap):
    """Hops and slides have no phase of a gait cycle, but local phases."""
    idle = next(clip for clip in list_clips(mocap / "100style") if clip.content == "idle")
    labelled = load_for_layout(dataclasses.replace(idle, content="hop"), mason2022())
    assert labelled.clip.skeleton.num_joints == 25 and not labelled.labels.labelled.any()


def test_a_clip_gets_hand_ends_only_if_the_layout_has_them(mocap):
    """A file with hand ends suits a network without them; the opposite case is refused later, by name."""
    normal = next(c for c in list_clips(mocap / "bandai-namco-1") if c.style == "normal" and has_hand_ends(c))
    assert [load_for_layout(normal, mason2022(joints)).clip.skeleton.num_joints for joints in (21, 23)] == [21, 23]


def test_rows_appended_to_a_file_are_the_array(tmp_path):
    rows = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    writer = NpyWriter(tmp_path / "a.npy", np.dtype(np.float32), (3,))
    for part in (rows[:20], rows[20:20], rows[20:]):
        writer.append(part)
    with pytest.raises(ValueError, match="of shape"):
        writer.append(rows[:, :2])
    writer.close()
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy", mmap_mode="r"), rows)
    NpyWriter(tmp_path / "b.npy", np.dtype(np.int32), ()).close()
    assert np.load(tmp_path / "b.npy").shape == (0,)


def test_merged_moments_equal_those_of_all_rows():
    rows = np.random.default_rng(0).normal([0, 1e3, 5], [1, 1e-2, 0], size=(300, 3))
    merged = NO_ROWS
    for part in np.split(rows, [10, 11, 200]):
        merged = merged.merge(moments_of(part))
    np.testing.assert_allclose(merged.mean, rows.mean(axis=0), rtol=FLOAT64)
    np.testing.assert_allclose(merged.rows().std(axis=0), rows.std(axis=0), rtol=1e-9, atol=FLOAT64)
    assert merged.merge(NO_ROWS) is merged and merged.count == 300


SCRIPT = """
import sys
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
print("once")
prepare(sys.argv[1], sys.argv[2], PrepareConfig("mason2022", test=0.1), workers=2)
assert "jax" not in sys.modules
"""


def test_two_processes_started_by_a_script_without_a_guard_change_no_byte(takes, tmp_path):
    """`multiprocessing` would run such a script again in every process."""
    for index, style in enumerate(("calm", "hasty")):
        (tmp_path / "bvh" / style).mkdir(parents=True)
        write_bvh(tmp_path / "bvh" / style / "walk.bvh", takes[index].clip)
    (tmp_path / "script.py").write_text(SCRIPT)
    command = [sys.executable, str(tmp_path / "script.py"), str(tmp_path / "bvh"), str(tmp_path / "set")]
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=env)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["once"]
    alone = prepare(tmp_path / "bvh", tmp_path / "alone", PrepareConfig("mason2022", test=0.1), workers=1)
    assert alone.styles == ("calm", "hasty") and files_of(tmp_path / "set") == files_of(alone.path)


INTERRUPTED = """
import os, signal, sys
from pfnn_jax.motion.datasets.preparation import prepare
prepare(sys.argv[1], sys.argv[2], progress_callback=lambda *event: os.kill(os.getpid(), signal.SIGKILL))
"""


def test_what_a_killed_preparation_leaves_is_removed_by_the_next(takes, tmp_path):
    for index, style in enumerate(("calm", "hasty")):
        (tmp_path / "bvh" / style).mkdir(parents=True)
        write_bvh(tmp_path / "bvh" / style / "walk.bvh", takes[index].clip)
    out = tmp_path / "out" / "set"
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", INTERRUPTED, str(tmp_path / "bvh"), str(out)], timeout=120, env=env)
    assert done.returncode == -signal.SIGKILL
    assert not out.exists() and len(list(out.parent.iterdir())) == 1
    prepare(tmp_path / "bvh", out)
    assert [path.name for path in out.parent.iterdir()] == ["set"]
