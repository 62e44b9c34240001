"""Prepared datasets: features of many clips on disk, one folder per style, with all of its rows.

DATASET/
  dataset.json     layout, skeleton, styles, clips used, clips left out and why, versions
  normaliser/      one for all styles, of the rows to train on
  STYLE/           x.npy, y.npy, phase.npy in layout units, clip.npy (index into the clips of dataset.json), frame.npy,
                   windows.npy (first row and number of rows of each window)
    validation/    the same of the rows kept for choosing, and
    test/          of those kept for testing, where they were asked for
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure, refuse_existing, swap_folder
from pfnn_jax.motion.datasets.preparation import FORMAT, PrepareConfig, Progress, write_dataset
from pfnn_jax.motion.datasets.style_writer import ARRAYS, split_folder
from pfnn_jax.motion.datasets.takes import Source
from pfnn_jax.motion.features.layout import FrameLayout, layout_for
from pfnn_jax.motion.features.normaliser import Normaliser, load_normaliser
from pfnn_jax.motion.skeleton import Skeleton, skeleton_from_json


@dataclass(frozen=True, eq=False)
class Dataset:
    """A prepared dataset.

    Attributes:
        path: its folder.
        layout: of the rows.
        skeleton: the joints, with the bones of the first clip.
        styles: names, in alphabetical order.
        normaliser: over all styles' rows to train on.
        rows: split (`train`, and `validation` and `test` where they were asked for) -> style -> rows.
        clips: what each clip index stands for: file, style, content, mirrored, frames.
        skipped: clips left out: file, style, reason.
        notes: what was odd about clips that are used: file, style, note.
        takes_without_window: split -> style -> takes, mirrored ones included, shorter than a whole window.
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
        """Style -> rows to train on."""
        return self.rows["train"]

    @property
    def frames_per_style(self) -> int:
        """Rows to train on of the style that has fewest: an epoch is one pass through them."""
        return min(self.frames.values())

    def arrays(self, style: str, split: str = "train") -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x [N, Dx], y [N, Dy] and phase [N] or [N, G] of a style: read-only memory maps, not normalised.

        Rows are in layout units, take after take, in time order; a take's mirror image follows the take.

        Raises:
            InputError: for an unknown style, or a split that the dataset does not have.
        """
        x, y, phase = (self._load(style, split, name) for name in ARRAYS[:3])
        return x, y, phase

    def sources(self, style: str, split: str = "train") -> tuple[np.ndarray, np.ndarray]:
        """Clip index [N] into `clips`, and frame [N] in that clip at the layout's rate, of each row of a style.

        Raises:
            InputError: for an unknown style, or a split that the dataset does not have.
        """
        clip, frame = (self._load(style, split, name) for name in ARRAYS[3:])
        return clip, frame

    def clips_of(self, style: str, split: str = "train") -> np.ndarray:
        """[C, 2] int32 first row and number of rows of the windows of a style.

        A window is 240 consecutive rows of one take, 120 rows after the one before; a take without so many gives one
        shorter window, which its user pads by its ends.

        Raises:
            InputError: for an unknown style, or a split that the dataset does not have.
        """
        windows = self._load(style, split, "windows")
        rows = self.rows[split][style]
        if windows.ndim != 2 or windows.shape[1] != 2 or (windows.sum(axis=1) > rows).any() or (windows < 0).any():
            place = split_folder(self.path, style, split) / "windows.npy"
            raise InputError(place, "array", f"shape {windows.shape}", f"first row and length within {rows} rows")
        return windows

    def _load(self, style: str, split: str, name: str) -> np.ndarray:
        if style not in self.styles:
            raise InputError(self.path, "style", style, f"must be one of {', '.join(self.styles)}")
        if split not in self.rows:
            raise InputError(self.path, "split", split, f"this dataset was prepared with {', '.join(self.rows)}")
        path, rows = split_folder(self.path, style, split) / f"{name}.npy", self.rows[split][style]
        try:
            array = np.load(path, mmap_mode="r" if rows else None, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(path, "array", failure(error), "must be as prepare wrote it") from error
        if name != "windows" and len(array) != rows:
            raise InputError(path, "rows", len(array), f"must be {rows}, as in dataset.json")
        return array


def prepare(
    clips: Sequence[Source],
    out: Path,
    config: PrepareConfig,
    *,
    roles_file: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
    workers: int | None = None,
) -> Dataset:
    """Features of many clips, written to a folder.

    Where the layout wants the phase of the gait cycle, a `.phase` file beside a BVH file wins over the labeller, and
    clips without steps are left out and named in `dataset.json`, as are clips too short for any layout, and idle takes
    under the `mason2022` layouts. Symmetric styles get mirrored copies, in which left and right change places. Every
    style keeps all of its rows. Rows kept for validation and testing are one contiguous block each of every clip, and
    the same of its mirror image; transitions between gaits are all trained on. The folder appears whole or not at all,
    and is the same whatever the order of the clips and the number of processes.

    Args:
        clips: files as `sources.list_clips` returns them, or labelled clips in memory, or both.
        out: folder to make.
        config: layout, mirroring, statistics, splits.
        roles_file: JSON naming the joints' roles.
        overwrite: replace an existing folder.
        progress: called with (clips done, clips in all, name) after each clip.
        workers: processes; None for one per processor (at most 8) where there is much to read.

    Raises:
        InputError: for no clips, no workers, a style of which nothing remains, skeletons that differ, bad files, an
            existing folder, or one that cannot be written.
    """
    out = Path(out)
    refuse_existing(out, overwrite)
    if not clips:
        raise InputError(out, "clips", "none", "a dataset needs at least one clip")
    if workers is not None and workers < 1:
        raise InputError(out, "workers", workers, "at least one process must work")
    work = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        work.mkdir(parents=True)
        write_dataset(clips, work, config, roles_file, progress, workers)
        swap_folder(work, out)
    except OSError as error:
        raise InputError(out, "folder", failure(error), "must be writable, with space for the dataset") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return load_dataset(out)


def load_dataset(path: Path) -> Dataset:
    """Opens a prepared dataset.

    Raises:
        InputError: if it is not one, is of another format, or misses a file.
    """
    path = Path(path)
    file = path / "dataset.json"
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(file, "file", failure(error), "a dataset is a folder that prepare has written") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise InputError(file, "format", found, f"this version reads format {FORMAT}")
    skeleton = skeleton_from_json(data["skeleton"], file)
    layout = layout_for(data["layout"], skeleton)
    normaliser = load_normaliser(path / "normaliser")
    sizes = len(normaliser.inputs.mean), len(normaliser.outputs.mean)
    if sizes != (layout.input_size, layout.output_size):
        raise InputError(
            path / "normaliser",
            "arrays",
            f"{sizes[0]} inputs and {sizes[1]} outputs",
            f"layout {layout.name} has {layout.input_size} and {layout.output_size}",
        )
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
