"""Writing a prepared dataset: reading, labelling, mirroring and balancing the clips, one style after another."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, mirror_clip
from pfnn_jax.motion.features import Features, clip_features
from pfnn_jax.motion.footsteps import NoGaitError
from pfnn_jax.motion.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.layout import LAYOUTS, FrameLayout
from pfnn_jax.motion.normaliser import fit_normaliser, save_normaliser
from pfnn_jax.motion.phase import mirror_phase
from pfnn_jax.motion.skeleton import Skeleton, need_roles, skeleton_to_json
from pfnn_jax.motion.sources import ClipFile

FORMAT = 1
"""Version of the files on disk."""

ARRAYS = ("x", "y", "phase", "clip", "frame")
"""Arrays of a style's folder."""

Source = ClipFile | LabelledClip
"""A clip on disk, or one in memory with its labels."""

Progress = Callable[[int, int, str], None]
"""Called with (clips done, clips in all, name of the clip)."""


@dataclass(frozen=True)
class PrepareConfig:
    """How clips become a dataset.

    Attributes:
        layout: name in `LAYOUTS`.
        fps: frames per second; the layout's.
        mirror: add the mirrored copy of every clip of a symmetric style.
        grouped_std: average deviations over blocks (`fit_normaliser`).
        seed: of the choice of frames where a style has more than the smallest.
    """

    layout: str = "mason2018"
    fps: float = 60.0
    mirror: bool = True
    grouped_std: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        if self.layout not in LAYOUTS:
            raise InputError("PrepareConfig", "layout", self.layout, f"must be one of {', '.join(LAYOUTS)}")
        wanted = LAYOUTS[self.layout](1).fps
        if self.fps != wanted:
            raise InputError("PrepareConfig", "fps", self.fps, f"layout {self.layout} is made for {wanted:g}")
        if self.seed < 0:
            raise InputError("PrepareConfig", "seed", self.seed, "must not be negative")


def same_topology(skeleton: Skeleton, other: Skeleton, source: str | Path) -> None:
    """Refuses a skeleton of other joints. Bones may differ in length: the features hold joint positions.

    Args:
        skeleton: the one expected.
        other: of the clip from `source`.
        source: file, for the message.

    Raises:
        InputError: naming the first joint that differs.
    """
    if other.num_joints != skeleton.num_joints:
        extra = sorted(set(other.names) ^ set(skeleton.names))
        raise InputError(
            source,
            "skeleton",
            f"{other.num_joints} joints, {extra[:1]} differs",
            f"all clips share one skeleton, of {skeleton.num_joints} joints",
        )
    for joint, (name, wanted) in enumerate(zip(other.names, skeleton.names, strict=True)):
        if name != wanted or other.parents[joint] != skeleton.parents[joint]:
            raise InputError(
                source,
                f"joint {joint}",
                f"{name} under joint {other.parents[joint]}",
                f"all clips share one skeleton, here {wanted} under {skeleton.parents[joint]}",
            )


def write_dataset(
    clips: Sequence[Source],
    folder: Path,
    config: PrepareConfig,
    roles_file: Path | None,
    progress: Progress | None,
) -> None:
    """Writes a dataset into an existing empty folder; `dataset.json` comes last.

    Args:
        clips: at least one.
        folder: to fill.
        config: layout, mirroring, statistics, seed.
        roles_file: JSON naming the joints' roles.
        progress: called after each clip.

    Raises:
        InputError: for a style of which nothing remains, skeletons that differ, or bad files.
        OSError: if the folder cannot be written.
    """
    builder = _Builder(folder, config, roles_file, progress, len(clips))
    by_style: dict[str, list[Source]] = {}
    for source in clips:
        by_style.setdefault(_style(source), []).append(source)
    for style in sorted(by_style):
        builder.add_style(style, by_style[style])
    builder.finish()


class _Builder:
    """Collects one style after another, so that only one is in memory."""

    def __init__(
        self, folder: Path, config: PrepareConfig, roles_file: Path | None, progress: Progress | None, total: int
    ):
        self.folder, self.config, self.roles_file = folder, config, roles_file
        self.progress, self.done, self.total = progress, 0, total
        self.skeleton: Skeleton | None = None
        self.layout: FrameLayout | None = None
        self.clips: list[dict[str, Any]] = []
        self.skipped: list[dict[str, str]] = []
        self.plain: dict[str, int] = {}  # rows of each style that are not mirrored; they come first
        self.rows: dict[str, int] = {}

    def add_style(self, style: str, sources: Sequence[Source]) -> None:
        """Reads the clips of a style and writes all of its rows."""
        plain: list[tuple[Features, int]] = []
        mirrored: list[tuple[Features, int]] = []
        for source in sources:
            try:
                self._add_clip(source, plain, mirrored)
            except NoGaitError as error:
                self.skipped.append({"file": _name(source), "style": style, "reason": f"{error.value}; {error.rule}"})
            self.done += 1
            if self.progress is not None:
                self.progress(self.done, self.total, Path(_name(source)).name)
        if not plain:
            reason = next(s["reason"] for s in reversed(self.skipped) if s["style"] == style)
            raise InputError(_name(sources[0]), f"style {style}", f"{len(sources)} clips, none of use", reason)
        self.plain[style] = sum(len(features.frames) for features, _ in plain)
        self.rows[style] = self.plain[style] + sum(len(features.frames) for features, _ in mirrored)
        _save_rows(self.folder / style, plain + mirrored)

    def _add_clip(self, source: Source, plain: list, mirrored: list) -> None:
        on_disk = isinstance(source, ClipFile)
        take = load_labelled(source, self.config.fps, self.roles_file) if on_disk else source
        layout = self._check(take.clip)
        plain.append((self._features(take, layout), self._register(_name(source), take)))
        if self.config.mirror and take.symmetric:
            twin = replace(take, clip=mirror_clip(take.clip), labels=mirror_phase(take.labels))
            mirrored.append((self._features(twin, layout), self._register(_name(source), twin)))

    def _features(self, take: LabelledClip, layout: FrameLayout) -> Features:
        return clip_features(take.clip, layout, take.labels, take.gait)

    def _register(self, file: str, take: LabelledClip) -> int:
        clip = take.clip
        self.clips.append(
            {
                "file": file,
                "style": clip.style,
                "content": clip.content,
                "mirrored": clip.mirrored,
                "frames": clip.num_frames,
            }
        )
        return len(self.clips) - 1

    def _check(self, clip: MotionClip) -> FrameLayout:
        need_roles(clip.skeleton, clip.source)
        if self.skeleton is None or self.layout is None:
            self.skeleton = clip.skeleton
            self.layout = LAYOUTS[self.config.layout](clip.skeleton.num_joints)
        same_topology(self.skeleton, clip.skeleton, clip.source)
        return self.layout

    def finish(self) -> None:
        """Balances the styles, fits the normaliser and writes `dataset.json` last."""
        assert self.skeleton is not None and self.layout is not None
        frames = min(self.rows.values())
        if any(self.plain[style] < self.rows[style] for style in self.rows):
            frames -= frames % 2
        for index, style in enumerate(self.rows):
            rng = np.random.default_rng([self.config.seed, index])
            _select_rows(self.folder / style, _choose(rng, self.plain[style], self.rows[style], frames))
        opened = [[np.load(self.folder / s / f"{k}.npy", mmap_mode="r") for s in self.rows] for k in "xy"]
        normaliser = fit_normaliser(opened[0], opened[1], self.layout, self.config.grouped_std)
        save_normaliser(self.folder / "normaliser", normaliser)
        data = {
            "format": FORMAT,
            "layout": self.config.layout,
            "config": asdict(self.config),
            "skeleton": skeleton_to_json(self.skeleton),
            "styles": list(self.rows),
            "frames_per_style": frames,
            "frames_found": self.rows,
            "clips": self.clips,
            "skipped": self.skipped,
            "versions": {"pfnn_jax": version("pfnn-jax"), "numpy": version("numpy")},
        }
        (self.folder / "dataset.json").write_text(json.dumps(data, indent=1), encoding="utf-8")


def _style(source: Source) -> str:
    return source.style if isinstance(source, ClipFile) else source.clip.style


def _name(source: Source) -> str:
    return str(source.path) if isinstance(source, ClipFile) else source.clip.source


def _choose(rng: np.random.Generator, plain: int, rows: int, wanted: int) -> np.ndarray:
    """Rows to keep, in order; those of a symmetric style with their mirrored twins, which follow `plain` rows on."""
    if plain == rows:
        return np.sort(rng.choice(rows, wanted, replace=False))
    kept = np.sort(rng.choice(plain, wanted // 2, replace=False))
    return np.concatenate([kept, kept + plain])


def _save_rows(folder: Path, takes: list[tuple[Features, int]]) -> None:
    folder.mkdir()
    rows = {
        "x": [f.x for f, _ in takes],
        "y": [f.y for f, _ in takes],
        "phase": [f.phase for f, _ in takes],
        "clip": [np.full(len(f.frames), index, np.int32) for f, index in takes],
        "frame": [f.frames.astype(np.int32) for f, _ in takes],
    }
    for name, parts in rows.items():
        np.save(folder / f"{name}.npy", np.concatenate(parts), allow_pickle=False)


def _select_rows(folder: Path, kept: np.ndarray) -> None:
    for name in ARRAYS:
        path = folder / f"{name}.npy"
        array = np.load(path, mmap_mode="r")
        if len(array) == len(kept):
            continue
        chosen = array[kept]
        del array
        path.unlink()
        np.save(path, chosen, allow_pickle=False)
