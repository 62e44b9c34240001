"""Takes for the models of Mason 2022: the same frames in the layouts of all models, split into train and test."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.motion_windows import clip_windows
from pfnn_jax.motion.clip import MotionClip, cut, mirror_clip
from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.encode import Features, clip_features, join_rows, select_rows
from pfnn_jax.motion.features.layout import FrameLayout, layout_for
from pfnn_jax.motion.hands import extend_hands
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.local_phase import clip_local_phases, fit_axes, mirror_local_phases
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.walks import PRETRAINING_STYLES, synthetic_clips

LAYOUT_NAMES = ("mason2022", "mason2022_mann", "mason2022_pfnn")
"""Layouts of LPN, MANN and PFNN; their inputs are the same."""

COMMON = ("trajectory_", "joint_", "foot_contacts")
"""Prefixes of the output blocks that all three layouts have, in the same order and units."""

GAP = 60
"""Frames between the training and test part of a take that is cut in two: one second, as long as the trajectory."""


@dataclass(frozen=True, eq=False)
class Take:
    """One take and, for a symmetric style, its mirror image.

    Attributes:
        style, content, name: labels of the take.
        clip: the motion, at 60 fps.
        symmetric: whether the mirror image has the same style.
        rows: layout name -> rows; the same frames in each layout.
        mirrored: the rows of the mirror image, or None.
    """

    style: str
    content: str
    name: str
    clip: MotionClip
    symmetric: bool
    rows: dict[str, Features]
    mirrored: dict[str, Features] | None

    def parts(self, layout: str) -> list[Features]:
        """Returns the rows in one layout, followed by those of the mirror image."""
        return [self.rows[layout], *([] if self.mirrored is None else [self.mirrored[layout]])]


@dataclass(frozen=True, eq=False)
class Takes:
    """All takes of one data set on one skeleton.

    Attributes:
        skeleton: skeleton of all takes.
        train, test: the split.
        left_out: skipped file -> reason.
    """

    skeleton: Skeleton
    train: tuple[Take, ...]
    test: tuple[Take, ...]
    left_out: dict[str, str]

    @property
    def styles(self) -> tuple[str, ...]:
        """Names of the styles, sorted."""
        return tuple(sorted({take.style for take in self.train}))

    def layout(self, name: str) -> FrameLayout:
        """Returns a layout for the skeleton."""
        return layout_for(name, self.skeleton)


def load_takes(
    data: str,
    share: float = 0.125,
    most: int = 0,
    seconds: float = 60.0,
    held: int | None = None,
    styles: Sequence[str] | None = None,
) -> Takes:
    """Loads takes of a folder of BVH files, or of the procedural styles, and splits them.

    For every style and content, evenly spaced whole takes are test takes. A single take is cut in time instead, and its
    end is the test take.

    Args:
        data: folder, or `synthetic`.
        share: share of the takes, or of the frames of a single take, for testing.
        most: largest number of takes of each style and content, 0 for all.
        seconds: seconds of each procedural style.
        held: number of test takes of each style and content, instead of `share`.
        styles: styles to read; all by default.

    Raises:
        InputError: if no take can be used.
    """
    groups, left_out = _synthetic(seconds) if data == "synthetic" else _files(Path(data), most, styles)
    train, test, skeleton = [], [], None
    for (style, content), clips in groups.items():
        takes = make_takes(style, content, clips, left_out)
        skeleton = skeleton or (takes[0].clip.skeleton if takes else None)
        first, last = split_takes(takes, share, held)
        train += first
        test += last
    if skeleton is None:
        raise InputError(data, "takes", "none", "must have at least one take with steps")
    return Takes(skeleton, tuple(train), tuple(test), left_out)


def make_takes(style: str, content: str, clips: Sequence[LabelledClip], left_out: dict[str, str]) -> list[Take]:
    """Returns takes of one style and content; the principal axes of their hands are fitted jointly.

    Args:
        style, content: labels of the clips.
        clips: clips with extended hands and phase labels.
        left_out: filled with the clips that cannot be used and the reasons.
    """
    axes = fit_axes([one.clip for one in clips])
    layouts = [layout_for(name, clips[0].clip.skeleton) for name in LAYOUT_NAMES]
    takes = []
    for one in clips:
        phases = clip_local_phases(one.clip, axes=axes)
        try:
            rows = common_rows(one.clip, layouts, one.labels, phases)
            mirrored = None
            if one.symmetric:
                image, labels = mirror_clip(one.clip), mirror_phase(one.labels)
                mirrored = common_rows(image, layouts, labels, mirror_local_phases(phases))
        except NoGaitError as error:
            left_out[one.clip.source] = str(error)
            continue
        takes.append(Take(style, content, Path(one.clip.source).stem, one.clip, one.symmetric, rows, mirrored))
    return takes


def common_rows(clip: MotionClip, layouts: Sequence[FrameLayout], labels, phases: np.ndarray) -> dict[str, Features]:
    """Returns rows in every layout for the frames that all layouts can use; the inputs are shared."""
    found = {layout.name: clip_features(clip, layout, labels, local_phases=phases) for layout in layouts}
    frames = found[layouts[0].name].frames
    for part in found.values():
        frames = np.intersect1d(frames, part.frames)
    if not len(frames):
        raise NoGaitError(clip.source, "phase", "no frame is labelled", "must be a clip with steps")
    kept = {name: select_rows(part, np.isin(part.frames, frames)) for name, part in found.items()}
    x = kept[layouts[0].name].x
    return {name: replace(part, x=x) for name, part in kept.items()}


def split_takes(takes: Sequence[Take], share: float, held: int | None = None) -> tuple[list[Take], list[Take]]:
    """Returns training and test takes of one style and content; see `load_takes`."""
    if len(takes) == 1 and not held:
        return _cut_take(takes[0], share)
    count = held if held is not None else max(1, round(share * len(takes))) if takes else 0
    # Evenly spaced, because neighbouring takes are similar.
    chosen = {round((i + 0.5) * len(takes) / count - 0.5) for i in range(count)} if count else set()
    return (
        [take for i, take in enumerate(takes) if i not in chosen],
        [take for i, take in enumerate(takes) if i in chosen],
    )


def common_columns(layout: FrameLayout) -> np.ndarray:
    """Returns indices of the output columns that all layouts have, in their common order."""
    return np.flatnonzero([name.startswith(COMMON) for name in layout.output_names])


def rows_of(takes: Sequence[Take], layout: str, mirrored: bool = True) -> Features:
    """Returns the concatenated rows of takes in a layout."""
    return join_rows([part for take in takes for part in (take.parts(layout) if mirrored else [take.rows[layout]])])


def windows_of(takes: Sequence[Take], styles: Sequence[str], mirrored: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Returns windows [N, T, F] of the takes for the style classifier, and the indices [N] of their styles."""
    parts = [clip_windows(take.clip, mirror=mirrored and take.symmetric) for take in takes]
    labels = [np.full(len(part), styles.index(take.style)) for take, part in zip(takes, parts, strict=True)]
    return np.concatenate(parts), np.concatenate(labels)


def runs_of(part: Features) -> Iterator[tuple[int, int]]:
    """Yields (first row, number of rows) of every sequence of consecutive frames."""
    breaks = np.flatnonzero(np.diff(part.frames) != 1) + 1
    edges = [0, *breaks.tolist(), len(part.frames)]
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        yield start, stop - start


def _files(
    folder: Path, most: int, styles: Sequence[str] | None
) -> tuple[dict[tuple[str, str], list[LabelledClip]], dict[str, str]]:
    groups: dict[tuple[str, str], list[LabelledClip]] = defaultdict(list)
    left_out: dict[str, str] = {}
    for file in list_clips(folder):
        if styles is not None and file.style not in styles:
            continue
        key = (file.style, file.content)
        if file.content.startswith(("idle", "transition")):
            left_out[str(file.path)] = "only walking and running are compared"
        elif not most or len(groups[key]) < most:
            try:
                found = load_labelled(file)
            except NoGaitError as error:
                left_out[str(file.path)] = str(error)
                continue
            groups[key].append(replace(found, clip=extend_hands(found.clip)))
    return {key: clips for key, clips in groups.items() if clips}, left_out


def _synthetic(seconds: float) -> tuple[dict[tuple[str, str], list[LabelledClip]], dict[str, str]]:
    groups = {}
    for style in PRETRAINING_STYLES:
        clips = synthetic_clips(style, seconds)
        groups[style, "walk-mixed"] = [
            replace(found, clip=replace(extend_hands(found.clip), source=f"{style}_{i:03d}"))
            for i, found in enumerate(clips)
        ]
    return groups, {}


def _cut_take(take: Take, share: float) -> tuple[list[Take], list[Take]]:
    """Cuts a take into a training part and a test part, with `GAP` frames between them."""
    last = take.clip.num_frames
    border = last - math.ceil(share * last)
    if border <= 2 * GAP or not (take.rows[LAYOUT_NAMES[0]].frames >= border).any():
        return [take], []
    early, late = _between(take, 0, border - GAP), _between(take, border, last)
    return [early], [replace(late, name=f"{take.name}, end")]


def _between(take: Take, start: int, stop: int) -> Take:
    def kept(rows: dict[str, Features]) -> dict[str, Features]:
        inside = [(part.frames >= start) & (part.frames < stop) for part in rows.values()][0]
        return {name: select_rows(part, inside) for name, part in rows.items()}

    mirrored = None if take.mirrored is None else kept(take.mirrored)
    return replace(take, clip=cut(take.clip, start, stop), rows=kept(take.rows), mirrored=mirrored)
