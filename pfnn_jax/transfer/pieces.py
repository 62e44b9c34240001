"""Transfers long clips in overlapping pieces, so that a clip of any length takes a bounded amount of memory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

PIECE = 1920
"""Frames of a piece; shorter clips are done whole. Even, so that the pooling of all pieces is aligned."""

OVERLAP = 240
"""Frames that neighbouring pieces share."""

MARGIN = 72
"""Frames at both ends of an overlap that are taken from the piece in which they lie further inside. A transformation
network, the projection and the smoothing of the change see 69 frames to each side, so that their result in pieces is
that of the whole clip."""


def in_pieces(
    rows: np.ndarray,
    work: Callable[[np.ndarray], np.ndarray],
    *,
    size: int = PIECE,
    overlap: int = OVERLAP,
    margin: int = MARGIN,
) -> np.ndarray:
    """Returns the result of work on the rows of a clip, piece by piece, with the overlaps cross-faded.

    Args:
        rows: [T, D].
        work: function from rows [n, D] to rows [n, D] for any n up to `size`.
        size: frames of a piece, even.
        overlap: frames that neighbouring pieces share, even.
        margin: frames at both ends of an overlap that are taken from one piece only.

    Returns:
        [T, D]; `work(rows)` if there is one piece only.
    """
    if len(rows) <= size:
        return np.asarray(work(rows))
    done = np.zeros(rows.shape)
    fade = np.clip((np.arange(overlap) + 0.5 - margin) / (overlap - 2 * margin), 0.0, 1.0)[:, None]
    for start in range(0, len(rows) - overlap, size - overlap):
        piece = np.array(work(rows[start : start + size]), float)  # a copy, as it is changed
        if start:
            piece[:overlap] *= fade
            done[start : start + overlap] *= 1.0 - fade
        done[start : start + len(piece)] += piece
    return done
