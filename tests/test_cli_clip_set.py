"""`pfnn-jax export --format glb`: the moves of a style as clips of a character."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.gltf.container import read_document
from tests.trained import walking_run

CLOSED = 1e-5
"""Quaternion components and metres; keys are stored in single precision."""


@pytest.fixture(scope="module")
def moves(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A mannequin with the moves of the style `old`."""
    run, out = walking_run(tmp_path_factory), tmp_path_factory.mktemp("clip_set") / "moves.glb"
    main(["export", str(run.path), "--format", "glb", "--style", "old", "--out", str(out)])
    return out


def names(path: Path) -> list[str]:
    return [animation["name"] for animation in read_document(path).items("animations")]


def test_a_mannequin_has_the_moves_by_name(moves: Path):
    assert {"idle", "walk", "walk_left", "walk_right"} <= {*names(moves)}


def test_every_move_closes_and_stays_in_place(moves: Path):
    for name in names(moves):
        clip = read_clip(moves, clip_name=name, travel="keep")
        assert np.abs(np.abs(np.sum(clip.rotations[0] * clip.rotations[-1], axis=-1)) - 1.0).max() < CLOSED
        assert np.abs(clip.root_positions[-1] - clip.root_positions[0]).max() < CLOSED


@pytest.mark.slow
def test_moves_are_appended_to_a_character(moves: Path, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path):
    run, out = walking_run(tmp_path_factory), tmp_path / "proud.glb"
    main(["export", str(run.path), "--format", "glb", "--style", "proud", "--onto", str(moves), "--out", str(out)])
    own = names(moves)
    assert names(out)[: len(own)] == own
    assert len(names(out)) > len(own)
    kept = read_document(moves).json
    assert all(read_document(out).json[part] == kept[part] for part in ("asset", "nodes", "skins", "meshes"))


@pytest.mark.parametrize(
    ("words", "place"),
    [
        ("--format onnx --out new --root-motion", "root-motion"),
        ("--format bins --out new --onto hero.glb", "onto"),
        ("--format stablehlo --out new --onto-unit 0.01", "onto-unit"),
        ("--format onnx --out new --onto-roles roles.json", "onto-roles"),
        ("--format glb --out new.glb --tables 50", "tables"),
        ("--format glb --out new.glb --opset 15", "opset"),
        ("--format glb --out new.glb --film-input", "film-input"),
        ("--format glb --out new.bvh", "suffix"),
        ("--format glb --out new.vrma", "suffix"),
        ("--format glb --out new.glb --onto rig.bvh", "suffix"),
        ("--format glb --out new.glb --onto-unit 0.01", "onto-unit"),
    ],
)
def test_options_that_have_no_effect_are_refused_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: str, place: str
):
    """Before the run is looked for, which does not exist."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stopped:
        main(["export", "absent", *words.split()])
    assert stopped.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert f": {place}: " in line
    assert not list(tmp_path.iterdir())
