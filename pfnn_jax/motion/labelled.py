"""One clip with its labels: from a `.phase` and a `.gait` file beside the BVH file, or found from the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut, resample
from pfnn_jax.motion.gait import flat_crouch, read_gait, resample_gait
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.phase import PhaseLabels, cut_phase, label_phase, read_phase, resample_phase
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.sources import ClipFile


@dataclass(frozen=True, eq=False)
class LabelledClip:
    """A clip ready for `clip_features`.

    Attributes:
        clip: T frames.
        labels: of the T frames.
        gait: [T, 6], or None where no `.gait` file lies beside the BVH file.
        symmetric: whether the clip's style may be mirrored.
    """

    clip: MotionClip
    labels: PhaseLabels
    gait: np.ndarray | None = None
    symmetric: bool = True


def load_labelled(clip_file: ClipFile, fps: float = 60.0, roles_file: Path | None = None) -> LabelledClip:
    """Reads a clip, cuts it to its frames and resamples it, with the labels that lie beside it.

    A `.phase` file wins over the labeller. A `.gait` file's crouch is measured from the head (`flat_crouch`), as
    clips are taken to be on flat ground.

    Raises:
        NoGaitError: if there are no steps.
        InputError: for bad files, or a skeleton without roles.
    """
    path = Path(clip_file.path)
    whole = read_bvh(path, unit=clip_file.unit, roles_file=roles_file)
    roles = need_roles(whole.skeleton, path)
    start = clip_file.start
    stop = whole.num_frames if clip_file.stop is None else min(clip_file.stop, whole.num_frames)
    part = cut(whole, start, stop)
    clip = replace(resample(part, fps), style=clip_file.style, content=clip_file.content)
    labels_file, gait_file = path.with_suffix(".phase"), path.with_suffix(".gait")
    if labels_file.is_file():
        labels = cut_phase(read_phase(labels_file, whole.num_frames), start, stop)
        labels = resample_phase(labels, part.fps, fps, clip.num_frames)
    else:
        labels = label_phase(clip)
    gait = None
    if gait_file.is_file():
        gait = resample_gait(read_gait(gait_file, whole.num_frames)[start:stop], part.fps, fps, clip.num_frames)
        positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
        gait = flat_crouch(gait, positions[:, roles.head, 1])
    return LabelledClip(clip, labels, gait, clip_file.symmetric)
