"""The rows that a network is trained on: frames of S styles, in memory or left in the files of a dataset."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.errors import InputError
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.datasets.splits import WINDOW_ROWS, row_windows
from pfnn_jax.motion.features.encode import Features, join_rows, select_rows
from pfnn_jax.motion.features.layout import Columns, FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.training.config import num_clip_columns
from pfnn_jax.training.losses import Bones, make_bones

ALIGNMENT = 64
"""Bytes of whose multiples an address must be for JAX to use host memory on a CPU device without a copy of it."""

Array = jax.Array | np.ndarray
Read = TypeVar("Read")


@struct.dataclass
class Batch:
    """Frames in normalised units, with any leading axes, and C clips of the same style as the B frames."""

    x: Array  # [..., B, Dx]
    y: Array  # [..., B, Dy]
    phase: Array  # [..., B] radians, or [..., B, G]
    clip: Array | None = None  # [..., C, T, F] joint columns of x over T consecutive frames


@struct.dataclass
class Draw:
    """Which rows and windows the minibatches of n steps consist of; row numbers count through all styles."""

    rows: Array  # [n, B] int32
    windows: Array | None = None  # [n, C, 2] int32: first row and number of rows of each clip


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of S styles, one style after another, N in all; each style has its own number of rows.

    Rows in memory are normalised float32. Rows that stay on disk are in layout units; they are read and normalised when
    they are taken, and then have the same bits as rows in memory.

    Attributes:
        styles: S names.
        parts: consecutive rows, each part x [n, Dx], y [n, Dy] and phase [n] or [n, G]: one part in memory, one of
            `StoredArray` for each style on disk. A scalar phase stays in radians.
        first_row: [S+1] first row of each style, and N.
        layout: names the columns.
        normaliser: statistics of the rows; None where they are unknown, which leaves no bone-length loss.
        is_normalised: False where `parts` are in layout units.
        windows: [W, 2] first row and number of rows of the clips of all styles; None where no clips are needed.
        first_window: [S+1] first window of each style, and W; comes with `windows`.
        first_take: [M+1] first row of each take (a clip, or its mirror image), and N; None where each style is one.
        parents: [J] parent joints, for the bone-length loss.
    """

    styles: tuple[str, ...]
    parts: tuple[Batch, ...]
    first_row: np.ndarray
    layout: FrameLayout
    normaliser: Normaliser | None = None
    is_normalised: bool = True
    windows: np.ndarray | None = None
    first_window: np.ndarray | None = None
    first_take: np.ndarray | None = None
    parents: np.ndarray | None = None

    @classmethod
    def from_features(
        cls,
        styles: Mapping[str, Sequence[Features]],
        layout: FrameLayout,
        normaliser: Normaliser,
        parents: Sequence[int] | np.ndarray | None = None,
    ) -> Rows:
        """Returns rows in memory from the features of clips.

        Args:
            styles: name -> the clips of that style.
            layout: of the features.
            normaliser: of all styles.
            parents: [J] of the skeleton, for the bone-length loss.
        """
        takes = [take for clips in styles.values() for take in clips]
        first_take = np.cumsum([0, *(len(take.x) for take in takes)])
        windows = [
            row_windows(take.frames) + np.array([row, 0], np.int32)
            for take, row in zip(takes, first_take, strict=False)
        ]
        return cls(
            styles=tuple(styles),
            parts=(to_batch(takes, normaliser),),
            first_row=np.cumsum([0, *(sum(len(take.x) for take in clips) for clips in styles.values())]),
            layout=layout,
            normaliser=normaliser,
            windows=np.concatenate(windows),
            first_window=np.cumsum([0, *_counts(styles, windows)]),
            first_take=first_take,
            parents=None if parents is None else np.asarray(parents),
        )

    @classmethod
    def from_dataset(
        cls,
        dataset: Dataset,
        styles: Sequence[str] | None = None,
        *,
        split: str = "train",
        max_bytes: int | None = None,
    ) -> Rows:
        """Returns the rows of a prepared dataset: in memory, or on disk where they exceed `max_bytes`.

        Args:
            dataset: prepared.
            styles: in the order wanted; None for all.
            split: `train`, `validation` or `test`.
            max_bytes: None to read everything into memory; 0 to leave everything on disk.

        Raises:
            InputError: for an unknown style.
        """
        names = dataset.styles if styles is None else tuple(styles)
        parts = tuple(_stored_rows(dataset, style, split) for style in names)
        clips = [dataset.windows(style, split) for style in names]
        first_row = np.cumsum([0, *(len(part.x) for part in parts)])
        moved = [windows + np.array([row, 0]) for windows, row in zip(clips, first_row, strict=False)]
        stored = cls(
            styles=tuple(names),
            parts=parts,
            first_row=first_row,
            layout=dataset.layout,
            normaliser=dataset.normaliser,
            is_normalised=False,
            windows=np.concatenate(moved).astype(np.int32),
            first_window=np.cumsum([0, *map(len, clips)]),
            parents=np.asarray(dataset.skeleton.parents),
        )
        return stored if max_bytes is not None and stored.nbytes > max_bytes else stored.in_memory()

    @property
    def nbytes(self) -> int:
        """Bytes of the rows as float32."""
        return 4 * sum(leaf.size for part in self.parts for leaf in (part.x, part.y, part.phase))

    def in_memory(self) -> Rows:
        """Returns the same rows read once, normalised and joined."""
        if self.is_normalised and len(self.parts) == 1:
            return self
        parts = [(slice(*edges), part) for edges, part in zip(pairwise(self._edges), self.parts, strict=True)]
        joined = _join(self._edges[-1], ((rows, self._normalise(_rows_of(part, slice(None)))) for rows, part in parts))
        return replace(self, parts=(joined,), is_normalised=True)

    def on_device(self) -> Batch:
        """Returns all rows [N, ...] as arrays on the default device: on a CPU the same memory, if rows were on disk."""
        return jax.device_put(self.in_memory().parts[0])

    def take(self, rows: np.ndarray) -> Batch:
        """Returns rows [...] of any styles, in host memory."""
        return self._read(rows, lambda part, own: self._normalise(_rows_of(part, own)))

    def take_clips(self, windows: np.ndarray, num_frames: int = WINDOW_ROWS) -> np.ndarray:
        """Returns the joint columns [..., T, F] of windows [..., 2]; see `window_rows` for short ones."""
        columns = clip_columns(self.layout)
        rows = window_rows(np.asarray(windows), num_frames)
        return self._read(rows, lambda part, own: self._inputs(part.x[own])[:, columns])

    def gather(self, draw: Draw) -> Batch:
        """Returns the minibatch of one step, or those of several, in host memory."""
        batch = self.take(np.asarray(draw.rows))
        if draw.windows is None:
            return batch
        return replace(batch, clip=self.take_clips(np.asarray(draw.windows)))

    def windows_of(self, style: int) -> np.ndarray:
        """Returns the windows [W, 2] of one style, by its number."""
        if self.windows is None or self.first_window is None:
            raise ValueError("`windows` are needed where clips are read, got None.")
        return self.windows[self.first_window[style] : self.first_window[style + 1]]

    def bones(self) -> Bones:
        """Returns the bones of the rows, for the bone-length loss.

        Raises:
            ValueError: if `parents` or `normaliser` are not known.
        """
        if self.parents is None or self.normaliser is None:
            raise ValueError("`rows` must have `parents` and a `normaliser` where a bone-length loss is used.")
        return make_bones(self.layout, self.parents, self.normaliser.outputs)

    def hold_out(self, share: float) -> tuple[Batch, Batch]:
        """Splits each take in time: its first rows to learn from, its last `share` of rows to choose by.

        Neighbouring frames are almost equal: frames held out at random would measure memory.

        Raises:
            InputError: if a take is too short to leave rows on both sides.
        """
        edges = self.first_row if self.first_take is None else self.first_take
        learn, held = [], []
        for first, stop in zip(edges[:-1], edges[1:], strict=True):
            middle = first + _learning_rows(int(stop - first), share, ", ".join(self.styles))
            learn.append(np.arange(first, middle))
            held.append(np.arange(middle, stop))
        return self.take(np.concatenate(learn)), self.take(np.concatenate(held))

    def _inputs(self, x: Array) -> np.ndarray:
        if self.is_normalised or self.normaliser is None:
            return np.asarray(x)
        return np.asarray(self.normaliser.inputs.apply(np.asarray(x)), np.float32)

    def _normalise(self, part: Batch) -> Batch:
        if self.is_normalised or self.normaliser is None:
            return part
        return normalised(np.asarray(part.x), np.asarray(part.y), np.asarray(part.phase), self.normaliser)

    @property
    def _edges(self) -> list[int]:
        """Returns the first row of each part, and N."""
        return np.cumsum([0, *(len(part.x) for part in self.parts)]).tolist()

    def _read(self, rows: np.ndarray, read: Callable[[Batch, np.ndarray], Read]) -> Read:
        """Returns `read` of the rows [...]; every part, e.g. a style's files, is read once."""
        flat = rows.reshape(-1)
        owners = np.searchsorted(self._edges, flat, side="right") - 1
        order = np.argsort(owners, kind="stable")
        present, counts = np.unique(owners, return_counts=True)
        places = np.split(order, np.cumsum(counts)[:-1])
        found = (
            (place, read(self.parts[owner], flat[place] - self._edges[owner]))
            for owner, place in zip(present.tolist(), places, strict=True)
        )
        joined = _join(len(flat), found)
        return jax.tree.map(lambda leaf: leaf.reshape(*rows.shape, *leaf.shape[1:]), joined)


def _stored_rows(dataset: Dataset, style: str, split: str) -> Batch:
    arrays: Any = dataset.stored_arrays(style, split)  # of which rows are taken as of arrays in memory
    return Batch(*arrays)


def _rows_of(part: Batch, rows: np.ndarray | slice) -> Batch:
    return jax.tree.map(lambda leaf: leaf[rows], part)


def _join(count: int, parts: Iterable[tuple[np.ndarray | slice, Any]]) -> Any:
    """Returns the rows [count, ...] of all parts (places, rows) at their places; one part at a time is in memory."""
    joined = None
    for places, part in parts:
        if joined is None:
            joined = jax.tree.map(lambda leaf: _empty((count, *leaf.shape[1:]), leaf.dtype), part)
        for whole, own in zip(jax.tree.leaves(joined), jax.tree.leaves(part), strict=True):
            whole[places] = own
    return joined


def _empty(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """Returns an array of any numbers that begins where `ALIGNMENT` says."""
    size = math.prod(shape) * dtype.itemsize
    room = np.empty(size + ALIGNMENT, np.uint8)
    begin = -room.ctypes.data % ALIGNMENT
    return room[begin : begin + size].view(dtype).reshape(shape)


def evenly_spaced(count: int, most: int) -> np.ndarray:
    """Returns the numbers below `count`, or so many of them, evenly spaced from the first to the last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(int)


def clip_columns(layout: FrameLayout) -> Columns:
    """Returns the columns of x that a clip holds: all joint blocks, in stored order; 12 J in the layouts of 2022.

    Raises:
        ValueError: if x has no joints.
    """
    columns = np.flatnonzero(layout.joint_inputs)
    if not columns.size:
        raise ValueError(f"`layout` must have joints in its inputs, got {layout.name}.")
    contiguous = columns[-1] - columns[0] + 1 == columns.size
    return slice(int(columns[0]), int(columns[-1]) + 1) if contiguous else columns


def window_rows(windows, num_frames: int, xp=np):
    """Returns row numbers [..., T] of windows [..., 2]; a window shorter than T is padded by its last row."""
    first, count = windows[..., :1], windows[..., 1:]
    frames = xp.arange(num_frames, dtype=windows.dtype).reshape((1,) * (windows.ndim - 1) + (-1,))
    return first + xp.minimum(frames, count - 1)


def make_gather(layout: FrameLayout) -> Callable[[Batch, Draw], Batch]:
    """Returns (all rows, the draw of one step) -> minibatch, to be compiled; `Rows.gather` is its twin on the host."""
    columns = clip_columns(layout) if num_clip_columns(layout) else None

    def gather(data: Batch, draw: Draw) -> Batch:
        batch = jax.tree.map(lambda leaf: leaf[draw.rows], data)
        if draw.windows is None:
            return batch
        return replace(batch, clip=data.x[window_rows(draw.windows, WINDOW_ROWS, jnp)][..., columns])

    return gather


def join_batches(parts: Sequence[Batch]) -> Batch:
    """Returns the rows [N, ...] of all parts, one after another."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def to_batch(parts: Sequence[Features], normaliser: Normaliser) -> Batch:
    """Returns all rows [N, ...] of the parts, one after another, as normalised float32."""
    rows = join_rows(parts)
    return normalised(rows.x, rows.y, rows.phase, normaliser)


def normalised(x: np.ndarray, y: np.ndarray, phase: np.ndarray, normaliser: Normaliser) -> Batch:
    """Returns rows in layout units as the float32 that a network reads; a scalar phase stays in radians."""
    if normaliser.phases is not None:
        phase = normaliser.phases.apply(phase)
    rows = normaliser.inputs.apply(x), normaliser.outputs.apply(y), phase
    return Batch(*(np.asarray(values, np.float32) for values in rows))


def hold_out(parts: Sequence[Features], share: float, source: str = "clip") -> tuple[list[Features], list[Features]]:
    """Splits each part in time, as `Rows.hold_out` does.

    Raises:
        InputError: if a part is too short to leave rows on both sides.
    """
    learn, held = [], []
    for part in parts:
        count = _learning_rows(len(part.x), share, source)
        learn.append(select_rows(part, slice(0, count)))
        held.append(select_rows(part, slice(count, None)))
    return learn, held


def _learning_rows(num_rows: int, share: float, source: str) -> int:
    count = round(num_rows * (1 - share))
    if not 0 < count < num_rows:
        raise InputError(source, "frames", num_rows, f"holding out {share:g} must leave some on each side")
    return count


def _counts(styles: Mapping[str, Sequence[Features]], windows: Sequence[np.ndarray]) -> list[int]:
    """Returns the number of windows of each style, from those of each take."""
    remaining = iter(windows)
    return [sum(len(next(remaining)) for _ in clips) for clips in styles.values()]
