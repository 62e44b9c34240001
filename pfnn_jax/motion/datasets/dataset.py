"""Prepared datasets on disk: one folder per style with all of its rows.

DATASET/
  dataset.json     layout, skeleton, styles, clips used, clips skipped and why, versions
  normaliser/      one for all styles, fitted to the training rows
  STYLE/           x.npy, y.npy, phase.npy in layout units, clip.npy (index into the clips of dataset.json), frame.npy,
                   windows.npy (first row and number of rows of each window)
    validation/    the same for the validation rows, and
    test/          for the test rows, if the dataset was prepared with them
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import read_json
from pfnn_jax.io.npy import StoredArray, load_array
from pfnn_jax.motion.features.layout import FrameLayout, layout_for
from pfnn_jax.motion.features.normaliser import Normaliser, load_normaliser
from pfnn_jax.motion.skeleton import Skeleton, skeleton_from_json

FORMAT = 2
"""Version of the files on disk."""

RULE = "must be a folder written by `pfnn-jax prepare`"

RULE_OF_ARRAYS = "corrupt; run `pfnn-jax prepare` again"

ARRAYS = ("x", "y", "phase", "clip", "frame")
"""Arrays with one entry per row; `windows` has one per window."""


def split_folder(folder: Path, style: str, split: str) -> Path:
    """Returns the folder of a style's arrays of a split; training rows are in the style's own folder."""
    return folder / style if split == "train" else folder / style / split


@dataclass(frozen=True, eq=False)
class Dataset:
    """A prepared dataset.

    Attributes:
        path: its folder.
        layout: layout of the rows.
        skeleton: the joints, with the bones of the first clip.
        styles: names, in alphabetical order.
        normaliser: fitted to the training rows of all styles.
        rows: split (`train`, and `validation` and `test` if prepared with them) -> style -> number of rows.
        clips: the clip of each clip index: file, style, content, mirrored, frames.
        skipped: clips skipped: file, style, reason.
        notes: what is odd about clips that are used: file, style, note.
        takes_without_window: split -> style -> number of clips, mirrored ones included, shorter than a whole window.
    """

    path: Path
    layout: FrameLayout
    skeleton: Skeleton
    styles: tuple[str, ...]
    normaliser: Normaliser
    rows: dict[str, dict[str, int]]
    clips: tuple[dict[str, Any], ...]
    skipped: tuple[dict[str, str], ...]
    notes: tuple[dict[str, str], ...]
    takes_without_window: dict[str, dict[str, int]]

    @property
    def frames(self) -> dict[str, int]:
        """Style -> number of training rows."""
        return self.rows["train"]

    @property
    def frames_per_style(self) -> int:
        """Training rows of the smallest style: an epoch is one pass through them."""
        return min(self.frames.values())

    def arrays(self, style: str, split: str = "train") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns x [N, Dx], y [N, Dy] and phase [N] or [N, G] of a style: read-only memory maps, not normalised.

        Rows are in layout units, clip after clip, in time order; a clip's mirror image follows the clip.

        Raises:
            InputError: for an unknown style, or a split that the dataset does not have.
        """
        x, y, phase = (self._load(style, split, name) for name in ARRAYS[:3])
        return x, y, phase

    def stored_arrays(self, style: str, split: str = "train") -> tuple[StoredArray, StoredArray, StoredArray]:
        """Returns x, y and phase as `arrays` does, without mapping them: indexed by row numbers, they read those rows.

        Raises:
            InputError: for an unknown style, or a split that the dataset does not have.
        """
        x, y, phase = (self._open(style, split, name) for name in ARRAYS[:3])
        return x, y, phase

    def sources(self, style: str, split: str = "train") -> tuple[np.ndarray, np.ndarray]:
        """Returns the clip index [N] into `clips` and the frame [N], at the layout's rate, of each row of a style.

        Raises:
            InputError: for an unknown style, or a split that the dataset does not have.
        """
        clip, frame = (self._load(style, split, name) for name in ARRAYS[3:])
        return clip, frame

    def windows(self, style: str, split: str = "train") -> np.ndarray:
        """Returns [C, 2] int32, the first row and number of rows of each window of a style.

        A window has 240 consecutive rows of one clip and begins 120 rows after the one before. A clip without so many
        consecutive rows has one shorter window, which its user pads by repeating the last row.

        Raises:
            InputError: for an unknown style, or a split that the dataset does not have.
        """
        windows = self._load(style, split, "windows")
        rows = self.rows[split][style]
        if windows.ndim != 2 or windows.shape[1] != 2 or (windows.sum(axis=1) > rows).any() or (windows < 0).any():
            file = split_folder(self.path, style, split) / "windows.npy"
            rule = f"must be a first row and length within {rows} rows"
            raise InputError(file, "array", f"shape {windows.shape}", rule)
        return windows

    def _open(self, style: str, split: str, name: str) -> StoredArray:
        array = StoredArray(path := self._file(style, split, name), RULE_OF_ARRAYS)
        self._check(path, array, self.rows[split][style])
        return array

    def _load(self, style: str, split: str, name: str) -> np.ndarray:
        path, rows = self._file(style, split, name), self.rows[split][style]
        array = load_array(path, RULE_OF_ARRAYS, mapped=bool(rows))
        self._check(path, array, None if name == "windows" else rows)
        return array

    def _file(self, style: str, split: str, name: str) -> Path:
        if style not in self.styles:
            raise InputError(self.path, "style", style, f"must be one of {', '.join(self.styles)}")
        if split not in self.rows:
            raise InputError(self.path, "split", split, f"must be one of {', '.join(self.rows)}, as prepared")
        return split_folder(self.path, style, split) / f"{name}.npy"

    def _check(self, path: Path, array: np.ndarray | StoredArray, rows: int | None) -> None:
        if array.dtype.kind not in "fiu" or not array.shape:
            raise InputError(path, "array", f"shape {array.shape} of {array.dtype}", "must hold rows of numbers")
        if rows is not None and len(array) != rows:
            raise InputError(path, "rows", len(array), f"must be {rows}, as in dataset.json")


def load_dataset(path: str | Path) -> Dataset:
    """Opens a prepared dataset.

    Raises:
        InputError: if it is not one, has another format version, or lacks a file.
    """
    path = Path(path)
    file = path / "dataset.json"
    data = read_json(file, RULE)
    if data.get("format") != FORMAT:
        raise InputError(file, "format", data.get("format"), f"must be {FORMAT}; run `pfnn-jax prepare` again")
    try:
        return _dataset(path, data)
    except (KeyError, TypeError) as error:
        raise InputError(file, "entry", f"{error.args[0]}"[:80] if error.args else "absent", RULE) from error


def _dataset(path: Path, data: dict[str, Any]) -> Dataset:
    """Returns the dataset of a folder, from the content of its `dataset.json`.

    Raises:
        InputError, KeyError, TypeError: if an entry is missing or of another kind.
    """
    skeleton = skeleton_from_json(data["skeleton"], path / "dataset.json")
    layout = layout_for(data["layout"], skeleton)
    normaliser = load_normaliser(path / "normaliser")
    _check_sizes(path / "normaliser", normaliser, layout)
    for style in data["styles"]:
        for split, rows in {"train": {}, **data["rows"]}.items():
            if not isinstance(rows[style], int) or rows[style] < 0:
                raise TypeError(f"rows of {split}, {style}")
    return Dataset(
        path=path,
        layout=layout,
        skeleton=skeleton,
        styles=tuple(data["styles"]),
        normaliser=normaliser,
        rows=data["rows"],
        clips=tuple(data["clips"]),
        skipped=tuple(data["skipped"]),
        notes=tuple(data["notes"]),
        takes_without_window=data["takes_without_window"],
    )


def _check_sizes(file: Path, normaliser: Normaliser, layout: FrameLayout) -> None:
    sizes = len(normaliser.inputs.mean), len(normaliser.outputs.mean)
    if sizes != (layout.input_size, layout.output_size):
        found = f"{sizes[0]} inputs and {sizes[1]} outputs"
        rule = f"must be {layout.input_size} and {layout.output_size}, as in layout {layout.name}"
        raise InputError(file, "arrays", found, rule)
