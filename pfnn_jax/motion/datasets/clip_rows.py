"""Turns clips into rows for any layout: loads, labels and mirrors them, and divides their rows among the splits."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.clip_files import is_gltf_file
from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.datasets.splits import SPLITS, clip_generator, row_windows, split_blocks
from pfnn_jax.motion.datasets.style100 import IDLE, TRANSITION
from pfnn_jax.motion.features.encode import Features, clip_features, select_rows
from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout, layout_for
from pfnn_jax.motion.features.normaliser import Moments, moments_of
from pfnn_jax.motion.hands import extend_hands
from pfnn_jax.motion.joint_order import match_joints
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.local_phase import clip_local_phases, end_effectors, fit_axes, mirror_local_phases
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.retargeting.resting import same_floor
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton, need_roles, same_joints
from pfnn_jax.motion.world_motion import world_motion

MAX_HIERARCHY_LINES = 10_000
"""Lines at the start of a BVH file within which its hierarchy ends."""

Fit = Callable[[MotionClip], MotionClip]
"""Gives a clip the joints that a layout expects."""

Source = ClipFile | LabelledClip
"""A clip on disk, or a labelled clip in memory."""


@dataclass(frozen=True)
class ClipGroup:
    """Clips that are prepared together.

    Under layouts with local phases these are the clips of one style and content, because the main axes of their hands'
    movements are fitted together; under other layouts every clip is a group of its own.

    Attributes:
        sources: the clips.
        layout: name in `LAYOUTS`.
        mirror: whether to add the mirror image of every clip of a symmetric style.
        validation, test: shares of a clip's rows.
        seed: determines where those shares lie.
        roles_file: JSON file that names the joints' roles.
        hands: whether to add the ends of the hands as joints.
        joint_names: of the data set's skeleton; clips with the same joints in another order are brought to this one.
        target: skeleton to put all clips onto (`match_skeleton`); None keeps their own.
    """

    sources: tuple[Source, ...]
    layout: str
    mirror: bool
    validation: float
    test: float
    seed: int
    roles_file: Path | None = None
    hands: bool = False
    joint_names: tuple[str, ...] = ()
    target: Skeleton | None = None


@dataclass(frozen=True, eq=False)
class SplitRows:
    """The rows of a clip, or of its mirror image, in one split.

    Attributes:
        rows: at least one.
        windows: [C, 2] (first row, number of rows) within them.
    """

    rows: Features
    windows: np.ndarray


@dataclass(frozen=True, eq=False)
class ClipRows:
    """All rows of a clip or of its mirror image.

    Attributes:
        entry: its entry in `dataset.json`.
        skeleton: the clip's, with the ends of the hands if the layout has them.
        layout: the layout for that skeleton.
        splits: split -> rows; only splits that have any.
        moments: of x, y and, unless it is a scalar, phase, over the training rows.
    """

    entry: dict[str, Any]
    skeleton: Skeleton
    layout: FrameLayout
    splits: dict[str, SplitRows]
    moments: tuple[Moments, ...]


@dataclass(frozen=True, eq=False)
class PreparedClip:
    """The result for one source: the rows of the clip and of its mirror image, or why there are none.

    Attributes:
        style: name of the clip's style.
        name: of its file.
        images: the clip and, if wanted, its mirror image.
        skipped: why a valid clip cannot be used.
        note: what is odd about the clip.
        bad: what is wrong with its file.
    """

    style: str
    name: str
    images: tuple[ClipRows, ...] = ()
    skipped: str = ""
    note: str = ""
    bad: InputError | None = None


def style_of(source: Source) -> str:
    """Returns the name of a clip's style."""
    return source.style if isinstance(source, ClipFile) else source.clip.style


def content_of(source: Source) -> str:
    """Returns what is performed in a clip."""
    return source.content if isinstance(source, ClipFile) else source.clip.content


def name_of(source: Source) -> str:
    """Returns the name of the file that a clip comes from."""
    return str(source.path) if isinstance(source, ClipFile) else source.clip.source


def has_hand_ends(source: Source) -> bool:
    """Returns whether a clip's hands end away from the wrists; for a file, whether any of its End Sites does."""
    if isinstance(source, LabelledClip):
        return extend_hands(source.clip) is not source.clip
    if is_gltf_file(source.path):
        return False  # it has no End Sites
    try:
        with source.path.open(encoding="latin-1") as file:
            hierarchy = takewhile(lambda line: line.strip().upper() != "MOTION", islice(file, MAX_HIERARCHY_LINES))
            text = "".join(hierarchy)
    except OSError:
        return True  # reading the clip will report the error
    sites = re.findall(r"End\s+Site[^{]*\{\s*OFFSET([^}]*)\}", text, re.IGNORECASE)
    return any(re.search("[1-9]", offset) for offset in sites)


def load_for_skeleton(
    clip_file: ClipFile, layout: FrameLayout, skeleton: Skeleton, roles_file: str | Path | None = None
) -> LabelledClip:
    """Loads a clip as `load_for_layout`, and puts it onto a skeleton as `match_skeleton`.

    A body that lacks joints for roles, such as one without arms, as captured by a headset and trackers at the legs, is
    put onto the skeleton before it is labelled.

    Raises:
        NoGaitError, InputError: as `load_for_layout`; or if the clip's skeleton has no humanoid map.
    """
    summary = ""

    def fit(clip: MotionClip) -> MotionClip:
        nonlocal summary
        if clip.skeleton.roles is None and clip.skeleton.humanoid is not None:
            moved = retarget(clip, skeleton)
            clip, summary = moved.clip, moved.summary
        return _fit_joints(clip, layout)

    labelled = _load_labelled(clip_file, layout, roles_file, fit)
    note = "; ".join(filter(None, (labelled.note, summary)))
    return match_skeleton(replace(labelled, note=note), skeleton)


def load_for_layout(clip_file: ClipFile, layout: FrameLayout, roles_file: str | Path | None = None) -> LabelledClip:
    """Loads a clip at a layout's rate, with its number of joints, and with phase labels if it uses them.

    Args:
        clip_file: the clip and the frames used.
        layout: layout of the rows that are to be made.
        roles_file: JSON file that names the joints' roles.

    Raises:
        NoGaitError: if the layout needs the phase of the gait cycle and the clip has no steps.
        InputError: for bad files, or a skeleton without roles.
    """
    return _load_labelled(clip_file, layout, roles_file, partial(_fit_joints, layout=layout))


def match_hands(labelled: LabelledClip, layout: FrameLayout) -> LabelledClip:
    """Returns the clip with the ends of its hands as joints if the layout has those and the clip does not."""
    return _fitted(labelled, partial(_fit_joints, layout=layout))


def match_skeleton(labelled: LabelledClip, skeleton: Skeleton) -> LabelledClip:
    """Returns the clip on a skeleton: retargeted, and with a note that says so, if it has another.

    A skeleton with the same joints, in any order, the same rest pose and the same floor counts as the same, whatever
    its bones' lengths, because features hold joint positions. Labels stay: they are those of the clip's own feet.

    Args:
        labelled: the clip.
        skeleton: such as a run's.

    Raises:
        InputError: if either skeleton has no humanoid map.
    """
    clip = match_joints(labelled.clip, skeleton.names)
    if same_joints(skeleton, clip.skeleton) and same_floor(clip.skeleton, skeleton):
        return labelled if clip is labelled.clip else replace(labelled, clip=clip, world=world_motion(clip))
    moved = retarget(clip, skeleton)
    note = "; ".join(filter(None, (labelled.note, moved.summary)))
    return replace(labelled, clip=moved.clip, note=note, world=world_motion(moved.clip))


def labelled_features(labelled: LabelledClip, layout: FrameLayout, mirror: bool = False) -> list[Features]:
    """Computes the rows of a labelled clip and, with `mirror`, those of its mirror image, for the same frames.

    Args:
        labelled: the clip; its hands are extended if the layout has more joints.
        layout: layout for its joints.
        mirror: whether to add the mirror image.

    Raises:
        NoGaitError: for a clip that is too short or, if a phase is needed, has no steps.
        InputError: for a clip of another frame rate or number of joints.
    """
    labelled = match_hands(labelled, layout)
    phases = _local_phases([labelled], layout)[0]
    return [features for _, features in _images(labelled, layout, mirror, phases)]


def prepare_group(group: ClipGroup) -> list[PreparedClip]:
    """Computes the rows of every clip of a group, in the group's order.

    Clips that cannot be used and bad files raise nothing: `PreparedClip` says what is wrong with them.
    """
    loaded = [_load(source, group) for source in group.sources]
    usable = [labelled for labelled in loaded if isinstance(labelled, LabelledClip)]
    phases = iter(_local_phases(usable, LAYOUTS[group.layout](1)))
    return [
        _prepare(source, labelled, group, next(phases) if isinstance(labelled, LabelledClip) else None)
        for source, labelled in zip(group.sources, loaded, strict=True)
    ]


def _load(source: Source, group: ClipGroup) -> LabelledClip | str | InputError:
    """Returns the labelled clip, the reason why it is skipped, or what is wrong with its file."""
    layout = LAYOUTS[group.layout](1)
    fit = partial(_fit_group, names=group.joint_names, hands=group.hands)
    if layout.next_frame and content_of(source) == IDLE:
        return "an idle clip; the layout is for locomotion"
    try:
        if isinstance(source, ClipFile):
            source = _load_labelled(source, layout, group.roles_file, fit)
        need_roles(source.clip.skeleton, source.clip.source)
        labelled = _fitted(source, fit)
        return labelled if group.target is None else match_skeleton(labelled, group.target)
    except NoGaitError as error:
        return f"{error.value}; {error.rule}"
    except InputError as error:
        return error


def _load_labelled(clip_file: ClipFile, layout: FrameLayout, roles_file: str | Path | None, fit: Fit) -> LabelledClip:
    return load_labelled(clip_file, layout.fps, roles_file, phase=layout.phase_kind == "global", fit=fit)


def _fit_joints(clip: MotionClip, layout: FrameLayout) -> MotionClip:
    """Returns the clip with hand ends as joints if the layout has them and the clip lacks them."""
    needs_hands = layout.next_frame and clip.skeleton.num_joints != layout.num_joints
    return extend_hands(clip) if needs_hands else clip


def _fit_group(clip: MotionClip, names: tuple[str, ...], hands: bool) -> MotionClip:
    """Returns the clip with the joints in the group's order and, with `hands`, with hand ends as joints."""
    clip = match_joints(clip, names)
    return extend_hands(clip) if hands else clip


def _fitted(labelled: LabelledClip, fit: Fit) -> LabelledClip:
    """Returns the labelled clip with the layout's joints and its world motion, computed unless it is known."""
    clip = fit(labelled.clip)
    if clip is labelled.clip and labelled.world is not None:
        return labelled
    return replace(labelled, clip=clip, world=world_motion(clip))


def _local_phases(clips: Sequence[LabelledClip], layout: FrameLayout) -> list[np.ndarray | None]:
    """Returns [T, 4, 2] for each clip, by axes fitted to all of them; None if the layout has no local phases."""
    if layout.phase_kind != "local" or not clips:
        return [None] * len(clips)
    ends = [end_effectors(labelled.world or labelled.clip) for labelled in clips]
    axes = fit_axes(ends)
    return [clip_local_phases(end, axes=axes) for end in ends]


def _prepare(
    source: Source, labelled: LabelledClip | str | InputError, group: ClipGroup, phases: np.ndarray | None
) -> PreparedClip:
    style, name = style_of(source), name_of(source)
    if isinstance(labelled, str):
        return PreparedClip(style, name, skipped=labelled)
    if isinstance(labelled, InputError):
        return PreparedClip(style, name, bad=labelled)
    layout = layout_for(group.layout, labelled.clip.skeleton)
    try:
        images = _images(labelled, layout, group.mirror and labelled.symmetric, phases)
    except NoGaitError as error:
        return PreparedClip(style, name, skipped=f"{error.value}; {error.rule}")
    except InputError as error:
        return PreparedClip(style, name, bad=error)
    split_of = _split_of_frames(images[0][1].frames, labelled.clip, name, group)
    rows = [_clip_rows(image, features, split_of, name, layout) for image, features in images]
    return PreparedClip(style, name, tuple(rows), note=labelled.note)


def _images(
    labelled: LabelledClip, layout: FrameLayout, mirror: bool, phases: np.ndarray | None
) -> list[tuple[MotionClip, Features]]:
    """Returns the clip and, with `mirror`, its mirror image, each with its rows."""
    world, labels = world_motion(labelled.world or labelled.clip), labelled.labels
    images = [(labelled.clip, clip_features(world, layout, labels, labelled.gait, phases))]
    if mirror:
        mirrored = world.mirror()
        labels = mirror_phase(labels)
        phases = None if phases is None else mirror_local_phases(phases)
        images.append((mirrored.clip, clip_features(mirrored, layout, labels, labelled.gait, phases)))
    return images


def _split_of_frames(frames: np.ndarray, clip: MotionClip, name: str, group: ClipGroup) -> np.ndarray:
    """Returns [T], the split of each frame of a clip that has a row."""
    split_of = np.zeros(clip.num_frames, np.int8)
    if not clip.content.startswith(TRANSITION):
        rng = clip_generator(group.seed, clip.style, Path(name).name)
        split_of[frames] = split_blocks(len(frames), group.validation, group.test, rng)
    return split_of


def _clip_rows(clip: MotionClip, features: Features, split_of: np.ndarray, name: str, layout: FrameLayout) -> ClipRows:
    splits = {}
    for index, split in enumerate(SPLITS):
        chosen = split_of[features.frames] == index
        if chosen.any():
            rows = features if chosen.all() else select_rows(features, chosen)
            splits[split] = SplitRows(rows, row_windows(rows.frames))
    train = splits[SPLITS[0]].rows
    arrays = (train.x, train.y) if train.phase.ndim == 1 else (train.x, train.y, train.phase)
    entry = {
        "file": name,
        "style": clip.style,
        "content": clip.content,
        "mirrored": clip.mirrored,
        "frames": clip.num_frames,
    }
    if clip.reading is not None:
        entry["reading"] = clip.reading.to_json()
    return ClipRows(entry, clip.skeleton, layout, splits, tuple(moments_of(array) for array in arrays))
