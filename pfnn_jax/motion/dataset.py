"""Prepared datasets: features of many clips on disk, one folder per style, balanced to equal frames per style.

DATASET/
  dataset.json     layout, skeleton, styles, clips used, clips left out and why, versions
  normaliser/      one for all styles
  STYLE/           x.npy, y.npy, phase.npy in layout units, clip.npy (index into the clips of dataset.json), frame.npy
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
from pfnn_jax.motion.layout import LAYOUTS, FrameLayout
from pfnn_jax.motion.normaliser import Normaliser, load_normaliser
from pfnn_jax.motion.preparation import ARRAYS, FORMAT, PrepareConfig, Progress, Source, write_dataset
from pfnn_jax.motion.skeleton import Skeleton, skeleton_from_json


@dataclass(frozen=True, eq=False)
class Dataset:
    """A prepared dataset.

    Attributes:
        path: its folder.
        layout: of the rows.
        skeleton: the joints, with the bones of the first clip.
        styles: names, in alphabetical order.
        normaliser: over all styles.
        frames_per_style: rows of each style.
        clips: what each clip index stands for: file, style, content, mirrored, frames (before balancing).
        skipped: clips left out: file, style, reason.
    """

    path: Path
    layout: FrameLayout
    skeleton: Skeleton
    styles: tuple[str, ...]
    normaliser: Normaliser
    frames_per_style: int
    clips: tuple[dict[str, Any], ...]
    skipped: tuple[dict[str, str], ...]

    def arrays(self, style: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """x [N, Dx], y [N, Dy] and phase [N] of a style: read-only memory maps, layout units, not normalised.

        Raises:
            InputError: for an unknown style.
        """
        x, y, phase = (self._load(style, name) for name in ARRAYS[:3])
        return x, y, phase

    def sources(self, style: str) -> tuple[np.ndarray, np.ndarray]:
        """Clip index [N] into `clips`, and frame [N] in that clip at the layout's rate, of each row of a style.

        Raises:
            InputError: for an unknown style.
        """
        clip, frame = (self._load(style, name) for name in ARRAYS[3:])
        return clip, frame

    def _load(self, style: str, name: str) -> np.ndarray:
        if style not in self.styles:
            raise InputError(self.path, "style", style, f"must be one of {', '.join(self.styles)}")
        path = self.path / style / f"{name}.npy"
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise InputError(path, "array", error, "must be as prepare wrote it") from error
        if len(array) != self.frames_per_style:
            raise InputError(path, "rows", len(array), f"must be {self.frames_per_style}, as in dataset.json")
        return array


def prepare(
    clips: Sequence[Source],
    out: Path,
    config: PrepareConfig,
    *,
    roles_file: Path | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Dataset:
    """Features of many clips, written to a folder.

    A `.phase` file beside a BVH file wins over the labeller. Clips without steps, or too short, are left out and named
    in `dataset.json`. Symmetric styles get mirrored copies, in which left and right change places and the phase moves
    by π. Every style is cut to the frames of the smallest, chosen at random; of a symmetric style the chosen frames
    come with their mirrored twins. The folder appears whole or not at all.

    Args:
        clips: files as `sources.list_clips` returns them, or labelled clips in memory, or both.
        out: folder to make.
        config: layout, mirroring, statistics, seed.
        roles_file: JSON naming the joints' roles.
        overwrite: replace an existing folder.
        progress: called with (clips done, clips in all, name) after each clip.

    Raises:
        InputError: for no clips, a style of which nothing remains, skeletons that differ, bad files, an existing
            folder, or one that cannot be written.
    """
    out = Path(out)
    if out.exists() and not overwrite:
        raise InputError(out, "folder", "exists", "overwriting must be asked for")
    if not clips:
        raise InputError(out, "clips", "none", "a dataset needs at least one clip")
    work = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        work.mkdir(parents=True)
        write_dataset(clips, work, config, roles_file, progress)
        _swap(work, out)
    except OSError as error:
        raise InputError(out, "folder", error, "must be writable, with space for the dataset") from error
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
        raise InputError(file, "file", error, "a dataset is a folder that prepare has written") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        found = data.get("format") if isinstance(data, dict) else type(data).__name__
        raise InputError(file, "format", found, f"this version reads format {FORMAT}")
    layout = LAYOUTS[data["layout"]](len(data["skeleton"]["names"]))
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
        skeleton=skeleton_from_json(data["skeleton"], file),
        styles=tuple(data["styles"]),
        normaliser=normaliser,
        frames_per_style=data["frames_per_style"],
        clips=tuple(data["clips"]),
        skipped=tuple(data["skipped"]),
    )


def stack(dataset: Dataset, styles: Sequence[str] | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x [S, N, Dx], y [S, N, Dy] and phase [S, N] of several styles, normalised, float32.

    Args:
        dataset: prepared.
        styles: in the order wanted; None for all.

    Raises:
        InputError: for an unknown style.
    """
    rows = [dataset.arrays(style) for style in (dataset.styles if styles is None else styles)]
    statistics = dataset.normaliser.inputs, dataset.normaliser.outputs
    x, y = (np.stack([statistics[k].apply(row[k]) for row in rows]).astype(np.float32) for k in (0, 1))
    return x, y, np.stack([row[2] for row in rows])


def _swap(work: Path, out: Path) -> None:
    """Puts a finished folder in its place; an old one is kept until the new one stands there."""
    old = work.with_name(f"{work.name}.old")
    if out.exists():
        out.rename(old)
    work.rename(out)
    if old.is_dir():
        shutil.rmtree(old)
    else:
        old.unlink(missing_ok=True)
