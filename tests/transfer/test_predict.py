"""Hidden units and reconstruction of the rows of a file, through the function and the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.transfer.predict import reconstruct, reconstruct_file
from pfnn_jax.transfer.run import TransferRun
from tests.raising import assert_refused
from tests.transfer.test_run import make_run

FLOAT32 = 1e-5
"""Sums of two hundred products of size one in single precision."""


@pytest.fixture
def run(tmp_path: Path) -> TransferRun:
    return make_run(tmp_path / "run", 1)


def rows(frames: int = 8) -> np.ndarray:
    return np.random.default_rng(0).normal(size=(frames, 66))


def write(file: Path, **arrays: Any) -> Path:
    np.savez(file, **arrays)
    return file


def test_reconstruction_is_the_autoencoders_in_layout_units(run: TransferRun):
    x = rows()
    hidden, y = reconstruct(run, x)
    normalised = jax.numpy.asarray(run.statistics.apply(x), "float32")
    np.testing.assert_allclose(hidden, run.autoencoder.encode(normalised), atol=FLOAT32)
    expected = run.statistics.invert(np.asarray(run.autoencoder.project(normalised)))
    np.testing.assert_allclose(y, expected, atol=FLOAT32)


def test_a_file_of_rows_is_answered_by_a_file(run: TransferRun, tmp_path: Path, capsys: pytest.CaptureFixture):
    source, out = write(tmp_path / "in.npz", x=rows()), tmp_path / "out.npz"
    main(["predict", str(run.path), str(source), "--out", str(out), "--json", str(tmp_path / "facts.json")])
    assert capsys.readouterr().out.strip() == f"{out}: hidden 4 x 4, y 8 x 66"
    assert json.loads((tmp_path / "facts.json").read_text()) == {"out": str(out), "rows": 8}
    with np.load(out) as found:
        wanted = reconstruct(run, rows())
        np.testing.assert_array_equal(found["hidden"], wanted.hidden)
        np.testing.assert_array_equal(found["y"], wanted.y)
    assert_refused(lambda: reconstruct_file(run.path, source, out), file="out.npz", place="output", value="exists")


@pytest.mark.parametrize(
    ("arrays", "place", "value"),
    [
        ({"y": rows()}, "array x", "absent"),
        ({"x": rows(7)}, "array x", "shape (7, 66)"),
        ({"x": rows()[:, :65]}, "array x", "shape (8, 65)"),
        ({"x": rows(0)}, "array x", "shape (0, 66)"),
        ({"x": rows()[0]}, "array x", "shape (66,)"),
        ({"x": np.full((8, 66), np.inf)}, "array x, row 0, column 0", "inf"),
        ({"x": np.full((8, 66), "a")}, "array x", "<U1"),
    ],
)
def test_bad_rows_are_refused_and_nothing_is_written(
    run: TransferRun, tmp_path: Path, arrays: dict[str, Any], place: str, value: str
):
    source, out = write(tmp_path / "in.npz", **arrays), tmp_path / "out.npz"
    assert_refused(lambda: reconstruct_file(run.path, source, out), file="in.npz", place=place, value=value)
    assert not out.exists()


@pytest.mark.parametrize("option", [("--style", "old"), ("--mode", "nearest50"), ("--layer-norm", "sample")])
def test_options_of_other_networks_are_refused(
    run: TransferRun, tmp_path: Path, capsys: pytest.CaptureFixture, option: tuple[str, str]
):
    source = write(tmp_path / "in.npz", x=rows())
    with pytest.raises(SystemExit) as stopped:
        main(["predict", str(run.path), str(source), "--out", str(tmp_path / "out.npz"), *option])
    line = capsys.readouterr().err.strip()
    assert stopped.value.code == 2 and option[0] in line and len(line.splitlines()) == 1
    assert not (tmp_path / "out.npz").exists()
