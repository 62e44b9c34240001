"""The word `base` on the command line: every command that takes a run takes it, and says once where styles are kept."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise
from pfnn_jax.run import load_run
from pfnn_jax.run_config import list_styles
from pfnn_jax.workflows.base import BASE_NETWORK, base_run
from tests.trained import made_once

QUICK = "--eval-epochs 1 --learning-rates 0.001 --main-dropouts 0 --batch-size 16".split()


def run(*words: object) -> None:
    main([str(word) for word in words])


@pytest.fixture(scope="session")
def learned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data folder, with the base network and a style `mine`, next to the clip that it was learned from."""

    def make(folder: Path) -> None:
        clip, _ = synthesise("zombie", np.zeros(181), np.full(181, STYLES["zombie"].speed))
        write_bvh(folder / "zombie.bvh", clip)
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_DATA_HOME", str(folder / "home"))
            run("few-shot", "base", folder / "zombie.bvh", "--name", "mine", *QUICK)

    return made_once(tmp_path_factory, "cli_base", make)


@pytest.fixture
def folder(learned: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with that data folder."""
    monkeypatch.setenv("XDG_DATA_HOME", str(learned / "home"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def empty(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with an empty data folder, which is returned."""
    monkeypatch.setenv("XDG_DATA_HOME", str(folder / "home"))
    return folder / "home" / "pfnn_jax"


def test_few_shot_saves_the_style_in_the_users_copy_only(folder: Path):
    assert "mine" in list_styles(base_run())
    assert "mine" not in list_styles(BASE_NETWORK)


def test_generate_walks_in_the_learned_style(folder: Path):
    run("generate", "base", "--style", "mine", "--path", "straight", "--seconds", 1, "--out", "mine.bvh")
    assert read_bvh(Path("mine.bvh")).skeleton.names == load_run(base_run()).skeleton.names


def test_evaluate_measures_the_learned_style(folder: Path, learned: Path):
    run("evaluate", "base", learned / "zombie.bvh", "--style", "mine", "--json", "errors.json")
    assert "all" in json.loads(Path("errors.json").read_text())["zombie"]


def test_export_writes_the_learned_style(folder: Path):
    run("export", "base", "--format", "stablehlo", "--style", "mine", "--out", "exported")
    assert json.loads(Path("exported/description.json").read_text())["styles"][0]["name"] == "mine"


def test_predict_evaluates_the_network(folder: Path):
    network = load_run(base_run())
    x = np.tile(np.asarray(network.normaliser.inputs.mean, np.float32), (2, 1))
    phase = np.stack([np.asarray(network.normaliser.initial_phase(), np.float32)] * 2)
    rows = {"x": x, "gating_x" if phase.ndim > 1 else "phase": phase}
    np.savez("rows.npz", **rows)  # pyright: ignore[reportArgumentType]
    run("predict", "base", "rows.npz", "--style", "mine", "--out", "y.npz")
    assert np.load("y.npz")["y"].shape == (2, network.layout.output_size)


@pytest.mark.parametrize("words", [(), ("base",)], ids=["without a run", "base"])
def test_play_plays_the_base_network(folder: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]):
    played = []
    monkeypatch.setattr("pfnn_jax.viewer.page.play.play", lambda paths, **_: played.extend(paths))
    run("play", *words)
    assert played == [base_run()]


def test_the_first_command_says_where_styles_are_kept_and_later_ones_do_not(empty: Path, capsys, monkeypatch):
    monkeypatch.setattr("pfnn_jax.viewer.page.play.play", lambda *_, **__: None)
    run("play", "base")
    assert capsys.readouterr().out == f"base: copied to {base_run()}; styles learned on it are kept there\n"
    run("play", "base")
    assert capsys.readouterr().out == ""


def test_few_shot_says_what_comes_next(empty: Path, learned: Path, capsys: pytest.CaptureFixture[str]):
    run("few-shot", "base", learned / "zombie.bvh", "--name", "my walk", *QUICK)
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == "next: pfnn-jax generate base --style 'my walk' --out 'my walk.bvh'"


def test_a_path_named_base_takes_precedence_and_this_is_said(folder: Path, monkeypatch, capsys):
    shutil.copytree(BASE_NETWORK, "base")
    played = []
    monkeypatch.setattr("pfnn_jax.viewer.page.play.play", lambda paths, **_: played.extend(paths))
    run("play", "base")
    assert played == [Path("base")]
    assert "not the base network of the package" in capsys.readouterr().out


def test_another_path_that_ends_in_base_is_a_path(empty: Path, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as stopped:
        run("play", "runs/base")
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith("pfnn-jax: runs/base/config.json")


def test_bad_options_copy_nothing(empty: Path, capsys: pytest.CaptureFixture[str]):
    for words in (("generate", "base", "--out", "walk.txt"), ("predict", "base", "in.npz", "--out", "y.txt")):
        with pytest.raises(SystemExit):
            run(*words)
    assert not empty.exists()


def test_learning_in_a_read_only_copy_is_refused_before_it_begins(folder: Path, learned: Path, monkeypatch, capsys):
    copy = base_run()
    monkeypatch.setattr("os.access", lambda path, mode: not Path(path).is_relative_to(copy))
    with pytest.raises(SystemExit) as stopped:
        run("few-shot", "base", learned / "zombie.bvh", "--name", "another")
    assert stopped.value.code == 2
    assert capsys.readouterr().err.startswith(f"pfnn-jax: {copy / 'styles'}: folder: read-only; must be writable")


def test_a_data_folder_that_cannot_be_written_is_one_line(folder: Path, monkeypatch, capsys):
    (folder / "file").write_text("")
    monkeypatch.setenv("XDG_DATA_HOME", str(folder / "file"))
    with pytest.raises(SystemExit) as stopped:
        run("generate", "base", "--out", "walk.bvh")
    assert stopped.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
