"""One clip with its labels: from a `.phase` and a `.gait` file beside the BVH file, or found from the motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.datasets.clip_file import ClipFile
from pfnn_jax.motion.datasets.sources import Take, read_take
from pfnn_jax.motion.labels.contacts import flat_crouch, read_gait, resample_gait
from pfnn_jax.motion.labels.phase import PhaseLabels, cut_phase, label_phase, read_phase, resample_phase
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.world_motion import WorldMotion, world_motion


@dataclass(frozen=True, eq=False)
class LabelledClip:
    """A clip ready for its features.

    Attributes:
        clip: T frames.
        labels: phase of the T frames; no frame is labelled where the layout wants no phase of the gait cycle.
        gait: [T, 6], or None where no `.gait` file lies beside the BVH file.
        symmetric: whether the clip's style may be mirrored.
        note: what was found odd about the clip's file; empty for nothing.
        world: the clip's joints in the world, where they have been computed already.
    """

    clip: MotionClip
    labels: PhaseLabels
    gait: np.ndarray | None = None
    symmetric: bool = True
    note: str = ""
    world: WorldMotion | None = None


def load_labelled(
    clip_file: ClipFile,
    fps: float = 60.0,
    roles_file: Path | None = None,
    *,
    phase: bool = True,
    fit: Callable[[MotionClip], MotionClip] | None = None,
) -> LabelledClip:
    """Reads a clip, cuts it to its frames and resamples it, with the labels that lie beside it.

    A `.phase` file wins over the labeller. A `.gait` file's crouch is measured from the head (`flat_crouch`), as
    clips are taken to be on flat ground.

    Args:
        clip_file: the clip and the frames used.
        fps: frames per second wanted.
        roles_file: JSON naming the joints' roles.
        phase: whether to label the phase of the gait cycle; hops and slides have none.
        fit: applied to the clip before it is labelled, such as `extend_hands`.

    Raises:
        NoGaitError: if `phase` is asked for and there are no steps.
        InputError: for bad files, or a skeleton without roles.
    """
    path = Path(clip_file.path)
    take = read_take(clip_file, roles_file)
    need_roles(take.clip.skeleton, path)
    clip = resample(take.clip, fps)
    world = world_motion(clip if fit is None else fit(clip))
    labels = _labels(path.with_suffix(".phase"), take, world) if phase else _no_phase(clip.num_frames)
    gait = _gait(path.with_suffix(".gait"), take, world)
    return LabelledClip(world.clip, labels, gait, clip_file.symmetric, take.note, world)


def _labels(file: Path, take: Take, clip: WorldMotion) -> PhaseLabels:
    if not file.is_file():
        return label_phase(clip)
    labels = cut_phase(read_phase(file, take.frames_in_file), take.start, take.start + take.clip.num_frames)
    return resample_phase(labels, take.clip.fps, clip.fps, clip.num_frames)


def _no_phase(num_frames: int) -> PhaseLabels:
    none = np.empty(0, np.int64)
    return PhaseLabels(np.zeros(num_frames), np.zeros(num_frames, bool), none, none)


def _gait(file: Path, take: Take, clip: WorldMotion) -> np.ndarray | None:
    if not file.is_file():
        return None
    gait = read_gait(file, take.frames_in_file)[take.start : take.start + take.clip.num_frames]
    gait = resample_gait(gait, take.clip.fps, clip.fps, clip.num_frames)
    return flat_crouch(gait, clip.positions[:, clip.roles.head, 1])
