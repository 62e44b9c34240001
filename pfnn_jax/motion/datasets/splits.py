"""Which rows of a take are trained on, validated on and tested on, and where windows of consecutive rows lie."""

from __future__ import annotations

import zlib

import numpy as np

SPLITS = ("train", "validation", "test")
"""Names of the parts of a dataset; a row's part is an index here."""

WINDOW, STRIDE = 240, 120
"""Rows of a window and from one window to the next: 4 s and 2 s (Mason 2022, section 4.3)."""


def take_generator(seed: int, style: str, name: str) -> np.random.Generator:
    """Random numbers of one take: the same wherever it stands in a list of takes.

    Args:
        seed: of the dataset.
        style: of the take.
        name: of its file.
    """
    return np.random.default_rng([seed, zlib.crc32(f"{style}/{name}".encode())])


def split_blocks(count: int, validation: float, test: float, rng: np.random.Generator) -> np.ndarray:
    """[count] part of each row: one contiguous block of each part that is not trained on, at random places.

    All places of two blocks that do not overlap are equally likely, whichever comes first (Mason 2022: one block of a
    tenth for each part of every take).

    Args:
        count: rows of a take.
        validation, test: shares of the rows, together below 1.
        rng: the take's.
    """
    sizes = [round(count * validation), round(count * test)]
    order = rng.permutation(2)
    gaps = np.sort(rng.integers(0, count - sum(sizes) + 1, 2))
    parts = np.zeros(count, np.int8)
    start = 0
    for block, gap in zip(order, gaps, strict=True):
        first = start + int(gap)
        parts[first : first + sizes[block]] = block + 1
        start += sizes[block]
    return parts


def row_windows(frames: np.ndarray, length: int = WINDOW, stride: int = STRIDE) -> np.ndarray:
    """[C, 2] int32 (first row, number of rows) of windows of consecutive frames.

    Windows lie within runs of consecutive frames, `stride` apart. Rows without a run of `length` give one shorter
    window: their longest run.

    Args:
        frames: [N] increasing frame of each row of a take.
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
