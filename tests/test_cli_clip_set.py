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
"""Quaternion components; keys are stored in single precision."""


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


def test_a_move_closes_and_stays_in_place(moves: Path):
    clip = read_clip(moves, clip_name="walk", travel="keep")
    assert np.abs(np.abs(np.sum(clip.rotations[0] * clip.rotations[-1], axis=-1)) - 1.0).max() < CLOSED
    assert np.linalg.norm(clip.root_positions[-1] - clip.root_positions[0]) < 1e-4


def test_moves_are_appended_to_a_character(moves: Path, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path):
    run, out = walking_run(tmp_path_factory), tmp_path / "proud.glb"
    main(["export", str(run.path), "--format", "glb", "--style", "proud", "--onto", str(moves), "--out", str(out)])
    own = names(moves)
    assert names(out)[: len(own)] == own
    assert len(names(out)) > len(own)
    kept = read_document(moves).json
    assert all(read_document(out).json[part] == kept[part] for part in ("asset", "nodes", "skins", "meshes"))


def test_options_of_clips_are_refused_for_networks(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    words = ["export", "base", "--format", "onnx", "--root-motion", "--out", str(tmp_path / "out")]
    with pytest.raises(SystemExit) as stopped:
        main(words)
    assert stopped.value.code == 2
    assert "root-motion" in capsys.readouterr().err
