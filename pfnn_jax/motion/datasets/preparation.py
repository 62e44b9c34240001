"""Writing a prepared dataset: takes become rows in several processes, and are written in their order by this one."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.motion.datasets.clip_file import ClipFile
from pfnn_jax.motion.datasets.splits import SPLITS
from pfnn_jax.motion.datasets.style_writer import StyleWriter
from pfnn_jax.motion.datasets.takes import (
    Group,
    Prepared,
    Source,
    TakeRows,
    content_of,
    has_hand_ends,
    name_of,
    prepare_group,
    style_of,
)
from pfnn_jax.motion.datasets.workers import default_workers, map_in_order
from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout
from pfnn_jax.motion.features.normaliser import NO_ROWS, Moments, fit_normaliser, save_normaliser
from pfnn_jax.motion.skeleton import Skeleton, skeleton_to_json

FORMAT = 2
"""Version of the files on disk."""

FEW_BYTES = 32_000_000
"""Files that are read sooner than other processes start."""

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
        validation: share of every clip's rows, in one block, kept from training for choosing (Mason 2022: 0.1).
        test: likewise for testing.
        seed: of the places of those blocks.
    """

    layout: str = "mason2018"
    fps: float = 60.0
    mirror: bool = True
    grouped_std: bool = False
    validation: float = 0.0
    test: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.layout not in LAYOUTS:
            raise InputError("PrepareConfig", "layout", self.layout, f"must be one of {', '.join(LAYOUTS)}")
        wanted = LAYOUTS[self.layout](1).fps
        if self.fps != wanted:
            raise InputError("PrepareConfig", "fps", self.fps, f"layout {self.layout} is made for {wanted:g}")
        for name in ("validation", "test"):
            if not 0 <= getattr(self, name) < 0.5:
                raise InputError("PrepareConfig", name, getattr(self, name), "a share from 0 to below a half")
        if self.seed < 0:
            raise InputError("PrepareConfig", "seed", self.seed, "must not be negative")

    @property
    def splits(self) -> tuple[str, ...]:
        """Parts that the dataset has."""
        shares = (1.0, self.validation, self.test)
        return tuple(name for name, share in zip(SPLITS, shares, strict=True) if share)


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
    workers: int | None = None,
) -> None:
    """Writes a dataset into an existing empty folder; `dataset.json` comes last.

    Args:
        clips: at least one, in any order.
        folder: to fill.
        config: layout, mirroring, statistics, splits.
        roles_file: JSON naming the joints' roles.
        progress: called after each clip.
        workers: processes; None for one per processor where there is much to read. The files are the same.

    Raises:
        InputError: for a style of which nothing remains, skeletons that differ, or bad files.
        OSError: if the folder cannot be written.
    """
    groups = _groups(clips, config, roles_file)
    builder, done = _Builder(folder, config), 0
    with closing(_prepared(groups, _workers(clips, workers))) as prepared:
        for style, items in groupby(prepared, key=lambda item: item.style):
            with closing(builder):
                for item in items:
                    builder.add(item)
                    done += 1
                    if progress is not None:
                        progress(done, len(clips), Path(item.name).name)
            builder.end_style(style)
    builder.finish()


def _groups(clips: Sequence[Source], config: PrepareConfig, roles_file: Path | None) -> list[Group]:
    """Takes by style, content and name, so that their order does not matter; together where they share axes.

    Hand ends become joints where all takes have them: in a few Bandai-Namco files alone they do not lie at the wrist.
    """

    def place(source: Source) -> tuple[str, ...]:
        return style_of(source), content_of(source), Path(name_of(source)).name, name_of(source)

    def key(source: Source) -> tuple[str, ...]:
        return place(source)[:2] if LAYOUTS[config.layout](1).phase_kind == "local" else place(source)

    hands = all(map(has_hand_ends, clips)) if LAYOUTS[config.layout](1).next_frame else False
    shares = config.validation, config.test
    return [
        Group(tuple(sources), config.layout, config.mirror, *shares, config.seed, roles_file, hands)
        for _, sources in groupby(sorted(clips, key=place), key=key)
    ]


def _workers(clips: Sequence[Source], asked: int | None) -> int:
    if asked is not None:
        return asked
    files = (Path(clip.path) for clip in clips if isinstance(clip, ClipFile))
    return default_workers() if sum(file.stat().st_size for file in files if file.is_file()) > FEW_BYTES else 1


def _prepared(groups: list[Group], workers: int) -> Generator[Prepared, None, None]:
    with closing(map_in_order(prepare_group, groups, min(workers, len(groups)))) as results:
        for result in results:
            yield from result


class _Builder:
    """Collects what is known of the whole dataset while its styles are written."""

    def __init__(self, folder: Path, config: PrepareConfig):
        self.folder, self.config = folder, config
        self.skeleton: Skeleton | None = None
        self.layout: FrameLayout | None = None
        self.clips: list[dict[str, Any]] = []
        self.skipped: list[dict[str, str]] = []
        self.notes: list[dict[str, str]] = []
        self.moments: tuple[Moments, ...] = ()
        self.rows: dict[str, dict[str, int]] = {split: {} for split in config.splits}
        self.short: dict[str, dict[str, int]] = {split: {} for split in config.splits}
        self.writer: StyleWriter | None = None

    def add(self, item: Prepared) -> None:
        """Writes the rows of a take of the style at hand."""
        if item.note:
            self.notes.append({"file": item.name, "style": item.style, "note": item.note})
        if item.skipped:
            self.skipped.append({"file": item.name, "style": item.style, "reason": item.skipped})
        for take in item.takes:
            layout = self._check(take, item.name)
            if self.writer is None:
                self.writer = StyleWriter(self.folder, item.style, self.config.splits, layout)
            self.writer.add(take, len(self.clips))
            self.clips.append(take.entry)
            so_far = self.moments or (NO_ROWS,) * len(take.moments)
            self.moments = tuple(all_rows.merge(rows) for all_rows, rows in zip(so_far, take.moments, strict=True))

    def close(self) -> None:
        """Completes the files of the style at hand."""
        if self.writer is not None:
            self.writer.close()

    def end_style(self, style: str) -> None:
        """Counts the rows of a style.

        Raises:
            InputError: if it has none.
        """
        if self.writer is None:
            left_out = [item for item in self.skipped if item["style"] == style]
            value = f"{len(left_out)} clips, none of use"
            raise InputError(left_out[0]["file"], f"style {style}", value, left_out[-1]["reason"])
        for split in self.config.splits:
            self.rows[split][style] = self.writer.rows[split]
            self.short[split][style] = self.writer.short[split]
        self.writer = None

    def _check(self, take: TakeRows, name: str) -> FrameLayout:
        """The dataset's layout, where the take is of its skeleton."""
        if self.skeleton is None or self.layout is None:
            self.skeleton, self.layout = take.skeleton, take.layout
        same_topology(self.skeleton, take.skeleton, name)
        if take.layout != self.layout:
            rule = f"all clips share one skeleton, with these at {self.layout.ends}"
            raise InputError(name, "hands and toes", f"joints {take.layout.ends}", rule)
        return self.layout

    def finish(self) -> None:
        """Fits the normaliser to the rows to train on and writes `dataset.json` last."""
        assert self.skeleton is not None and self.layout is not None
        x, y, *phase = (moments.rows() for moments in self.moments)
        grouped = self.config.grouped_std
        normaliser = fit_normaliser(x, y, self.layout, grouped, phase[0] if phase else None)
        save_normaliser(self.folder / "normaliser", normaliser)
        data = {
            "format": FORMAT,
            "layout": self.config.layout,
            "config": asdict(self.config),
            "skeleton": skeleton_to_json(self.skeleton),
            "styles": list(self.rows["train"]),
            "rows": self.rows,
            "takes_without_window": self.short,
            "clips": self.clips,
            "skipped": self.skipped,
            "notes": self.notes,
            "versions": {"pfnn_jax": version("pfnn-jax"), "numpy": version("numpy")},
        }
        (self.folder / "dataset.json").write_text(json.dumps(data, indent=1), encoding="utf-8")
