"""Reads a listed clip with its labels: those of a `.phase` and a `.gait` file next to it, or found in the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.assumptions import repair
from pfnn_jax.motion.clip import MotionClip, cut, resample
from pfnn_jax.motion.clip_files import read_whole_clip
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.labels.contacts import flat_crouch, read_gait, resample_gait
from pfnn_jax.motion.labels.phase import PhaseLabels, cut_phase, label_phase, read_phase, resample_phase
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.world_motion import WorldMotion, world_motion


@dataclass(frozen=True, eq=False)
class CutClip:
    """The frames used of a clip on disk, at the file's own rate.

    Attributes:
        clip: the frames used.
        start: index in the file of the clip's first frame.
        frames_in_file: number of frames in the file.
        note: what is odd about the clip; empty if nothing is.
    """

    clip: MotionClip
    start: int
    frames_in_file: int
    note: str = ""


@dataclass(frozen=True, eq=False)
class LabelledClip:
    """A clip with everything its features need.

    Attributes:
        clip: T frames.
        labels: phase of the T frames; no frame is labelled if the layout uses no phase of the gait cycle.
        gait: [T, 6], or None without a `.gait` file.
        symmetric: whether the clip's style may be mirrored.
        note: what is odd about the clip's file; empty if nothing is.
        world: the clip's joints in the world, if they have been computed already.
    """

    clip: MotionClip
    labels: PhaseLabels
    gait: np.ndarray | None = None
    symmetric: bool = True
    note: str = ""
    world: WorldMotion | None = None


def read_cut_clip(clip_file: ClipFile, roles_file: str | Path | None = None) -> CutClip:
    """Reads a listed clip, cuts it to its frames, and repairs those (`assumptions.repair`).

    A stop beyond the end of the file means its end, and is noted.

    Args:
        clip_file: the clip and the frames used.
        roles_file: JSON file that names the joints' roles, unless the clip has its own.

    Raises:
        InputError: as `read_whole_clip`; or if the cut starts beyond the end, naming the table that states it.
    """
    path = clip_file.path
    whole = read_whole_clip(path, clip_file.read_options, clip_file.roles_file or roles_file)
    stop = whole.num_frames if clip_file.stop is None else clip_file.stop
    file, place = clip_file.cut_by or (path, "cut")
    if clip_file.start >= whole.num_frames:
        rule = f"must lie within the {whole.num_frames} frames of {path.name}"
        raise InputError(file, place, f"start {clip_file.start}", rule)
    note = ""
    if stop > whole.num_frames:
        note = f"{place}: stop {stop} lies beyond the clip's {whole.num_frames} frames, its end is used"
    part = repair(cut(whole, clip_file.start, min(stop, whole.num_frames)), clip_file.read_options)
    part = replace(part, style=clip_file.style, content=clip_file.content)
    start = clip_file.start if part.reading is None else part.reading.first_frame
    return CutClip(part, start, whole.num_frames, "; ".join(filter(None, (note, *part.notes))))


def load_clip(clip_file: ClipFile, *, fps: float = 60.0, roles_file: str | Path | None = None) -> MotionClip:
    """Reads a listed clip, cut to its frames and resampled.

    Raises:
        InputError: as `read_cut_clip`.
    """
    return resample(read_cut_clip(clip_file, roles_file).clip, fps)


def load_labelled(
    clip_file: ClipFile,
    fps: float = 60.0,
    roles_file: str | Path | None = None,
    *,
    phase: bool = True,
    fit: Callable[[MotionClip], MotionClip] | None = None,
) -> LabelledClip:
    """Reads a listed clip, cut to its frames and resampled, with its labels.

    A `.phase` file takes precedence over the labeller. A `.gait` file's crouch is measured from the head
    (`flat_crouch`), as clips are assumed to be on flat ground.

    Args:
        clip_file: the clip and the frames used.
        fps: frames per second wanted.
        roles_file: JSON file that names the joints' roles.
        phase: whether to label the phase of the gait cycle, which hops and slides lack.
        fit: applied to the clip before it is labelled, such as `extend_hands`.

    Raises:
        NoGaitError: if `phase` is true and the clip has no steps.
        InputError: for bad files, or a skeleton without roles.
    """
    path = clip_file.path
    part = read_cut_clip(clip_file, roles_file)
    clip = resample(part.clip, fps)
    world = world_motion(clip if fit is None else fit(clip))
    need_roles(world.skeleton, path)
    labels = _phase_labels(path.with_suffix(".phase"), part, world) if phase else _no_phase(clip.num_frames)
    gait = _gait(path.with_suffix(".gait"), part, world)
    return LabelledClip(world.clip, labels, gait, clip_file.symmetric, part.note, world)


def _phase_labels(file: Path, part: CutClip, clip: WorldMotion) -> PhaseLabels:
    if not file.is_file():
        return label_phase(clip)
    labels = cut_phase(read_phase(file, part.frames_in_file), part.start, part.start + part.clip.num_frames)
    return resample_phase(labels, part.clip.fps, clip.fps, clip.num_frames)


def _no_phase(num_frames: int) -> PhaseLabels:
    none = np.empty(0, np.int64)
    return PhaseLabels(np.zeros(num_frames), np.zeros(num_frames, bool), none, none)


def _gait(file: Path, part: CutClip, clip: WorldMotion) -> np.ndarray | None:
    if not file.is_file():
        return None
    gait = read_gait(file, part.frames_in_file)[part.start : part.start + part.clip.num_frames]
    gait = resample_gait(gait, part.clip.fps, clip.fps, clip.num_frames)
    return flat_crouch(gait, clip.positions[:, clip.roles.head, 1])
