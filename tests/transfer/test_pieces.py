"""Long clips in pieces: what is local in time gives the same as on the whole clip, and pieces meet without a step."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.transfer.config import TransformationConfig
from pfnn_jax.transfer.pieces import MARGIN, OVERLAP, PIECE, in_pieces
from pfnn_jax.transfer.transformation import init_transformation
from pfnn_jax.transfer.transformation_training import apply_network
from pfnn_jax.workflows.transfer import rows_for_run
from tests.transfer_runs import make_transfer_run, make_walk

FLOAT = 1e-4  # standard deviations: float32 over six convolutions, in programs of other sizes
EXACT = 1e-12  # float64, a weighted mean of two equal numbers
WIDTH = 2 * MARGIN + 1  # frames


def smooth(rows: np.ndarray) -> np.ndarray:
    """Returns moving means of WIDTH frames with zeros beyond the ends, as a convolution does."""
    kernel = np.full(WIDTH, 1.0 / WIDTH)
    return np.stack([np.convolve(column, kernel, mode="same") for column in rows.T], axis=1)


@pytest.mark.parametrize("frames", [1, 25, PIECE, PIECE + 1, PIECE + OVERLAP, 3 * PIECE + 7, 36_000])
def test_pieces_of_a_local_function_equal_the_whole(frames):
    rows = np.random.default_rng(0).normal(size=(frames, 3))
    if frames < WIDTH:
        assert np.array_equal(in_pieces(rows, lambda piece: 2 * piece), 2 * rows)
    else:
        np.testing.assert_allclose(in_pieces(rows, smooth), smooth(rows), atol=EXACT)


def test_every_piece_fits_and_begins_at_an_even_frame():
    rows = np.arange(10 * PIECE, dtype=float)[:, None]
    pieces: list[tuple[int, int]] = []

    def note(piece: np.ndarray) -> np.ndarray:
        pieces.append((int(piece[0, 0]), len(piece)))
        return piece

    np.testing.assert_allclose(in_pieces(rows, note), rows, rtol=EXACT)
    assert all(start % 2 == 0 and OVERLAP < length <= PIECE for start, length in pieces)
    assert max(length for _, length in pieces) == PIECE


def test_a_clip_of_one_piece_is_done_whole():
    rows = np.ones((PIECE, 2))
    assert in_pieces(rows, lambda piece: piece) is rows


def test_pieces_that_differ_are_cross_faded():
    made = iter((0.0, 1.0))
    done = in_pieces(np.zeros((PIECE + 100, 1)), lambda piece: np.full(piece.shape, next(made)))
    assert done[0] == 0.0 and done[-1] == 1.0
    assert np.diff(done[:, 0]).max() <= 1.0 / (OVERLAP - 2 * MARGIN) + EXACT and (np.diff(done[:, 0]) >= 0).all()


def test_a_network_in_pieces_equals_the_whole(tmp_path):
    run = make_transfer_run(tmp_path)
    network = init_transformation(TransformationConfig(hidden=8), run.layout.size, key=jax.random.key(1))
    rows = rows_for_run(read_bvh(make_walk(tmp_path / "long.bvh", seconds=12.0)), run)

    def apply(piece: np.ndarray) -> np.ndarray:
        return apply_network(run, network, piece)

    apart = (in_pieces(rows, apply, size=400) - apply(rows)) / run.statistics.std
    assert np.abs(apart).max() < FLOAT
