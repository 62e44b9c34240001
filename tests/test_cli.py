"""The command as a user has it: every command once, bad input as one line and exit code 2, Ctrl-C at any moment."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from docstring_parser import parse

import pfnn_jax
from pfnn_jax.cli import main
from pfnn_jax.cli.command_line import COMMANDS, in_options, load_command
from pfnn_jax.cli.predict import Predict
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise, synthetic_clips
from pfnn_jax.run import fingerprint, load_run, load_style
from pfnn_jax.run_config import list_styles, style_note, train_step
from pfnn_jax.training.config import FILM_FEW_SHOT, MASON2018_FEW_SHOT, FewShotConfig
from pfnn_jax.workflows.samples import sample_clips
from tests.trained import made_once

SMALL = "--hidden 8 --adapter.rank 3 --steps 30 --batch-size 16 --steps-per-dispatch 10".split()
SOON = 5.0  # processor seconds in which an interrupted command ends: what it began would take more than 20
LONGEST = 120.0  # seconds, on a loaded machine, after which a program counts as hanging

QUICK = "--rank 3 --no-decay --eval-epochs 1 2 --learning-rates 0.001 --main-dropouts 0 --batch-size 16".split()


def run(*words) -> None:
    main([str(word) for word in words])


@pytest.fixture
def refused(capsys):
    """Runs a command that must end with exit code 2 and one line on standard error; returns the line."""

    def check(*words) -> str:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stopped:
            run(*words)
        assert stopped.value.code == 2
        lines = capsys.readouterr().err.strip().splitlines()
        assert len(lines) == 1, lines
        return lines[0]

    return check


@pytest.fixture(scope="session")
def folder(tmp_path_factory) -> Path:
    """A folder of BVH files per style, a dataset, a run, and a clip of a third style, which the run has learned."""
    return made_once(tmp_path_factory, "cli", make_folder)


def make_folder(folder: Path) -> None:
    for style in ("neutral", "old"):
        (folder / "bvh" / style).mkdir(parents=True)
        for number, labelled in enumerate(synthetic_clips(style, 10.0, clip_seconds=5.0)):
            write_bvh(folder / "bvh" / style / f"{number}.bvh", labelled.clip)
    frames = 181
    clip, _ = synthesise("zombie", np.zeros(frames), np.full(frames, STYLES["zombie"].speed))
    write_bvh(folder / "zombie.bvh", clip)
    run("prepare", folder / "bvh", "--out", folder / "data")
    run("pretrain", folder / "data", "--out", folder / "run", *SMALL, "--json", folder / "pretrain.json")
    run("few-shot", folder / "run", folder / "zombie.bvh", "--name", "zombie", *QUICK, "--json", folder / "few.json")


def test_help_lists_every_command(capsys):
    with pytest.raises(SystemExit) as stopped:
        run("--help")
    assert stopped.value.code == 0
    shown = capsys.readouterr().out
    assert [re.split("  +", line)[1] for line in shown.splitlines() if line.startswith("  ")] == list(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_is_explained(name, capsys):
    with pytest.raises(SystemExit) as stopped:
        run(*name.split(), "--help")
    assert stopped.value.code == 0
    shown = capsys.readouterr().out
    explained = parse(load_command(name).__doc__ or "")
    assert explained.short_description and explained.short_description.split()[0] in shown
    fields = {field.name for field in dataclasses.fields(load_command(name))} - {"json", "given"}
    assert fields == {param.arg_name for param in explained.params}


def test_the_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as stopped:
        run("--version")
    assert stopped.value.code == 0 and capsys.readouterr().out == f"pfnn-jax {pfnn_jax.__version__}\n"


HEAVY = ("jax", "flax", "optax", "orbax", "scipy.signal", "matplotlib", "viser")
LOADED = f"""
import sys
from pfnn_jax.cli import main
for line in sys.stdin.read().splitlines():
    try:
        main(line.split())
    except SystemExit:
        pass
    loaded = [name for name in {HEAVY} if name in sys.modules]
    assert not loaded, (line, loaded)
"""


def test_what_needs_no_network_loads_no_jax(folder, tmp_path):
    """Help, refusals, `label-phase` and pages start at once."""
    run_path, clip, new = folder / "run", folder / "zombie.bvh", tmp_path / "new"
    lines = [
        "--help",
        *(f"{name} --help" for name in COMMANDS),
        "nonsense",
        f"pretrain {folder / 'data'} --out {new} --hidden -4",
        f"pretrain {new} --out {new}",
        f"generate {run_path} --style sad --out {new}.bvh",
        f"generate {run_path} --out {new}/a.bvh",
        f"predict {run_path} rows.npz --style sad --out {new}.npz",
        f"export {run_path} --format onnx --style sad --out {new}",
        f"few-shot {run_path} {clip} --name zombie",
        f"few-shot {new} {clip} --name sad",
        f"evaluate {new} {folder / 'bvh'}",
        f"style export {run_path} sad --out {new}.safetensors",
        f"style import {run_path} {new}.safetensors",
        f"style show {new}.safetensors",
        f"share {run_path} --out {new} --styles sad",
        f"play {folder / 'data'}",
        f"label-phase {clip} --out {new}.phase",
        f"skeleton {clip}",
        f"render {clip} --out {new}.html",
    ]
    done = subprocess.run([sys.executable, "-c", LOADED], input="\n".join(lines), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert new.with_suffix(".phase").is_file() and new.with_suffix(".html").is_file()


def test_prepare_pretrain_and_few_shot_leave_a_run(folder):
    assert list_styles(folder / "run") == ("neutral", "old", "zombie")
    assert json.loads((folder / "pretrain.json").read_text())["styles"] == ["neutral", "old"]
    result = json.loads((folder / "few.json").read_text())
    assert result["choice"]["epochs"] in (1, 2)
    assert result["mirrored"] is True
    assert style_note(folder / "run", "zombie")["info"]["source"] == "zombie.bvh"


def test_few_shot_leaves_the_shared_network_bitwise_unchanged(folder, tmp_path):
    shutil.copytree(folder / "run", tmp_path / "run")
    before = fingerprint(load_run(tmp_path / "run").shared)
    old = load_style(load_run(tmp_path / "run"), "old")
    run("few-shot", tmp_path / "run", folder / "zombie.bvh", "--name", "again", *QUICK)
    after = load_run(tmp_path / "run")
    assert fingerprint(after.shared) == before == after.fingerprint
    assert fingerprint(load_style(after, "old")) == fingerprint(old)


FOUND = {
    "frames": 1,
    "seconds": 1.0,
    "choice": {"epochs": 100, "held_out_error": 2.0},
    "held_out_error": 2.0,
    "error_without_style": 3.0,
    "stable_on_turns": False,
    "mirrored": False,
    "asymmetry": 0.5,
    "warnings": ["it falls", "it is not a walk"],
}


@pytest.fixture
def requested(folder, monkeypatch):
    """Returns the settings that few-shot would train with, on the run or, with `film`, on one with FiLM styles."""

    def settings(*words, film: bool = False) -> FewShotConfig:
        found = []
        loaded = load_run(folder / "run")
        if film:
            loaded = dataclasses.replace(
                loaded, config=dataclasses.replace(loaded.config, adapter=AdapterConfig("film"))
            )
        monkeypatch.setattr("pfnn_jax.run.load_run", lambda path: loaded)
        monkeypatch.setattr(
            "pfnn_jax.workflows.learn.learn_style", lambda run, clip, config, **_: found.append(config) or FOUND
        )
        run("few-shot", folder / "run", folder / "zombie.bvh", "--name", "z", *words)
        return found[0]

    return settings


def test_given_options_replace_those_of_the_recipe(requested):
    assert requested("--recipe", "mason2018", "--seed", "7") == dataclasses.replace(MASON2018_FEW_SHOT, seed=7)
    assert requested(film=True) == FILM_FEW_SHOT
    assert requested("--l1", "0.5", film=True) == dataclasses.replace(FILM_FEW_SHOT, l1=0.5)
    assert requested("--no-decay", "--eval-epochs", "5", "10").eval_epochs == (5, 10)
    assert requested("--method=cp", film=True).method == "cp"  # which `learn_style` refuses


@pytest.mark.parametrize(
    "words",
    [
        ("--recipe", "mason2018", "--learning-rates", "0.1"),
        ("--recipe", "mason2018", "--no-restyled"),
        ("--recipe", "generator", "--l1=0.1"),
        ("--tuning.epochs", "3"),
        ("--method", "diagonal", "--rank", "5"),
    ],
)
def test_options_that_would_be_ignored_are_refused(folder, refused, words):
    line = refused("few-shot", folder / "run", folder / "zombie.bvh", "--name", "z", *words)
    assert "command line: " in line


def test_few_shot_says_what_its_error_means(folder, requested, capsys):
    requested("--mirror", "False")
    shown = capsys.readouterr().out
    assert "not mirrored" in shown and "without the style 3.000" in shown and "1.0 = predicting the mean" in shown
    assert [line for line in shown.splitlines() if line.startswith("warning: ")] == [
        "warning: it falls",
        "warning: it is not a walk",
    ]
    requested()
    assert "not mirrored (left and right differ by 0.50)" in capsys.readouterr().out


def test_few_shot_warns_of_a_clip_that_is_not_a_walk_and_asks_the_clip_not_its_name(folder, tmp_path, capsys):
    shutil.copytree(folder / "run", tmp_path / "run")
    clip = read_bvh(folder / "zombie.bvh")
    reverse = dataclasses.replace(clip, root_positions=clip.root_positions[::-1], rotations=clip.rotations[::-1])
    write_bvh(tmp_path / "back.bvh", reverse)
    run("few-shot", tmp_path / "run", tmp_path / "back.bvh", "--name", "back", *QUICK)
    assert "warning: the clip is not a forward walk: it moves backwards" in capsys.readouterr().out
    run("few-shot", tmp_path / "run", folder / "zombie.bvh", "--name", "DragLeg", *QUICK)
    shown = capsys.readouterr().out
    assert "and their mirror image (left and right differ by 0.0" in shown and "not a forward walk" not in shown
    assert style_note(tmp_path / "run", "DragLeg")["info"]["mirrored"]


def test_sample_lists_the_clips_and_writes_one(tmp_path, capsys):
    run("sample")
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(sample_clips())
    run("sample", "soldier", "--out", tmp_path / "walk.bvh")
    assert (tmp_path / "walk.bvh").read_bytes() == sample_clips()["soldier"].read_bytes()


@pytest.mark.parametrize(
    ("words", "place", "rule"),
    [
        (("penguin",), "name: penguin", "zombie"),
        (("soldier",), "out: absent", "file to write"),
        (("--out", "x.bvh"), "name: absent", "name of the sample"),
        (("soldier", "--out", "x.txt"), "x.txt", ".bvh"),
    ],
)
def test_sample_refuses_what_it_cannot_write(refused, words, place, rule):
    line = refused("sample", *words)
    assert place in line and rule in line


@pytest.mark.parametrize("mode", ["cubic", "nearest50"])
def test_generate_writes_motion_in_the_style(folder, tmp_path, mode):
    out = tmp_path / "walk.bvh"
    run(
        "generate",
        folder / "run",
        "--style",
        "zombie",
        "--path",
        "circle",
        "--seconds",
        "1",
        "--mode",
        mode,
        "--published-loop",
        "--out",
        out,
    )
    assert read_bvh(out).num_frames == 60


def test_generate_starts_standing_at_the_start_of_its_path(folder, tmp_path):
    run("generate", folder / "run", "--path", "straight", "--seconds", "1", "--out", tmp_path / "a.bvh")
    clip = read_bvh(tmp_path / "a.bvh")
    assert clip.num_frames == 60
    first, second = clip.root_positions[:2, [0, 2]]
    assert np.linalg.norm(first) < 0.3 and 60.0 * np.linalg.norm(second - first) < 0.5


def test_a_generated_clip_can_be_named(folder, tmp_path, monkeypatch):
    walk = synthesise("proud", np.zeros(60), np.ones(60))[0]
    monkeypatch.setattr("pfnn_jax.workflows.generate.generate_clip", lambda *_, **__: walk)
    run("generate", folder / "run", "--name", "walk-loop", "--out", tmp_path / "a.glb")
    assert read_clip(tmp_path / "a.glb", clip_name="walk-loop", travel="keep").num_frames == 60


def test_tables_of_a_phase_need_the_published_loop(folder, tmp_path, refused):
    line = refused("generate", folder / "run", "--mode", "nearest50", "--out", tmp_path / "a.bvh")
    assert "mode: nearest50; must be cubic without --published-loop" in line


def test_generate_follows_points_of_a_file(folder, tmp_path):
    (tmp_path / "points.csv").write_text("x,z\n0,0\n0,3\n2,5\n")
    run("generate", folder / "run", "--path", tmp_path / "points.csv", "--seconds", "1", "--out", tmp_path / "a.bvh")
    assert read_bvh(tmp_path / "a.bvh").num_frames == 60


def test_evaluate_gives_errors_by_style_and_group(folder, tmp_path, capsys):
    run("evaluate", folder / "run", folder / "bvh", "--json", tmp_path / "errors.json")
    errors = json.loads((tmp_path / "errors.json").read_text())
    assert set(errors) == {"neutral", "old"}
    assert errors["old"]["pose"] > 0 and len(errors["old"]["per_take"]) == 2
    shown = capsys.readouterr().out.splitlines()
    assert "lower is better, 1.0 = predicting the mean" in shown[0] and shown[1].startswith("neutral: all ")


def test_label_phase_writes_one_value_per_frame(folder, tmp_path):
    run("label-phase", folder / "zombie.bvh", "--out", tmp_path / "zombie.phase")
    values = np.loadtxt(tmp_path / "zombie.phase")
    assert values.shape == (181,) and values.min() >= 0 and values.max() <= 1


def test_released_weights_answer_the_golden_rows(reference, tmp_path):
    run("import-released", "pfnn", reference / "pfnn", "--out", tmp_path / "holden")
    std = np.fromfile(reference / "pfnn" / "Ystd.bin", "<f4")
    golden = reference / "pfnn_golden_dev.npz"
    for mode in ("cubic", "constant50", "nearest50"):
        run("predict", tmp_path / "holden", golden, "--out", tmp_path / f"{mode}.npz", "--mode", mode)
        with np.load(tmp_path / f"{mode}.npz") as found, np.load(golden) as wanted:
            # Float32 against float64 goldens differs by 2e-6 of a deviation; 1e-4 leaves room for other processors.
            assert (np.abs(found["y"] - wanted[f"y_{mode}"]) / std).max() < 1e-4


# Bad input


def test_bad_bvh_is_one_line(refused, folder, tmp_path):
    text = (folder / "zombie.bvh").read_text()
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("Frame Time")) + 1
    row = lines[first].split()
    bad = {
        "truncated": ("\n".join(lines[: first - 8]), ""),
        "no End Site": (text.replace("End Site", "Joint", 1), ""),
        "too few columns": ("\n".join([*lines[:first], " ".join(row[:-1]), *lines[first + 1 :]]), f"line {first + 1}"),
        "not a number": ("\n".join([*lines[:first], " ".join(["x1", *row[1:]]), *lines[first + 1 :]]), "x1"),
        "NaN": ("\n".join([*lines[:first], " ".join(["nan", *row[1:]]), *lines[first + 1 :]]), "nan"),
        "zero frames": ("\n".join([*lines[: first - 2], "Frames: 0", lines[first - 1]]), "0"),
        "zero frame time": (text.replace(lines[first - 1], "Frame Time: 0.0"), "0"),
    }
    for name, (content, place) in bad.items():
        file = tmp_path / "bad.bvh"
        file.write_text(content)
        line = refused("label-phase", file, "--out", tmp_path / "bad.phase")
        assert line.startswith(f"pfnn-jax: {file}: ") and place.lower() in line.lower(), (name, line)
        assert list(tmp_path.iterdir()) == [file], name


SNAKE = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Tail
  {
    OFFSET 0 0 30
    CHANNELS 3 Zrotation Yrotation Xrotation
    End Site
    {
      OFFSET 0 0 30
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.016667
0 0 0 0 0 0 0 0 0
0 0 0 0 0 0 0 0 0
"""


def test_a_skeleton_without_feet_is_one_line(refused, tmp_path):
    (tmp_path / "snake.bvh").write_text(SNAKE)
    line = refused("label-phase", tmp_path / "snake.bvh", "--out", tmp_path / "snake.phase")
    assert "snake.bvh" in line and "left_thigh" in line and "--roles" in line


def test_a_role_of_an_unknown_joint_is_one_line(refused, folder, tmp_path):
    roles = tmp_path / "roles.json"
    roles.write_text(json.dumps({"left_foot": ["NoSuchJoint"]}))
    line = refused("label-phase", folder / "zombie.bvh", "--out", tmp_path / "z.phase", "--roles", roles)
    assert "roles.json" in line and "NoSuchJoint" in line


def test_a_clip_that_is_no_walk_is_one_line(refused, folder, tmp_path, mocap):
    line = refused("label-phase", mocap / "xia" / "depressed_18_000.bvh", "--out", tmp_path / "p.phase")
    assert "depressed_18_000.bvh" in line and "steps" in line
    assert not list(tmp_path.iterdir())


def test_a_clip_too_short_is_one_line(refused, folder, tmp_path):
    words = ("few-shot", folder / "run", folder / "zombie.bvh", "--name", "short", "--stop", "20", *QUICK)
    assert "zombie.bvh" in refused(*words)
    assert "short" not in list_styles(folder / "run")


def test_a_clip_of_another_skeleton_is_put_onto_the_runs_and_this_is_said(folder, tmp_path, mocap, capsys):
    clip = mocap / "bandai-namco-2" / "dataset-2_walk_normal_001.bvh"
    shutil.copytree(folder / "run", tmp_path / "run")
    run("few-shot", tmp_path / "run", clip, "--name", "other", *QUICK)
    assert f"note: {clip}: retargeted from 21 to 21 joints, legs scaled by 1.0" in capsys.readouterr().out
    run("evaluate", tmp_path / "run", clip, "--style", "other")
    assert "retargeted from 21 to 21 joints" in capsys.readouterr().out


def test_clips_that_cannot_be_evaluated_are_one_line_with_the_cause(refused, folder, tmp_path):
    clip = shutil.copy(folder / "zombie.bvh", tmp_path / "tired.bvh")
    line = refused("evaluate", folder / "run", clip)
    assert "tired.bvh: style" in line and "tired; must be" in line and "neutral, old, zombie" in line
    assert "--style" in line


@pytest.mark.parametrize("name", ["../escape", "a/b", ".hidden", ""])
def test_a_style_name_that_is_no_file_name_is_one_line(refused, folder, name):
    assert "style name" in refused("few-shot", folder / "run", folder / "zombie.bvh", f"--name={name}", *QUICK)


def test_an_existing_style_is_refused_without_overwrite(refused, folder):
    line = refused("few-shot", folder / "run", folder / "zombie.bvh", "--name", "zombie", *QUICK)
    assert "exists" in line and "--overwrite" in line


def test_an_adapter_of_another_rank_is_one_line(refused, folder):
    words = ["few-shot", folder / "run", folder / "zombie.bvh", "--name", "z", "--rank", "5"]
    assert "rank" in refused(*words)


def test_an_adapter_of_another_network_is_one_line(refused, folder, tmp_path):
    run("pretrain", folder / "data", "--out", tmp_path / "run", *SMALL, "--seed", "1")
    shutil.copytree(folder / "run" / "styles" / "zombie", tmp_path / "run" / "styles" / "zombie")
    line = refused("generate", tmp_path / "run", "--style", "zombie", "--out", tmp_path / "z.bvh")
    assert "another shared network" in line
    assert not (tmp_path / "z.bvh").exists()


def test_an_unknown_style_is_one_line(refused, folder, tmp_path):
    line = refused("generate", folder / "run", "--style", "sad", "--out", tmp_path / "z.bvh")
    assert "sad" in line and "neutral, old, zombie" in line


def test_a_style_that_no_clip_has_is_one_line(refused, folder, tmp_path):
    line = refused("prepare", folder / "bvh", "--out", tmp_path / "data", "--styles", "neutrl")
    assert "style: neutrl; must be one of neutral, old" in line


def test_files_are_called_what_they_are(refused, folder, tmp_path):
    run_path, clip = folder / "run", folder / "zombie.bvh"
    assert "suffix: .txt; must be one of .bvh, .glb" in refused("generate", run_path, "--out", tmp_path / "a.txt")
    assert "suffix: none; must be .phase" in refused("label-phase", clip, "--out", tmp_path / "a")
    assert "suffix: .npy; must be .npz" in refused("predict", run_path, "rows.npz", "--out", tmp_path / "a.npy")
    assert "suffix: .jpg; must be .png" in refused("plot-phase", clip, "--out", tmp_path / "a.jpg")
    assert not list(tmp_path.iterdir())


def test_existing_output_is_refused(refused, folder, tmp_path):
    assert "exists" in refused("prepare", folder / "bvh", "--out", folder / "data")
    assert "exists" in refused("pretrain", folder / "data", "--out", folder / "run", *SMALL)
    (tmp_path / "a.bvh").write_text("mine")
    assert "exists" in refused("generate", folder / "run", "--out", tmp_path / "a.bvh")
    assert (tmp_path / "a.bvh").read_text() == "mine"


def test_a_folder_that_is_no_run_or_dataset_is_one_line(refused, tmp_path):
    assert "config.json" in refused("generate", tmp_path, "--out", tmp_path / "a.bvh")
    line = refused("pretrain", tmp_path, "--out", tmp_path / "run")
    assert line.count("dataset.json") == 1 and "file: No such file or directory; " in line
    assert "no BVH" in refused("prepare", tmp_path, "--out", tmp_path / "data")


def test_rows_of_another_layout_are_one_line(refused, folder, tmp_path):
    np.savez(tmp_path / "rows.npz", x=np.zeros((2, 342)), phase=np.zeros(2))
    assert "342" in refused("predict", folder / "run", tmp_path / "rows.npz", "--out", tmp_path / "y.npz")
    size = load_run(folder / "run").layout.input_size
    np.savez(tmp_path / "rows.npz", x=np.full((2, size), np.nan), phase=np.zeros(2))
    assert "nan" in refused("predict", folder / "run", tmp_path / "rows.npz", "--out", tmp_path / "y.npz")


@pytest.mark.parametrize(
    ("words", "what"),
    [(("export",), "required"), (("export", "run", "--format", "onx", "--out", "a"), "onx")],
)
def test_options_that_cannot_be_parsed_are_explained(capsys, words, what):
    """In several lines, which are the parser's."""
    with pytest.raises(SystemExit) as stopped:
        run(*words)
    shown = capsys.readouterr()
    assert stopped.value.code == 2 and what in shown.err and not shown.out
    assert "Traceback" not in shown.err


def test_an_unknown_command_is_one_line(refused):
    assert "command: none; must be one of demo" in refused()
    assert "command: few_shot; did you mean few-shot?" in refused("few_shot")


def test_a_command_of_two_words_is_found_by_its_first(refused, capsys):
    assert "command: style; must be one of style export, style import, style show" in refused("style")
    assert "command: style exprt; did you mean style export?" in refused("style", "exprt", "--out", "x")
    with pytest.raises(SystemExit) as stopped:
        run("style", "--help")
    shown = capsys.readouterr().out
    assert stopped.value.code == 0 and "style import" in shown and "few-shot" not in shown


def test_messages_speak_of_options():
    assert (
        in_options("run: exists; pass resume=True, or overwrite=True") == "run: exists; pass --resume, or --overwrite"
    )
    assert in_options("PretrainConfig.batch_size must") == "--batch-size must"
    assert in_options("AdapterConfig.rank must") == "--adapter.rank must"


def test_settings_that_break_a_rule_are_one_line(refused, folder):
    words = ("few-shot", folder / "run", folder / "zombie.bvh", "--name", "z", "--held-out", "2")
    assert "--held-out must" in refused(*words)
    words = ("pretrain", folder / "data", "--out", folder / "other")
    assert "--hidden must be at least 1, got -4" in refused(*words, "--hidden", "-4")
    assert "--num-control-points must be at least 4, got 3" in refused(*words, "--num-control-points", "3")


def test_training_that_turns_non_finite_is_one_line(refused, folder, tmp_path):
    line = refused("pretrain", folder / "data", "--out", tmp_path / "run", *SMALL, "--learning-rate", "1e30")
    assert "step" in line and "style" in line


# Ctrl-C


def test_an_interrupt_within_python_is_exit_code_130(monkeypatch, capsys):
    """Where another program calls `main`, it goes on."""

    def interrupted(self):
        raise KeyboardInterrupt

    monkeypatch.setattr(Predict, "run", interrupted)
    with pytest.raises(SystemExit) as stopped:
        run("predict", "run", "x.npz", "--out", "y.npz")
    assert stopped.value.code == 130
    assert capsys.readouterr().err == "pfnn-jax: interrupted\n"


PROGRAM = [sys.executable, "-c", "from pfnn_jax.cli import main; main()"]
COMPILING = """
import sys
from pfnn_jax.cli import main, pretrain
def run(self):
    import jax, jax.numpy as jnp
    def slow(x):
        for _ in range(2000):
            x = jnp.sin(x) @ x
        return x
    lowered = jax.jit(slow).lower(jnp.ones((8, 8)))
    print("compiling", file=sys.stderr, flush=True)
    lowered.compile()
    raise SystemExit("compiled")
pretrain.Pretrain.run = run
main()
"""


def interrupt(command, at: Callable[[subprocess.Popen], None], times: int = 1) -> tuple[int, str, float]:
    """Interrupts a command at a moment; returns its exit code, its errors, and the processor seconds until it ended."""
    ended = children_seconds()
    with subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL, stderr=-1, text=True) as process:
        try:
            at(process)
            used = processor_seconds(process)
            for _ in range(times):
                process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=LONGEST)
        finally:
            process.kill()  # otherwise a command that hangs would hang the test
        return process.returncode, errors, children_seconds() - ended - used


def children_seconds() -> float:
    """Returns the processor time of the programs that this process has started and that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def processor_seconds(process: subprocess.Popen) -> float:
    """Returns the processor time that a running program has used; on a loaded machine, time says little."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def having_used(seconds: float) -> Callable[[subprocess.Popen], None]:
    """Returns a function that waits until a program has used some seconds of processor time."""

    def wait(process: subprocess.Popen) -> None:
        end = time.monotonic() + LONGEST
        while processor_seconds(process) < seconds:
            assert process.poll() is None and time.monotonic() < end
            time.sleep(0.01)

    return wait


def line_with(text: str) -> Callable[[subprocess.Popen], None]:
    def wait(process: subprocess.Popen) -> None:
        assert process.stderr is not None
        assert any(text in line for line in iter(process.stderr.readline, "")), f"no line with {text!r}"

    return wait


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs the processor time of other programs in /proc")
class TestInterrupts:
    @pytest.mark.parametrize("seconds", [0.3, 1.0, 2.5])
    def test_a_command_ends_with_one_line_while_it_imports_and_loads(self, folder, tmp_path, seconds):
        command = [*PROGRAM, "pretrain", folder / "data", "--out", tmp_path / "run", *SMALL, "--steps", "1000000"]
        code, errors, took = interrupt(command, having_used(seconds))
        assert (code, errors) in [(130, "pfnn-jax: interrupted\n"), (-signal.SIGINT, "")] or seconds == 0.3
        assert took < SOON

    @pytest.mark.parametrize("times", [1, 2])
    def test_a_command_ends_while_xla_compiles(self, times):
        command = [sys.executable, "-c", COMPILING, "pretrain", "data", "--out", "run"]
        code, errors, took = interrupt(command, line_with("compiling"), times)  # that takes half a minute
        assert (code, errors) == (130, "pfnn-jax: interrupted\n")
        assert took < SOON

    def test_an_interrupted_training_keeps_its_last_save_and_resumes(self, folder, tmp_path, refused):
        words = ["pretrain", folder / "data", "--out", tmp_path / "run", *SMALL, "--save-every", "10"]
        command = [*PROGRAM, *words, "--steps", "100000"]
        code, errors, _ = interrupt(command, lambda _: wait_for(tmp_path / "run" / "train_state"))
        assert (code, errors.splitlines()[-1]) == (130, "pfnn-jax: interrupted")
        line = refused(*words)
        assert "--resume" in line and line.find("--resume") < line.find("--overwrite")
        saved = train_step(tmp_path / "run")
        assert saved is not None and saved >= 10


def wait_for(path: Path) -> None:
    end = time.monotonic() + LONGEST
    while not path.exists():
        assert time.monotonic() < end, path
        time.sleep(0.05)
