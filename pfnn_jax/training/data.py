"""The rows of a prepared dataset for training: read into memory, or left on disk where they are too many."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.errors import InputError
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.features.encode import Features, join_rows, select_rows
from pfnn_jax.motion.features.layout import Columns, FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics

Array = jax.Array | np.ndarray

CLIP_FRAMES = 240
"""Frames of the clips that a FiLM generator reads: 4 seconds at 60 fps (Mason 2022 §4.3)."""


@struct.dataclass
class Batch:
    """Frames in normalised units; any leading axes. C clips of the same style stand beside B frames."""

    x: Array  # [..., B, Dx]
    y: Array  # [..., B, Dy]
    phase: Array  # [..., B] radians, or [..., B, G]
    clip: Array | None = None  # [..., C, T, F] joint columns of x over T frames of a take


@struct.dataclass
class Draw:
    """What the minibatches of n steps are made of; row numbers count through all styles."""

    rows: Array  # [n, B] int32
    windows: Array | None = None  # [n, C, 2] int32: first row and number of rows of every clip


@dataclass(frozen=True, eq=False)
class StyleData:
    """The rows of S styles, one style after another, each in its own number; in memory.

    Attributes:
        x, y, phase: [N, Dx], [N, Dy] and [N] or [N, G], normalised (a scalar phase stays in radians).
        first_row: [S+1] first row of every style, and N.
        layout: names the columns.
        windows: [W, 2] first row and number of rows of the clips of all styles, or None where no clips are needed.
        first_window: [S+1] first window of every style, and W; with `windows`.
        parents: [J] parent joints, for the bone-length loss; None where it is not used.
        outputs: statistics that y was normalised with, for the same.
    """

    x: Array
    y: Array
    phase: Array
    first_row: np.ndarray
    layout: FrameLayout
    windows: np.ndarray | None = None
    first_window: np.ndarray | None = None
    parents: np.ndarray | None = None
    outputs: Statistics | None = None

    @property
    def nbytes(self) -> int:
        """Bytes of the rows."""
        return self.x.nbytes + self.y.nbytes + self.phase.nbytes

    def take(self, rows: np.ndarray) -> Batch:
        """Rows [...] of one style or of several."""
        return Batch(self.x[rows], self.y[rows], self.phase[rows])

    def take_clips(self, index: np.ndarray, columns: Columns) -> Array:
        """Columns of x at rows [..., T]."""
        return self.x[index][..., columns]


class Rows(Protocol):
    """Rows of S styles, in memory (`StyleData`) or on disk (`stored.StoredData`)."""

    @property
    def first_row(self) -> np.ndarray: ...
    @property
    def layout(self) -> FrameLayout: ...
    @property
    def windows(self) -> np.ndarray | None: ...
    @property
    def first_window(self) -> np.ndarray | None: ...
    @property
    def parents(self) -> np.ndarray | None: ...
    @property
    def outputs(self) -> Statistics | None: ...
    @property
    def nbytes(self) -> int: ...
    def take(self, rows: np.ndarray, /) -> Batch: ...
    def take_clips(self, index: np.ndarray, columns: Columns, /) -> Array: ...


def clip_columns(layout: FrameLayout) -> Columns:
    """Columns of x that a clip holds: all joint blocks, in stored order; 12 J under the layouts of 2022.

    Raises:
        ValueError: if x has no joints.
    """
    columns = np.flatnonzero([name.startswith("joint_") for name in layout.input_names])
    if not columns.size:
        raise ValueError(f"`layout` must have joints in its inputs, got {layout.name}.")
    contiguous = columns[-1] - columns[0] + 1 == columns.size
    return slice(int(columns[0]), int(columns[-1]) + 1) if contiguous else columns


def num_clip_columns(layout: FrameLayout) -> int:
    """F, the width of `clip_columns`."""
    return sum(name.startswith("joint_") for name in layout.input_names)


def window_rows(windows, num_frames: int, xp=np):
    """Row numbers [..., T] of windows [..., 2]; a window shorter than T is padded by its last row."""
    first, count = windows[..., :1], windows[..., 1:]
    frames = xp.arange(num_frames, dtype=windows.dtype).reshape((1,) * (windows.ndim - 1) + (-1,))
    return first + xp.minimum(frames, count - 1)


def cut_windows(num_rows: int, length: int = CLIP_FRAMES, stride: int = CLIP_FRAMES // 2) -> np.ndarray:
    """Windows [W, 2] (first row, number of rows) of consecutive rows; one shorter window where there are few rows."""
    if num_rows < length:
        return np.array([[0, num_rows]], np.int32)
    starts = np.arange(0, num_rows - length + 1, stride, dtype=np.int32)
    return np.stack([starts, np.full_like(starts, length)], axis=1)


def make_gather(layout: FrameLayout, clip_frames: int = CLIP_FRAMES) -> Callable[..., Batch]:
    """A function (x, y, phase as a Batch, one step's Draw) -> Batch, on the device."""
    columns = clip_columns(layout) if any(name.startswith("joint_") for name in layout.input_names) else None

    def gather(data: Batch, draw: Draw) -> Batch:
        batch = jax.tree.map(lambda leaf: leaf[draw.rows], data)
        if draw.windows is None:
            return batch
        clip = data.x[window_rows(draw.windows, clip_frames, jnp)][..., columns]
        return Batch(batch.x, batch.y, batch.phase, clip)

    return gather


def gather_from(data: Rows, draw: Draw, clip_frames: int = CLIP_FRAMES) -> Batch:
    """The same in host memory or from disk, for the draw of one step or of several."""
    batch = data.take(np.asarray(draw.rows))
    if draw.windows is None:
        return batch
    index = window_rows(np.asarray(draw.windows), clip_frames)
    return Batch(batch.x, batch.y, batch.phase, data.take_clips(index, clip_columns(data.layout)))


def to_batch(parts: Sequence[Features], normaliser: Normaliser) -> Batch:
    """All rows [N, ...] of the parts, one after another, normalised float32."""
    rows = join_rows(parts)
    return normalised(rows.x, rows.y, rows.phase, normaliser)


def normalised(x: np.ndarray, y: np.ndarray, phase: np.ndarray, normaliser: Normaliser) -> Batch:
    """Rows in layout units as float32 that a network reads; a scalar phase stays in radians."""
    if normaliser.phases is not None:
        phase = normaliser.phases.apply(phase)
    rows = normaliser.inputs.apply(x), normaliser.outputs.apply(y), phase
    return Batch(*(np.asarray(values, np.float32) for values in rows))


def style_data(
    styles: Mapping[str, Sequence[Features]],
    layout: FrameLayout,
    normaliser: Normaliser,
    parents: Sequence[int] | np.ndarray | None = None,
) -> StyleData:
    """Training data in memory from the rows of clips.

    Args:
        styles: name -> the clips of that style.
        layout: of the rows.
        normaliser: of all styles.
        parents: [J] of the skeleton, for the bone-length loss.
    """
    batches = [to_batch(clips, normaliser) for clips in styles.values()]
    first_row = np.cumsum([0, *(len(batch.x) for batch in batches)])
    windows, row = [], 0
    for clip in (clip for clips in styles.values() for clip in clips):
        ends = np.flatnonzero(np.diff(clip.frames) != 1) + 1  # a clip may miss frames, e.g. unlabelled ones
        for part in np.split(np.arange(row, row + len(clip.x)), ends):
            windows.append(cut_windows(len(part)) + np.array([part[0], 0], np.int32))
        row += len(clip.x)
    return StyleData(
        x=np.concatenate([batch.x for batch in batches]),
        y=np.concatenate([batch.y for batch in batches]),
        phase=np.concatenate([batch.phase for batch in batches]),
        first_row=first_row,
        layout=layout,
        windows=np.concatenate(windows),
        first_window=np.searchsorted(np.concatenate(windows)[:, 0], first_row),
        parents=None if parents is None else np.asarray(parents),
        outputs=normaliser.outputs,
    )


def hold_out(parts: Sequence[Features], share: float, source: str = "clip") -> tuple[list[Features], list[Features]]:
    """Each part cut in time: its first rows to learn from, its last `share` of rows to choose by.

    Neighbouring frames are almost equal, so frames held out at random would measure memory.

    Raises:
        InputError: if a part is too short to leave rows on both sides.
    """
    learn, choose = [], []
    for part in parts:
        count = round(len(part.x) * (1 - share))
        if not 0 < count < len(part.x):
            raise InputError(source, "frames", len(part.x), f"holding out {share:g} must leave some on each side")
        learn.append(select_rows(part, slice(0, count)))
        choose.append(select_rows(part, slice(count, None)))
    return learn, choose


@dataclass(frozen=True, eq=False)
class StoredData:
    """Rows of S styles that stay in the dataset's files; what is taken is normalised, with the bits of `in_memory`.

    Attributes:
        dataset: prepared.
        arrays: x, y and phase of every style, memory maps in layout units.
        first_row: [S+1] first row of every style, and N.
        windows: [W, 2] first row and number of rows of the clips of all styles.
        first_window: [S+1] first window of every style, and W.
    """

    dataset: Dataset
    arrays: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    first_row: np.ndarray
    windows: np.ndarray
    first_window: np.ndarray

    @property
    def layout(self) -> FrameLayout:
        """Of the rows."""
        return self.dataset.layout

    @property
    def parents(self) -> np.ndarray:
        """[J] parent joints."""
        return np.asarray(self.dataset.skeleton.parents)

    @property
    def outputs(self) -> Statistics:
        """Statistics of y."""
        return self.dataset.normaliser.outputs

    @property
    def nbytes(self) -> int:
        """Bytes of the rows as float32."""
        return 4 * sum(array.size for arrays in self.arrays for array in arrays)

    def take(self, rows: np.ndarray) -> Batch:
        """Rows [...] of any styles, normalised."""
        x, y, phase = (self._read(rows, which) for which in range(3))
        return normalised(x, y, phase, self.dataset.normaliser)

    def take_clips(self, index: np.ndarray, columns: Columns) -> np.ndarray:
        """Columns of normalised x at rows [..., T]."""
        return np.asarray(self.dataset.normaliser.inputs.apply(self._read(index, 0)), np.float32)[..., columns]

    def in_memory(self) -> StyleData:
        """All rows, read once."""
        styles = [normalised(x, y, phase, self.dataset.normaliser) for x, y, phase in self.arrays]
        return StyleData(
            x=np.concatenate([style.x for style in styles]),
            y=np.concatenate([style.y for style in styles]),
            phase=np.concatenate([style.phase for style in styles]),
            first_row=self.first_row,
            layout=self.layout,
            windows=self.windows,
            first_window=self.first_window,
            parents=self.parents,
            outputs=self.outputs,
        )

    def _read(self, rows: np.ndarray, which: int) -> np.ndarray:
        """One array's rows [...]; each style's file is read once."""
        flat, first = rows.reshape(-1), self.arrays[0][which]
        found = np.empty((len(flat), *first.shape[1:]), first.dtype)
        owners = np.searchsorted(self.first_row, flat, side="right") - 1
        for style in np.unique(owners):
            own = owners == style
            found[own] = self.arrays[style][which][flat[own] - self.first_row[style]]
        return found.reshape(*rows.shape, *first.shape[1:])


def stored_rows(dataset: Dataset, styles: Sequence[str] | None = None, *, split: str = "train") -> StoredData:
    """The rows of a prepared dataset, left on disk; arguments as in `dataset_rows`."""
    names = dataset.styles if styles is None else tuple(styles)
    arrays = tuple(dataset.arrays(style, split) for style in names)
    clips = [dataset.windows(style, split) for style in names]
    first_row = np.cumsum([0, *(len(x) for x, _, _ in arrays)])
    moved = [windows + np.array([row, 0]) for windows, row in zip(clips, first_row, strict=False)]
    return StoredData(
        dataset=dataset,
        arrays=arrays,
        first_row=first_row,
        windows=np.concatenate(moved).astype(np.int32),
        first_window=np.cumsum([0, *map(len, clips)]),
    )


def dataset_rows(
    dataset: Dataset, styles: Sequence[str] | None = None, *, split: str = "train", limit: int | None = None
) -> Rows:
    """The rows of a prepared dataset: in memory, or left on disk where they are more than `limit` bytes.

    Args:
        dataset: prepared.
        styles: in the order wanted; None for all.
        split: `train`, `validation` or `test`.
        limit: bytes; None to read everything into memory.

    Raises:
        InputError: for an unknown style.
    """
    stored = stored_rows(dataset, styles, split=split)
    return stored if limit is not None and stored.nbytes > limit else stored.in_memory()
