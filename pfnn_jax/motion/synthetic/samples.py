"""The sample clips of the package: straight walks in styles that no procedural data set has, on three skeletons."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_axis_angle, quat_multiply, quat_rotate
from pfnn_jax.motion.length_unit import CENTIMETRE
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.styles import STYLES, UNSEEN_STYLE, SyntheticStyle
from pfnn_jax.motion.synthetic.walks import synthesise

SECONDS = 4.0
FPS = 30.0

X, _, Z = np.eye(3)

_SOLDIER = SyntheticStyle(
    "soldier", speed=1.45, cadence=0.92, duty=0.57, step_width=0.1, toe_out=4, swing_height=0.24, strike=4, push_off=48,
    crouch=0.012, hip_bob=0.03, sway=0.012, hip_roll=2, hip_yaw=4, lean=-5, lean_bob=1, pelvis_pitch=-1, twist=5,
    head_pitch=-6, head_bob=0.5, head_roll=0.2, arm_raise=14, arm_swing=62, arm_lag=0, arm_out=6, arm_in=2, elbow=6,
    elbow_swing=2, shrug=1, hunch=-12,
)  # fmt: skip

_APE = SyntheticStyle(
    "ape", speed=0.9, cadence=0.82, duty=0.64, step_width=0.34, toe_out=20, swing_height=0.07, circumduction=0.07,
    strike=2, push_off=24, heel_off=0.66, knee_out=24, crouch=0.2, hip_bob=0.02, sway=0.07, hip_roll=-3, hip_yaw=12,
    lean=46, lean_bob=3, pelvis_pitch=16, twist=14, trunk_roll=11, head_pitch=-4, head_roll=4, arm_raise=52,
    arm_swing=20, arm_lag=20, arm_out=30, arm_in=26, elbow=26, elbow_swing=8, shrug=12, hunch=20, wrist=30,
)  # fmt: skip


@dataclass(frozen=True)
class Sample:
    """How a sample clip is made.

    Attributes:
        style: of the walk.
        prefix: of the joints' names.
        size: of the body, as a multiple of the walkers'.
        z_up: whether Z points up in the file, in place of Y.
        lowered: radians by which the arms are lowered in the rest pose, from a T pose.
        unit: metres per unit of the file.
    """

    style: SyntheticStyle
    prefix: str = ""
    size: float = 1.0
    z_up: bool = False
    lowered: float = 0.0
    unit: float = CENTIMETRE


SAMPLES: dict[str, Sample] = {
    UNSEEN_STYLE: Sample(STYLES[UNSEEN_STYLE]),
    "soldier": Sample(_SOLDIER, prefix="mixamorig:", size=1.08, z_up=True),
    "ape": Sample(_APE, prefix="Character1_", size=0.9, lowered=np.deg2rad(50.0), unit=1.0),
}
"""The clips by name. Their skeletons, units and up axes differ, as those of clips from different software do."""


def make_sample(sample: Sample) -> MotionClip:
    """Returns a walk straight ahead at the style's natural speed, in metres, as its file is to contain it."""
    frames = round(SECONDS * FPS)
    walk, _ = synthesise(sample.style, np.zeros(frames), np.full(frames, sample.style.speed), fps=FPS)
    clip = _with_rest_pose(walk, sample.lowered)
    skeleton = replace(
        clip.skeleton,
        names=tuple(sample.prefix + name for name in clip.skeleton.names),
        offsets=clip.skeleton.offsets * sample.size,
        end_sites=tuple((joint, site * sample.size) for joint, site in clip.skeleton.end_sites),
    )
    clip = replace(clip, skeleton=skeleton, root_positions=clip.root_positions * sample.size)
    return _z_up(clip) if sample.z_up else clip


def _with_rest_pose(clip: MotionClip, lowered: float) -> MotionClip:
    """Returns the same motion on a skeleton whose arms are lowered by an angle in its rest pose."""
    names = clip.skeleton.names
    frames = np.zeros((len(names), 4))  # of each joint's new axes in its old ones
    frames[:, 0] = 1.0
    for side, angle in (("Left", lowered), ("Right", -lowered)):
        joints = [names.index(side + part) for part in ("Arm", "ForeArm", "Hand")]
        frames[joints] = quat_from_axis_angle(Z, np.full(3, angle))
    above = frames[np.maximum(clip.skeleton.parents, 0)]
    rotations = quat_multiply(quat_multiply(quat_conjugate(above), clip.rotations), frames)
    rotations[:, 0] = quat_multiply(clip.rotations[:, 0], frames[0])
    return replace(clip, skeleton=_turned(clip.skeleton, quat_conjugate(frames)), rotations=rotations)


def _z_up(clip: MotionClip) -> MotionClip:
    """Returns the same motion in axes whose Z points up: those of the world, and those of all joints."""
    turn = quat_from_axis_angle(X, np.array(0.5 * np.pi))
    skeleton = _turned(clip.skeleton, np.broadcast_to(turn, (clip.skeleton.num_joints, 4)))
    rotations = quat_multiply(quat_multiply(turn, clip.rotations), quat_conjugate(turn))
    return replace(clip, skeleton=skeleton, rotations=rotations, root_positions=quat_rotate(turn, clip.root_positions))


def _turned(skeleton: Skeleton, turns: np.ndarray) -> Skeleton:
    """Returns the skeleton with the bones that begin at each joint turned by its quaternion [J, 4]."""
    return replace(
        skeleton,
        offsets=quat_rotate(turns[np.maximum(skeleton.parents, 0)], skeleton.offsets),
        end_sites=tuple((joint, quat_rotate(turns[joint], site)) for joint, site in skeleton.end_sites),
    )
