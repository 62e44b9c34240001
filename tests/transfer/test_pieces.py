"""Long clips in pieces: what is local in time gives the same as on the whole clip, and pieces meet without a step."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.transfer.pieces import MARGIN, OVERLAP, PIECE, in_pieces

EXACT = 1e-12  # float64, a weighted mean of two equal numbers
WIDTH = 2 * (MARGIN - 3) + 1  # frames that a transformation network and the projection see


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
