"""From a take to its rows: loaded, labelled, mirrored and divided, whatever the layout wants."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.clip_file import ClipFile
from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.datasets.splits import SPLITS, row_windows, split_blocks, take_generator
from pfnn_jax.motion.datasets.style100 import IDLE, TRANSITION
from pfnn_jax.motion.features.encode import Features, clip_features, select_rows
from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout, layout_for
from pfnn_jax.motion.features.normaliser import Moments, moments_of
from pfnn_jax.motion.hands import extend_hands
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.local_phase import clip_local_phases, end_effectors, fit_axes, mirror_local_phases
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.skeleton import Skeleton, need_roles
from pfnn_jax.motion.world_motion import world_motion

HEAD = 10_000
"""Lines of a BVH file that its hierarchy does not exceed."""

Fit = Callable[[MotionClip], MotionClip]
"""Gives a clip the joints of a layout."""

Source = ClipFile | LabelledClip
"""A clip on disk, or one in memory with its labels."""


@dataclass(frozen=True)
class Group:
    """Takes that are learned from together: of one style and content, whose hands share their axes.

    Attributes:
        sources: the takes.
        layout: name in `LAYOUTS`.
        mirror: add the mirrored copy of every take of a symmetric style.
        validation, test: shares of a take's rows.
        seed: of the places of those shares.
        roles_file: JSON naming the joints' roles.
        hands: make joints of hand ends where the layout has them.
    """

    sources: tuple[Source, ...]
    layout: str
    mirror: bool
    validation: float
    test: float
    seed: int
    roles_file: Path | None = None
    hands: bool = True


@dataclass(frozen=True, eq=False)
class Part:
    """Rows of a take, or of its mirror image, that belong to one split.

    Attributes:
        rows: at least one.
        windows: [C, 2] (first row, number of rows) within them.
    """

    rows: Features
    windows: np.ndarray


@dataclass(frozen=True, eq=False)
class TakeRows:
    """All rows of a take or of its mirror image.

    Attributes:
        entry: what `dataset.json` says of it.
        skeleton: its own, with hand ends where the layout has them.
        layout: its own.
        parts: split -> rows; only splits that have any.
        moments: of x, y and, where it is no scalar, phase, over the rows to train on.
    """

    entry: dict[str, Any]
    skeleton: Skeleton
    layout: FrameLayout
    parts: dict[str, Part]
    moments: tuple[Moments, ...]


@dataclass(frozen=True, eq=False)
class Prepared:
    """What became of one source: its rows and those of its mirror image, or why it is left out."""

    style: str
    name: str
    takes: tuple[TakeRows, ...] = ()
    skipped: str = ""
    note: str = ""


def style_of(source: Source) -> str:
    """Its style's name."""
    return source.style if isinstance(source, ClipFile) else source.clip.style


def content_of(source: Source) -> str:
    """What is done in it."""
    return source.content if isinstance(source, ClipFile) else source.clip.content


def name_of(source: Source) -> str:
    """The file it is from."""
    return str(source.path) if isinstance(source, ClipFile) else source.clip.source


def has_hand_ends(source: Source) -> bool:
    """Whether a take's hands end away from their wrists; of a file, whether any of its End Sites does."""
    if isinstance(source, LabelledClip):
        return extend_hands(source.clip) is not source.clip
    try:
        with Path(source.path).open(encoding="latin-1") as file:
            head = "".join(takewhile(lambda line: line.strip().upper() != "MOTION", islice(file, HEAD)))
    except OSError:
        return True  # its reader will say what is wrong
    sites = re.findall(r"End\s+Site[^{]*\{\s*OFFSET([^}]*)\}", head, re.IGNORECASE)
    return any(re.search("[1-9]", offset) for offset in sites)


def load_take(clip_file: ClipFile, layout: FrameLayout, roles_file: Path | None = None) -> LabelledClip:
    """A clip as a layout wants it: at its rate, with its number of joints, and phase labels where it uses them.

    Args:
        clip_file: the clip and the frames used.
        layout: of the rows it is for.
        roles_file: JSON naming the joints' roles.

    Raises:
        NoGaitError: if the layout needs a phase of the gait cycle and there are no steps.
        InputError: for bad files, or a skeleton without roles.
    """
    return _load_labelled(clip_file, layout, roles_file, partial(_fit_joints, layout=layout))


def fit_hands(take: LabelledClip, layout: FrameLayout) -> LabelledClip:
    """The take with the ends of its hands as joints, where the layout has those and the take has not."""
    return _fitted(take, partial(_fit_joints, layout=layout))


def take_features(take: LabelledClip, layout: FrameLayout, mirror: bool = False) -> list[Features]:
    """A take's rows and, with `mirror`, those of its mirror image: of the same frames.

    Args:
        take: as `load_take` gives it, or made otherwise; its hands are extended where the layout has more joints.
        layout: of its joints.
        mirror: whether to add the mirror image.

    Raises:
        NoGaitError: for a clip too short or, where a phase is needed, without steps.
        InputError: for a clip of another frame rate or number of joints.
    """
    take = fit_hands(take, layout)
    phases = _local_phases([take], layout)[0]
    return [features for _, features in _images(take, layout, mirror, phases)]


def prepare_group(group: Group) -> list[Prepared]:
    """The rows of every take of a group, in the group's order.

    Raises:
        InputError: for bad files. Takes without use are no errors: the reason stands in `Prepared.skipped`.
    """
    loaded = [_load(source, group) for source in group.sources]
    takes = [take for take in loaded if isinstance(take, LabelledClip)]
    phases = iter(_local_phases(takes, LAYOUTS[group.layout](1)))
    return [
        _prepare(source, take, group, next(phases) if isinstance(take, LabelledClip) else None)
        for source, take in zip(group.sources, loaded, strict=True)
    ]


def _load(source: Source, group: Group) -> LabelledClip | str:
    """The take, or why it is left out."""
    wanted = LAYOUTS[group.layout](1)
    fit = extend_hands if group.hands and wanted.next_frame else _unchanged
    if wanted.next_frame and content_of(source) == IDLE:
        return "an idle take; the layout is of locomotion"
    try:
        if isinstance(source, ClipFile):
            source = _load_labelled(source, wanted, group.roles_file, fit)
        need_roles(source.clip.skeleton, source.clip.source)
        return _fitted(source, fit)
    except NoGaitError as error:
        return f"{error.value}; {error.rule}"


def _load_labelled(clip_file: ClipFile, layout: FrameLayout, roles_file: Path | None, fit: Fit) -> LabelledClip:
    return load_labelled(clip_file, layout.fps, roles_file, phase=layout.phase_kind == "global", fit=fit)


def _fit_joints(clip: MotionClip, layout: FrameLayout) -> MotionClip:
    """Returns the clip with hand ends as joints where the layout has these and the clip lacks them."""
    needs_hands = layout.next_frame and clip.skeleton.num_joints != layout.num_joints
    return extend_hands(clip) if needs_hands else clip


def _unchanged(clip: MotionClip) -> MotionClip:
    return clip


def _fitted(take: LabelledClip, fit: Fit) -> LabelledClip:
    """Returns the take with its clip fitted and its joints in the world, computed unless they are known."""
    clip = fit(take.clip)
    if clip is take.clip and take.world is not None:
        return take
    return replace(take, clip=clip, world=world_motion(clip))


def _local_phases(takes: Sequence[LabelledClip], layout: FrameLayout) -> list[np.ndarray | None]:
    """[T, 4, 2] of each take, by axes of all of them; None where the layout has no local phases."""
    if layout.phase_kind != "local" or not takes:
        return [None] * len(takes)
    ends = [end_effectors(take.world or take.clip) for take in takes]
    axes = fit_axes(ends)
    return [clip_local_phases(end, axes=axes) for end in ends]


def _prepare(source: Source, take: LabelledClip | str, group: Group, phases: np.ndarray | None) -> Prepared:
    style, name = style_of(source), name_of(source)
    if isinstance(take, str):
        return Prepared(style, name, skipped=take)
    layout = layout_for(group.layout, take.clip.skeleton)
    try:
        images = _images(take, layout, group.mirror and take.symmetric, phases)
    except NoGaitError as error:
        return Prepared(style, name, skipped=f"{error.value}; {error.rule}")
    part_of = _part_of_frames(images[0][1].frames, take.clip, name, group)
    rows = [_take_rows(image, features, part_of, name, layout) for image, features in images]
    return Prepared(style, name, tuple(rows), note=take.note)


def _images(
    take: LabelledClip, layout: FrameLayout, mirror: bool, phases: np.ndarray | None
) -> list[tuple[MotionClip, Features]]:
    """The take and, with `mirror`, its mirror image, each with its rows."""
    world, labels = world_motion(take.world or take.clip), take.labels
    images = [(take.clip, clip_features(world, layout, labels, take.gait, phases))]
    if mirror:
        twin = world.mirror()
        labels = mirror_phase(labels)
        phases = None if phases is None else mirror_local_phases(phases)
        images.append((twin.clip, clip_features(twin, layout, labels, take.gait, phases)))
    return images


def _part_of_frames(frames: np.ndarray, clip: MotionClip, name: str, group: Group) -> np.ndarray:
    """[T] split of each frame of a clip that has a row."""
    part_of = np.zeros(clip.num_frames, np.int8)
    if not clip.content.startswith(TRANSITION):
        rng = take_generator(group.seed, clip.style, Path(name).name)
        part_of[frames] = split_blocks(len(frames), group.validation, group.test, rng)
    return part_of


def _take_rows(clip: MotionClip, features: Features, part_of: np.ndarray, name: str, layout: FrameLayout) -> TakeRows:
    parts = {}
    for index, split in enumerate(SPLITS):
        chosen = part_of[features.frames] == index
        if chosen.any():
            rows = features if chosen.all() else select_rows(features, chosen)
            parts[split] = Part(rows, row_windows(rows.frames))
    trained = parts[SPLITS[0]].rows
    arrays = (trained.x, trained.y) if trained.phase.ndim == 1 else (trained.x, trained.y, trained.phase)
    entry = {
        "file": name,
        "style": clip.style,
        "content": clip.content,
        "mirrored": clip.mirrored,
        "frames": clip.num_frames,
    }
    return TakeRows(entry, clip.skeleton, layout, parts, tuple(moments_of(array) for array in arrays))
