"""Style-cycled minibatches: every batch holds frames of one style, and the styles take turns (Mason 2018 Eq. 5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.motion.blocks import Columns
from pfnn_jax.motion.frame_layout import FrameLayout
from pfnn_jax.motion.normaliser import Statistics

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
