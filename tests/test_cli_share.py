"""The commands that pass styles and runs on: what they print, and what they refuse in one line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from pfnn_jax.cli import main
from pfnn_jax.io.tensors import read_tensors, write_tensors
from pfnn_jax.run_config import list_styles
from tests.interop.small_runs import make_run


def run(*words: object) -> None:
    main([str(word) for word in words])


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A run with two styles, and one of them as a file."""
    folder = tmp_path_factory.mktemp("share")
    make_run(folder / "run", "mason2018", "cp")
    run("style", "export", folder / "run", "style1", "--out", folder / "x.safetensors", "--licence", "CC BY 4.0")
    return folder


def refusal(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Returns the one line with which a command ends with exit code 2."""
    capsys.readouterr()
    with pytest.raises(SystemExit) as stopped:
        run(*words)
    [line] = capsys.readouterr().err.strip().splitlines()
    assert stopped.value.code == 2
    return line


def test_a_style_goes_from_one_copy_of_a_run_to_another(folder: Path, tmp_path: Path, capsys):
    shutil.copytree(folder / "run", tmp_path / "other")
    file = folder / "x.safetensors"
    run("style", "import", tmp_path / "other", file, "--name", "my walk", "--json", tmp_path / "card.json")
    shown = capsys.readouterr().out
    assert f"{file}: style my walk, cp, rank 3, mason2018, 21 joints" in shown and "licence: CC BY 4.0" in shown
    assert f"next: pfnn-jax generate {tmp_path / 'other'} --style 'my walk' --out 'my walk_walk.bvh'" in shown
    assert list_styles(tmp_path / "other") == ("my walk", "style0", "style1")
    card = json.loads((tmp_path / "card.json").read_text())
    assert card["name"] == "my walk" and card["adapter"] == {"kind": "cp", "rank": 3}


def test_a_file_is_shown_without_a_run(folder: Path, capsys):
    run("style", "show", folder / "x.safetensors")
    shown = capsys.readouterr().out
    assert "style style1" in shown and "source: not stated" in shown and "recorded speed 1.10 m/s" in shown
    assert "shared network: " in shown


def test_what_cannot_be_passed_on_is_one_line(folder: Path, tmp_path: Path, capsys):
    out, file = tmp_path / "y.safetensors", folder / "x.safetensors"
    assert "style: sad; must be one of style0, style1" in refusal(
        capsys, "style", "export", folder / "run", "sad", "--out", out
    )
    assert "must be .safetensors" in refusal(capsys, "style", "export", folder / "run", "style1", "--out", "y.npz")
    assert "--overwrite" in refusal(capsys, "style", "export", folder / "run", "style1", "--out", file)
    assert "--overwrite" in refusal(capsys, "style", "import", folder / "run", file)
    assert "does not exist" in refusal(capsys, "style", "show", out)
    make_run(tmp_path / "wide", "pfnn2017", "cp")
    assert "layout: mason2018; must be pfnn2017" in refusal(
        capsys, "style", "import", tmp_path / "wide", file, "--name", "new"
    )
    assert "is in the run itself" in refusal(capsys, "share", folder / "run", "--out", folder / "run", "--overwrite")
    assert "style: sad" in refusal(capsys, "share", folder / "run", "--out", tmp_path / "out", "--styles", "sad")
    assert not out.exists() and not (tmp_path / "out").exists()


def test_a_run_is_shared_and_what_is_left_to_say_is_said(folder: Path, tmp_path: Path, capsys):
    run("share", folder / "run", "--out", tmp_path / "walker", "--styles", "style1")
    shown = capsys.readouterr().out
    assert f"{tmp_path / 'walker'}: 1 style, " in shown and "states no licence (--licence)" in shown
    assert f"next: hf upload OWNER/walker {tmp_path / 'walker'}" in shown
    assert list_styles(tmp_path / "walker") == ("style1",)


def test_control_characters_of_a_file_do_not_reach_the_terminal(folder: Path, tmp_path: Path, capsys):
    arrays, text = read_tensors(folder / "x.safetensors")
    info = {**json.loads(text["info"]), "warnings": ["much\x1b[31m\nforged: line"]}
    write_tensors(tmp_path / "y.safetensors", arrays, {**text, "info": json.dumps(info)})
    run("style", "show", tmp_path / "y.safetensors")
    shown = capsys.readouterr().out
    assert "\x1b" not in shown and "warning: much?[31m?forged: line" in shown


def test_commands_take_runs_of_the_hub(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setattr("huggingface_hub.snapshot_download", lambda repository, **_: str(folder / "run"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    run("style", "export", "hf://jane/walker", "style0", "--out", tmp_path / "y.safetensors")
    assert "style style0" in capsys.readouterr().out
    assert "address: hf://walker" in refusal(capsys, "generate", "hf://walker", "--out", tmp_path / "a.bvh")
