"""The rows of a prepared dataset for training: read into memory, or left on disk where they are too many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.blocks import Columns
from pfnn_jax.motion.dataset import Dataset
from pfnn_jax.motion.frame_layout import FrameLayout
from pfnn_jax.motion.normaliser import Statistics
from pfnn_jax.training.batches import Batch, Rows, StyleData
from pfnn_jax.training.style_data import normalised


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
    clips = [dataset.clips_of(style, split) for style in names]
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
