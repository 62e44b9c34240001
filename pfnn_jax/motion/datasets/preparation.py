"""Prepares datasets: turns clips into rows, in several processes, and writes them to a folder in a fixed order."""

from __future__ import annotations

import json
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from itertools import groupby
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pfnn_jax.errors import BadFilesError, InputError, check_field, check_not_negative, check_one_of
from pfnn_jax.io.files import failure, refuse_existing, replacing
from pfnn_jax.io.npy import NpyWriter
from pfnn_jax.motion.clip_files import read_joints
from pfnn_jax.motion.datasets.clip_rows import (
    ClipGroup,
    ClipRows,
    PreparedClip,
    Source,
    content_of,
    has_hand_ends,
    name_of,
    prepare_group,
    style_of,
)
from pfnn_jax.motion.datasets.dataset import FORMAT, Dataset, load_dataset, split_folder
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.shared_unit import share_units
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.datasets.splits import SPLITS, WINDOW_ROWS
from pfnn_jax.motion.datasets.target_skeleton import ADVICE, check_one_skeleton, ends_in_hand_sites, find_target
from pfnn_jax.motion.datasets.workers import default_workers, map_in_order
from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout, layout_for
from pfnn_jax.motion.features.normaliser import NO_ROWS, Moments, fit_normaliser, save_normaliser
from pfnn_jax.motion.skeleton import Skeleton, check_same_topology, skeleton_to_json

SMALL_BYTES = 32_000_000
"""Total size of clips below which one process is done before others have started."""

Progress = Callable[[int, int, str], None]
"""Called with (clips done, number of clips, name of the clip)."""


@dataclass(frozen=True)
class PrepareConfig:
    """How clips become a dataset.

    Attributes:
        layout: frame layout: pfnn2017, mason2018, mason2022, mason2022_pfnn or mason2022_mann.
        fps: frames per second; must be the layout's.
        mirror: add the mirror image of every clip of a symmetric style.
        grouped_std: whether to average standard deviations over blocks of columns, as the authors' code does
            (`fit_normaliser`); otherwise every column has its own, as the paper says.
        validation: share of every clip's rows, in one block, that is kept for validation (Mason 2022: 0.1).
        test: share of every clip's rows, in one block, that is kept for testing.
        seed: determines where those blocks lie.
    """

    layout: str = "mason2018"
    fps: float = 60.0
    mirror: bool = True
    grouped_std: bool = True
    validation: float = 0.0
    test: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        check_one_of(self, "layout", tuple(LAYOUTS))
        fps = LAYOUTS[self.layout](1).fps
        check_field(self, "fps", f"be {fps:g}, as in layout {self.layout}", lambda value: value == fps)
        for name in ("validation", "test"):
            check_field(self, name, "be in [0, 0.5)", lambda share: 0 <= share < 0.5)
        check_not_negative(self, "seed")

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits that the dataset has."""
        shares = (1.0, self.validation, self.test)
        return tuple(name for name, share in zip(SPLITS, shares, strict=True) if share)


def prepare(
    clips: str | Path | Iterable[Source],
    out: str | Path,
    config: PrepareConfig | None = None,
    *,
    skeleton: Skeleton | ClipFile | str | Path | None = None,
    roles_file: str | Path | None = None,
    overwrite: bool = False,
    skip_bad: bool = False,
    progress_callback: Progress | None = None,
    workers: int | None = None,
) -> Dataset:
    """Computes the features of many clips and writes them to a folder.

    If the layout uses the phase of the gait cycle, a `.phase` file next to a clip takes precedence over the
    labeller. Clips without steps are then skipped and named in `dataset.json`, as are clips too short for any layout,
    and idle clips under the `mason2022` layouts. Symmetric styles get mirrored copies, with left and right exchanged.
    Every style keeps all of its rows. Validation and test rows are one contiguous block each of every clip, and the
    same frames of its mirror image; all rows of transitions between gaits are training rows. The folder appears
    complete or not at all, and does not depend on the order of the clips or the number of processes.

    With a skeleton, clips of any humanoid skeleton are put onto it (`match_skeleton`), and a note in `dataset.json`
    says so for each; phases are those of their own feet. Clips with the same joints keep the lengths of their bones.

    Args:
        clips: a folder that `list_clips` reads, or files as it returns them, or labelled clips in memory, or both.
        out: folder to create.
        config: layout, mirroring, statistics, splits; the default `PrepareConfig` if None.
        skeleton: the skeleton to put all clips onto, or a BVH or glTF file that has it; None for clips that share one.
        roles_file: JSON file that names the joints' roles.
        overwrite: whether to replace an existing folder.
        skip_bad: whether to leave out bad files and name them in `dataset.json`; otherwise all of them are refused
            together.
        progress_callback: called with (clips done, number of clips, name) after each clip.
        workers: number of processes; None for one per processor (at most 8) if there is much to read.

    Raises:
        InputError: for no clips or something else than clips, no workers, a style without usable clips, skeletons that
            differ without `skeleton`, a `skeleton` that is not a humanoid, bad files (`BadFilesError` for several), an
            existing folder, or one that cannot be written.
    """
    out, config = Path(out), config or PrepareConfig()
    refuse_existing(out, overwrite)
    sources = _share_units(_as_sources(clips, out))
    if workers is not None and workers < 1:
        raise InputError(out, "workers", workers, "must be at least 1")
    roles_file = None if roles_file is None else Path(roles_file)
    target = _target(skeleton, sources, config, roles_file, out)
    try:
        with replacing(out) as work:
            work.mkdir()
            writer = _DatasetWriter(work, config, skip_bad, target)
            _write_dataset(sources, writer, roles_file, progress_callback, workers)
            writer.finish(out)
    except OSError as error:
        raise InputError(out, "folder", failure(error), "must be writable, with space for the dataset") from error
    return load_dataset(out)


def _as_sources(clips: str | Path | Iterable[Source], out: Path) -> list[Source]:
    """Returns the clips as a list of at least one."""
    if isinstance(clips, str | Path):
        return list(list_clips(clips))
    rule = "must be a folder, or a list of ClipFile or LabelledClip"
    if not isinstance(clips, Iterable):
        raise InputError(out, "clips", type(clips).__name__, rule)
    sources = list(clips)
    for index, source in enumerate(sources):
        if not isinstance(source, ClipFile | LabelledClip):
            raise InputError(out, f"clips[{index}]", type(source).__name__, rule)
    if not sources:
        raise InputError(out, "clips", "none", "must be at least one")
    return sources


def _share_units(sources: list[Source]) -> list[Source]:
    files = [source for source in sources if isinstance(source, ClipFile)]
    shared = iter(share_units(files))
    return [next(shared) if isinstance(source, ClipFile) else source for source in sources]


def _target(
    skeleton: Skeleton | ClipFile | str | Path | None,
    sources: Sequence[Source],
    config: PrepareConfig,
    roles_file: Path | None,
    out: Path,
) -> Skeleton | None:
    """Returns the skeleton that all clips are put onto; None if they have one already."""
    files = [source for source in sources if isinstance(source, ClipFile)]
    if skeleton is None:
        check_one_skeleton(files)
        return None
    if not isinstance(skeleton, Skeleton | ClipFile | str | Path):
        raise InputError(out, "skeleton", type(skeleton).__name__, "must be a Skeleton or a BVH or glTF file")
    return find_target(skeleton, files, LAYOUTS[config.layout](1), roles_file)


def _joint_names(sources: Sequence[Source]) -> tuple[str, ...]:
    """Returns the names of the joints of the first source that can be read, whose order the others take."""
    for source in sources:
        if isinstance(source, LabelledClip):
            return source.clip.skeleton.names
        with suppress(InputError):
            return read_joints(source.path).names
    return ()


def _write_dataset(
    sources: Sequence[Source],
    writer: _DatasetWriter,
    roles_file: Path | None,
    progress_callback: Progress | None,
    workers: int | None,
) -> None:
    """Writes the rows of all styles."""
    groups = _groups(sources, writer.config, roles_file, writer.target)
    done = 0
    with closing(_prepared(groups, _num_workers(sources, workers))) as prepared:
        for style, clips in groupby(prepared, key=lambda clip: clip.style):
            with closing(writer):
                for clip in clips:
                    writer.add(clip)
                    done += 1
                    if progress_callback is not None:
                        progress_callback(done, len(sources), Path(clip.name).name)
            writer.end_style(style)


def _groups(
    sources: Sequence[Source], config: PrepareConfig, roles_file: Path | None, target: Skeleton | None
) -> list[ClipGroup]:
    """Sorts clips by style, content and name, so that their order does not matter, and groups those that share axes.

    Hand ends become joints only if all clips have them (in a few Bandai-Namco files they lie at the wrists) or, where
    clips are put onto a skeleton, if that has them.
    """

    def place(source: Source) -> tuple[str, ...]:
        return style_of(source), content_of(source), Path(name_of(source)).name, name_of(source)

    layout = LAYOUTS[config.layout](1)

    def key(source: Source) -> tuple[str, ...]:
        return place(source)[:2] if layout.phase_kind == "local" else place(source)

    if target is None:
        hands = layout.next_frame and all(map(has_hand_ends, sources))
    else:
        hands = ends_in_hand_sites(target)
    shares = config.validation, config.test
    ordered = sorted(sources, key=place)
    names = _joint_names(ordered) if target is None else target.names
    return [
        ClipGroup(tuple(members), config.layout, config.mirror, *shares, config.seed, roles_file, hands, names, target)
        for _, members in groupby(ordered, key=key)
    ]


def _num_workers(sources: Sequence[Source], workers: int | None) -> int:
    if workers is not None:
        return workers
    files = (source.path for source in sources if isinstance(source, ClipFile))
    return default_workers() if sum(file.stat().st_size for file in files if file.is_file()) > SMALL_BYTES else 1


def _prepared(groups: list[ClipGroup], workers: int) -> Generator[PreparedClip, None, None]:
    with closing(map_in_order(prepare_group, groups, min(workers, len(groups)))) as results:
        for result in results:
            yield from result


class _DatasetWriter:
    """Writes styles one after another and collects what `dataset.json` and the normaliser need."""

    def __init__(self, folder: Path, config: PrepareConfig, skip_bad: bool, target: Skeleton | None = None):
        self.folder, self.config, self.skip_bad, self.target = folder, config, skip_bad, target
        self.bad: list[InputError] = []
        self.skeleton = target
        self.layout = None if target is None else layout_for(config.layout, target)
        self.clips: list[dict[str, Any]] = []
        self.resting_heights: list[np.ndarray] = []  # of the feet in each clip that shows them
        self.skipped: list[dict[str, str]] = []
        self.notes: list[dict[str, str]] = []
        self.moments: tuple[Moments, ...] = ()
        self.rows: dict[str, dict[str, int]] = {split: {} for split in config.splits}
        self.short: dict[str, dict[str, int]] = {split: {} for split in config.splits}
        self.style_writer: _StyleWriter | None = None

    def add(self, clip: PreparedClip) -> None:
        """Writes the rows of a clip of the current style."""
        if clip.note:
            self.notes.append({"file": clip.name, "style": clip.style, "note": clip.note})
        if clip.skipped:
            self.skipped.append({"file": clip.name, "style": clip.style, "reason": clip.skipped})
        try:
            if clip.bad is not None:
                raise clip.bad
            self._write(clip)
        except InputError as error:
            self.bad.append(error)
            reason = f"{error.place}: {error.value}; {error.rule}"
            self.skipped.append({"file": clip.name, "style": clip.style, "reason": reason})

    def _write(self, clip: PreparedClip) -> None:
        for image in clip.images:
            layout = self._check_skeleton(image, clip.name)
            if self.style_writer is None:
                self.style_writer = _StyleWriter(self.folder, clip.style, self.config.splits, layout)
            self.style_writer.add(image, len(self.clips))
            self.clips.append(image.entry)
            if (heights := image.skeleton.resting_heights) is not None:
                self.resting_heights.append(heights[::-1] if image.entry["mirrored"] else heights)
            so_far = self.moments or (NO_ROWS,) * len(image.moments)
            self.moments = tuple(merged.merge(added) for merged, added in zip(so_far, image.moments, strict=True))

    def close(self) -> None:
        """Completes the files of the current style."""
        if self.style_writer is not None:
            self.style_writer.close()

    def end_style(self, style: str) -> None:
        """Counts the rows of a style.

        Raises:
            InputError: if it has none, unless bad files are going to be refused.
        """
        if self.style_writer is None and self.bad and not self.skip_bad:
            return
        if self.style_writer is None:
            skipped = [entry for entry in self.skipped if entry["style"] == style]
            value = f"no usable clips ({len(skipped)} skipped)"
            raise InputError(skipped[0]["file"], f"style {style}", value, skipped[-1]["reason"])
        for split in self.config.splits:
            self.rows[split][style] = self.style_writer.rows[split]
            self.short[split][style] = self.style_writer.short[split]
        self.style_writer = None

    def _check_skeleton(self, image: ClipRows, name: str) -> FrameLayout:
        """Returns the dataset's layout, after checking that the clip shares its skeleton."""
        if self.skeleton is None or self.layout is None:
            self.skeleton, self.layout = image.skeleton, image.layout
        try:
            check_same_topology(self.skeleton, image.skeleton, name)
        except InputError as error:
            raise InputError(name, error.place, error.value, f"{error.rule}; {ADVICE}") from None
        if image.layout != self.layout:
            rule = f"all clips must share one skeleton, with these at {self.layout.ends}"
            raise InputError(name, "hands and toes", f"joints {image.layout.ends}", rule)
        return self.layout

    def finish(self, out: Path) -> None:
        """Fits the normaliser to the training rows and writes `dataset.json` last.

        Args:
            out: folder of the dataset, for messages.

        Raises:
            InputError: if there were bad files that may not be skipped.
        """
        if self.bad and not self.skip_bad:
            _refuse(self.bad, out)
        assert self.skeleton is not None and self.layout is not None
        x, y, *phase = (moments.rows() for moments in self.moments)
        grouped = self.config.grouped_std
        normaliser = fit_normaliser(x, y, self.layout, grouped, phase[0] if phase else None)
        save_normaliser(self.folder / "normaliser", normaliser)
        data = {
            "format": FORMAT,
            "layout": self.config.layout,
            "config": asdict(self.config),
            "skeleton": skeleton_to_json(self._with_resting_heights()),
            "styles": list(self.rows["train"]),
            "rows": self.rows,
            "takes_without_window": self.short,
            "clips": self.clips,
            "skipped": self.skipped,
            "notes": self.notes,
            "versions": {"pfnn_jax": version("pfnn-jax"), "numpy": version("numpy")},
        }
        (self.folder / "dataset.json").write_text(json.dumps(data, indent=1), encoding="utf-8")

    def _with_resting_heights(self) -> Skeleton:
        """Returns the skeleton with the medians of its clips' resting heights; a target keeps its own."""
        assert self.skeleton is not None
        if self.target is not None or not self.resting_heights:
            return self.skeleton
        return replace(self.skeleton, resting_heights=np.median(self.resting_heights, axis=0))


def _refuse(errors: Sequence[InputError], out: Path) -> NoReturn:
    """Refuses bad files: the only one, or all of them together."""
    distinct = tuple({str(error): error for error in errors}.values())
    if len(distinct) == 1:
        raise distinct[0]
    raise BadFilesError(out, distinct, "correct or remove them, or pass `skip_bad=True` to leave them out")


class _StyleWriter:
    """Appends the rows of one style to its arrays, one set of arrays for each split.

    Attributes:
        rows: split -> number of rows written.
        short: split -> number of clips, mirrored ones included, without a whole window of rows.
    """

    def __init__(self, folder: Path, style: str, splits: tuple[str, ...], layout: FrameLayout):
        self.rows, self.short = dict.fromkeys(splits, 0), dict.fromkeys(splits, 0)
        self._files: dict[str, dict[str, NpyWriter]] = {}
        with ExitStack() as opened:
            for split in splits:
                place = split_folder(folder, style, split)
                place.mkdir()
                self._files[split] = {}
                for name, (dtype, width) in _array_types(layout).items():
                    self._files[split][name] = NpyWriter(place / f"{name}.npy", dtype, width)
                    opened.callback(self._files[split][name].close)
            self._opened = opened.pop_all()

    def add(self, image: ClipRows, index: int) -> None:
        """Appends the rows of a clip that has this index among the dataset's clips."""
        for split, part in image.splits.items():
            rows = part.rows
            arrays = {
                "x": rows.x,
                "y": rows.y,
                "phase": rows.phase,
                "clip": np.full(len(rows.frames), index),
                "frame": rows.frames,
                "windows": part.windows + np.array([self.rows[split], 0]),
            }
            for name, array in arrays.items():
                self._files[split][name].append(array)
            self.rows[split] += len(rows.frames)
            self.short[split] += int(part.windows[0, 1] < WINDOW_ROWS)

    def close(self) -> None:
        """Completes all files."""
        self._opened.close()


def _array_types(layout: FrameLayout) -> dict[str, tuple[np.dtype, tuple[int, ...]]]:
    """Returns the type and row shape of each array of a style."""
    phase = (layout.phase_size,) if layout.phase_size else ()
    floats = {"x": (layout.input_size,), "y": (layout.output_size,), "phase": phase}
    counts = {"clip": (), "frame": (), "windows": (2,)}
    float32, int32 = np.dtype(np.float32), np.dtype(np.int32)
    return {name: (float32, shape) for name, shape in floats.items()} | {
        name: (int32, shape) for name, shape in counts.items()
    }
