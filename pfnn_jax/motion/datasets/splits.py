"""Divides the rows of a clip among training, validation and test, and into windows of consecutive rows."""

from __future__ import annotations

import zlib

import numpy as np

SPLITS = ("train", "validation", "test")
"""Names of the parts of a dataset; `split_blocks` returns indices into this tuple."""

WINDOW_ROWS, WINDOW_STRIDE = 240, 120
"""Rows of a window, and rows from one window to the next: 4 s and 2 s (Mason 2022, section 4.3)."""


def clip_generator(seed: int, style: str, name: str) -> np.random.Generator:
    """Returns the random generator of one clip, which does not depend on the clip's position in a list.

    Args:
        seed: of the dataset.
        style: of the clip.
        name: of its file.
    """
    return np.random.default_rng([seed, zlib.crc32(f"{style}/{name}".encode())])


def split_blocks(count: int, validation: float, test: float, rng: np.random.Generator) -> np.ndarray:
    """Returns [count], the split of each row: validation and test are one contiguous block each, at random positions.

    All pairs of positions at which the blocks do not overlap are equally likely, in either order (Mason 2022: one block
    of a tenth for each part of every clip).

    Args:
        count: number of rows of a clip.
        validation, test: shares of the rows, together below 1.
        rng: the clip's.
    """
    sizes = [round(count * validation), round(count * test)]
    order = rng.permutation(2)
    gaps = np.sort(rng.integers(0, count - sum(sizes) + 1, 2))
    splits = np.zeros(count, np.int8)
    start = 0
    for block, gap in zip(order, gaps, strict=True):
        first = start + int(gap)
        splits[first : first + sizes[block]] = block + 1
        start += sizes[block]
    return splits


def row_windows(frames: np.ndarray, length: int = WINDOW_ROWS, stride: int = WINDOW_STRIDE) -> np.ndarray:
    """Returns [C, 2] int32, (first row, number of rows) of windows of consecutive frames.

    Windows lie within runs of consecutive frames, `stride` rows apart. Rows without a run of `length` give one shorter
    window: their longest run.

    Args:
        frames: [N] increasing frame of each row of a clip.
        length: rows of a window.
        stride: rows from one window to the next.
    """
    if not len(frames):
        return np.empty((0, 2), np.int32)
    breaks = np.flatnonzero(np.diff(frames) != 1) + 1
    starts, stops = np.concatenate([[0], breaks]), np.concatenate([breaks, [len(frames)]])
    firsts = [np.arange(a, b - length + 1, stride) for a, b in zip(starts, stops, strict=True)]
    first = np.concatenate(firsts)
    if len(first):
        return np.stack([first, np.full(len(first), length)], axis=1).astype(np.int32)
    longest = int(np.argmax(stops - starts))
    return np.array([[starts[longest], stops[longest] - starts[longest]]], np.int32)
