"""The folder of one style in a dataset: arrays that grow take by take, one set for each split."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from pfnn_jax.io.npy import NpyWriter
from pfnn_jax.motion.datasets.splits import WINDOW
from pfnn_jax.motion.datasets.takes import TakeRows
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.motion.features.layout import FrameLayout

ARRAYS = ("x", "y", "phase", "clip", "frame")
"""Arrays with a line for each row; `windows` has one for each window."""


def split_folder(folder: Path, style: str, split: str) -> Path:
    """Where a style's arrays of a split lie: those to train on in the style's own folder."""
    return folder / style if split == "train" else folder / style / split


class StyleWriter:
    """Writes the rows of one style as they come.

    Attributes:
        rows: split -> rows written.
        short: split -> takes, mirrored ones included, without a whole window of rows.
    """

    def __init__(self, folder: Path, style: str, splits: tuple[str, ...], layout: FrameLayout):
        """Makes the style's folders.

        Raises:
            OSError: if they cannot be written.
        """
        self.rows, self.short = dict.fromkeys(splits, 0), dict.fromkeys(splits, 0)
        self._files: dict[str, dict[str, NpyWriter]] = {}
        with ExitStack() as opened:
            for split in splits:
                place = split_folder(folder, style, split)
                place.mkdir()
                self._files[split] = {}
                for name, (dtype, width) in _kinds(layout).items():
                    self._files[split][name] = NpyWriter(place / f"{name}.npy", dtype, width)
                    opened.callback(self._files[split][name].close)
            self._opened = opened.pop_all()

    def add(self, take: TakeRows, index: int) -> None:
        """Writes the rows of a take, which stands at `index` among the dataset's clips.

        Raises:
            OSError: if they cannot be written.
        """
        for split, part in take.parts.items():
            arrays = _arrays(part.rows, index) | {"windows": part.windows + np.array([self.rows[split], 0])}
            for name, array in arrays.items():
                self._files[split][name].append(array)
            self.rows[split] += len(part.rows.frames)
            self.short[split] += int(part.windows[0, 1] < WINDOW)

    def close(self) -> None:
        """Completes all files."""
        self._opened.close()


def _arrays(rows: Features, index: int) -> dict[str, np.ndarray]:
    return {
        "x": rows.x,
        "y": rows.y,
        "phase": rows.phase,
        "clip": np.full(len(rows.frames), index),
        "frame": rows.frames,
    }


def _kinds(layout: FrameLayout) -> dict[str, tuple[np.dtype, tuple[int, ...]]]:
    phase = (layout.phase_size,) if layout.phase_size else ()
    floats = {"x": (layout.input_size,), "y": (layout.output_size,), "phase": phase}
    whole = {"clip": (), "frame": (), "windows": (2,)}
    single, count = np.dtype(np.float32), np.dtype(np.int32)
    kinds = {name: (single, width) for name, width in floats.items()}
    return kinds | {name: (count, width) for name, width in whole.items()}
