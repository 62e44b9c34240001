"""What is known about files, as options of every command that reads clips; bad files; and a reader that goes away."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.cli.command_line import load_command
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.reading import Axis
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.motion.skeletons import tipped

READING = (
    "skeleton",
    "prepare",
    "few-shot",
    "evaluate",
    "label-phase",
    "plot-phase",
    "render",
    "transfer",
    "train-transfer",
)


def run(*words) -> None:
    main([str(word) for word in words])


def walk(folder: Path, name: str = "walk", up: Axis = "y") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    clip, _ = synthesise("neutral", np.zeros(200), np.full(200, 1.2))
    write_bvh(folder / f"{name}.bvh", tipped(clip, up))
    return folder / f"{name}.bvh"


@pytest.mark.parametrize("name", READING)
def test_every_command_that_reads_clips_has_the_options(name, capsys):
    with pytest.raises(SystemExit):
        run(name, "--help")
    text = capsys.readouterr().out
    assert all(option in text for option in ("--unit", "--up", "--source-fps", "--travel", "--roles"))
    assert load_command(name)


def test_options_are_obeyed_and_doubts_printed(tmp_path, capsys):
    file = walk(tmp_path, up="-y")
    run("label-phase", file, "--out", tmp_path / "a.phase", "--json", tmp_path / "a.json")
    assert "note: " in capsys.readouterr().out
    assert any("stands along -y" in note for note in json.loads((tmp_path / "a.json").read_text())["notes"])
    words = ("--up=-y", "--unit", "centimetre", "--source-fps", "60", "--travel", "keep")
    run("label-phase", file, "--out", tmp_path / "b.phase", *words)
    assert "note: " not in capsys.readouterr().out
    assert (tmp_path / "a.phase").read_bytes() == (tmp_path / "b.phase").read_bytes()
    run("label-phase", file, "--out", tmp_path / "c.phase", "--unit", "0.011", "--up=-y")
    assert len((tmp_path / "c.phase").read_text().splitlines()) == 200


def test_a_phase_file_has_a_line_for_each_frame_of_the_file_where_frames_are_cut(tmp_path):
    clip, _ = synthesise("neutral", np.zeros(200), np.full(200, 1.2))
    clip.root_positions[0] = 0.0
    clip.rotations[0] = (1.0, 0.0, 0.0, 0.0)
    write_bvh(tmp_path / "posed.bvh", clip)
    run("label-phase", tmp_path / "posed.bvh", "--out", tmp_path / "posed.phase")
    lines = (tmp_path / "posed.phase").read_text().splitlines()
    assert len(lines) == 200 and float(lines[0]) == 0 and float(lines[100]) > 0


def test_prepare_lists_all_bad_files_and_skips_them_on_request(tmp_path, capsys):
    for style in ("old", "young"):
        walk(tmp_path / "clips" / style / "deep")
        (tmp_path / "clips" / style / "bad.bvh").write_text("HIERARCHY")
    words = ("prepare", tmp_path / "clips", "--out", tmp_path / "data")
    with pytest.raises(SystemExit) as stopped:
        run(*words)
    lines = [line for line in capsys.readouterr().err.strip().splitlines() if not line.startswith("preparing")]
    assert stopped.value.code == 2 and len(lines) == 3 and "--skip-bad" in lines[-1]
    run(*words, "--skip-bad")
    assert capsys.readouterr().out.count("left out: ") == 2
    data = json.loads((tmp_path / "data" / "dataset.json").read_text())
    assert data["styles"] == ["old", "young"] and data["clips"][0]["reading"]["unit"] == 0.01


def test_prepare_names_files_that_it_does_not_use(tmp_path, capsys):
    walk(tmp_path / "clips" / "old")
    walk(tmp_path / "clips", "stray")
    run("prepare", tmp_path / "clips", "--out", tmp_path / "data", "--kind", "folders")
    assert "1 clips are not used" in capsys.readouterr().out


@pytest.mark.parametrize("words", ["--help", "prepare --help"])
def test_a_reader_that_goes_away_ends_the_command_quietly(words):
    code = f"import sys; from pfnn_jax.cli import main; sys.argv[1:] = {words.split()!r}; main()"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        errors = process.stderr.read()
    assert (process.returncode, errors) == (141, b"")
