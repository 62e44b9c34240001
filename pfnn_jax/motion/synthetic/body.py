"""Poses the body over planted feet: trunk, arms and head by functions of phase, legs by exact inverse kinematics."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.filters import moving_minimum
from pfnn_jax.motion.kinematics import (
    quat_conjugate,
    quat_from_axis_angle,
    quat_from_euler,
    quat_from_matrix,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.feet import Foot, Walk
from pfnn_jax.motion.synthetic.skeleton import ANKLE_HEIGHT, SHIN, THIGH
from pfnn_jax.motion.synthetic.styles import SyntheticStyle

STRAIGHTEST = 0.996
"""Maximum distance from hip to ankle as a share of the leg's length; leaves about 10° of knee bend."""
STANDING = ANKLE_HEIGHT + THIGH + SHIN + 0.03  # height of the hips over straight legs, metres
LOWERING = 0.18  # seconds over which the hips are lowered where a leg would be overstretched
SOFTNESS = 0.02  # metres; softness of the minimum of the hips' own height and what the legs can reach
GRAVITY = 9.81
X, Y, Z = np.eye(3)


class Wobble:
    """Slow, smooth, seeded noise, so that no two cycles are equal."""

    def __init__(self, num_frames: int, fps: float, rng: np.random.Generator):
        self._time = np.arange(num_frames) / fps
        self._rng = rng

    def __call__(self, amplitude: float) -> np.ndarray:
        """Returns [T] values with standard deviation `amplitude`: four sinusoids of 0.1 to 0.8 Hz."""
        frequency = self._rng.uniform(0.1, 0.8, (4, 1))
        offset = self._rng.uniform(0, 2 * np.pi, (4, 1))
        return amplitude * np.sin(2 * np.pi * frequency * self._time + offset).sum(axis=0) / np.sqrt(2)


def pose_body(
    skeleton: Skeleton, style: SyntheticStyle, walk: Walk, feet: tuple[Foot, Foot], wobble: Wobble
) -> tuple[np.ndarray, np.ndarray]:
    """Poses everything from the hips up, then the legs that join the hips to the planted feet.

    Args:
        skeleton: of all walkers.
        style: parameters of the walk.
        walk: root path and phase, T frames.
        feet: left and right foot.
        wobble: noise.

    Returns:
        (hips [T, 3] metres, local rotations [T, J, 4] wxyz).
    """
    rotations = np.zeros((len(walk.phase), skeleton.num_joints, 4))
    rotations[..., 0] = 1.0
    index = {name: joint for joint, name in enumerate(skeleton.names)}
    lean_in = style.bank * np.arctan(walk.speed * walk.turn_rate / GRAVITY)
    trunk = _trunk(style, walk, lean_in, wobble)
    for name, rotation in {**trunk, **_arms(style, walk, wobble)}.items():
        rotations[:, index[name]] = rotation
    pelvis = quat_multiply(quat_from_yaw(walk.yaw), trunk["Hips"])
    rotations[:, 0] = pelvis
    hips = _hips(skeleton, style, walk, feet, pelvis, lean_in, wobble)
    for side, foot in zip(("Left", "Right"), feet, strict=True):
        joints = [index[side + part] for part in ("UpLeg", "Leg", "Foot", "ToeBase")]
        outward = np.deg2rad(style.knee_out) * (1.0 if side == "Left" else -1.0)
        socket = hips + quat_rotate(pelvis, skeleton.offsets[joints[0]])
        rotations[:, joints] = _leg(pelvis, socket, foot, walk.yaw, outward)
    return hips, rotations


def _turn(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Returns the quaternion of yaw (to the left), then pitch (forward), then roll (left side up), in degrees."""
    return quat_from_euler(np.deg2rad(np.stack(np.broadcast_arrays(yaw, pitch, roll), axis=-1)), "YXZ")


def _trunk(style: SyntheticStyle, walk: Walk, lean_in: np.ndarray, wobble: Wobble) -> dict[str, np.ndarray]:
    stride, over = np.cos(walk.phase), np.cos(walk.phase - np.pi * style.duty)
    step = np.cos(2 * (walk.phase - np.deg2rad(style.bob_delay)))
    vigour = np.clip(walk.vigour, 0.3, 1.3)
    into = np.rad2deg(lean_in)
    hip_yaw, hip_roll = style.hip_yaw * vigour * stride, -style.hip_roll * over
    shoulder_yaw = -style.twist * vigour * np.cos(walk.phase - np.deg2rad(style.arm_lag)) + wobble(0.8)
    lean = style.lean * (0.8 + 0.2 * vigour) + style.lean_bob * step + wobble(0.7)
    side = -hip_roll + style.trunk_roll * over - 0.6 * into + wobble(0.6)
    twist = shoulder_yaw - hip_yaw
    look = np.rad2deg(style.look * walk.turn_rate)
    nod = style.head_pitch - style.pelvis_pitch - lean + style.head_bob * step + wobble(1.2)
    tilt = -style.trunk_roll * over + 0.8 * into + style.head_roll * over + wobble(0.8)
    gaze = 0.8 * look - shoulder_yaw + wobble(1.5)
    return {
        "Hips": _turn(hip_yaw, style.pelvis_pitch + wobble(0.5), hip_roll - 0.4 * into),
        "Spine": _turn(0.5 * twist, 0.5 * lean, 0.6 * side),
        "Spine1": _turn(0.5 * twist + 0.2 * look, 0.5 * lean, 0.4 * side),
        "Neck": _turn(0.4 * gaze, 0.4 * nod, 0.4 * tilt),
        "Head": _turn(0.6 * gaze, 0.6 * nod, 0.6 * tilt),
    }


def _arms(style: SyntheticStyle, walk: Walk, wobble: Wobble) -> dict[str, np.ndarray]:
    """Returns both arms; the right one is the mirror image of the left one, half a cycle later."""
    pose = {}
    vigour = np.clip(walk.vigour, 0.2, 1.35)
    for side, delay in (("Left", 0.0), ("Right", np.pi)):
        wave = np.cos(walk.phase - np.deg2rad(style.arm_lag) - delay)
        late = np.cos(walk.phase - np.deg2rad(style.arm_lag + 25.0) - delay)  # the forearm follows
        swing = style.arm_raise + style.arm_swing * vigour * wave + wobble(1.5)
        lowered = 90.0 - style.arm_out + style.shrug + wobble(1.0)
        inward = style.arm_in + 6.0 * wave + wobble(1.5)
        bend = np.maximum(style.elbow + style.elbow_swing * vigour * late + wobble(1.5), 4.0)
        arm = quat_multiply(_about(X, -swing), quat_multiply(_about(Z, -lowered), _about(X, inward)))
        parts = {
            "Shoulder": quat_multiply(_about(Y, -style.hunch + 0 * swing), _about(Z, style.shrug + 0 * swing)),
            "Arm": arm,
            "ForeArm": _about(Y, -bend),
            "Hand": _about(Y, style.wrist + wobble(2.0)),
        }
        flip = np.array([1.0, 1.0, 1.0, 1.0] if side == "Left" else [1.0, 1.0, -1.0, -1.0])
        pose |= {side + part: rotation * flip for part, rotation in parts.items()}
    return pose


def _about(axis: np.ndarray, degrees: np.ndarray) -> np.ndarray:
    return quat_from_axis_angle(axis, np.deg2rad(degrees))


def _hips(
    skeleton: Skeleton,
    style: SyntheticStyle,
    walk: Walk,
    feet: tuple[Foot, Foot],
    pelvis: np.ndarray,
    lean_in: np.ndarray,
    wobble: Wobble,
) -> np.ndarray:
    """Returns the hips [T, 3]: over the root, swaying and bobbing, never higher than both legs can reach."""
    over = np.cos(walk.phase - np.pi * style.duty)  # 1 when the right leg carries the body
    sideways = -style.sway * over + 0.25 * np.tan(lean_in) + wobble(0.004)
    back = -0.14 * np.sin(np.deg2rad(style.lean + style.pelvis_pitch))  # the trunk's weight stays over the feet
    offset = np.stack([sideways, np.zeros_like(sideways), back + np.zeros_like(sideways)], axis=-1)
    hips = quat_rotate(quat_from_yaw(walk.yaw), offset)
    hips[:, [0, 2]] += walk.position
    bob = style.hip_bob * np.clip(walk.vigour, 0.3, 1.3) * np.cos(2 * (walk.phase - np.deg2rad(style.bob_delay)))
    height = STANDING - style.crouch - style.hip_bob - bob + wobble(0.002)
    reach, highest = STRAIGHTEST * (THIGH + SHIN), np.full(len(height), STANDING)
    for name, foot in zip(("LeftUpLeg", "RightUpLeg"), feet, strict=True):
        arm = quat_rotate(pelvis, skeleton.offsets[skeleton.names.index(name)])
        flat = foot.ankle - hips - arm
        rise = np.sqrt(np.maximum(reach**2 - flat[:, 0] ** 2 - flat[:, 2] ** 2, 0.0))
        highest = np.minimum(highest, foot.ankle[:, 1] + rise - arm[:, 1])
    highest = _rounded_below(highest, walk.fps)
    hips[:, 1] = (height + highest - np.sqrt((height - highest) ** 2 + SOFTNESS**2)) / 2  # a smooth minimum
    return hips


def _rounded_below(limit: np.ndarray, fps: float) -> np.ndarray:
    """Returns a smooth curve that nowhere exceeds `limit` [T]: its running minimum, averaged over an equal window."""
    width = max(3, round(LOWERING * fps) | 1)
    window = np.hanning(width + 2)[1:-1]
    lowest = np.pad(moving_minimum(limit, width), width // 2, mode="edge")
    return np.convolve(lowest, window / window.sum(), mode="valid")


def _leg(pelvis: np.ndarray, socket: np.ndarray, foot: Foot, yaw: np.ndarray, outward: float) -> np.ndarray:
    """Returns local rotations [T, 4, 4] of upper leg, lower leg, foot and toes that put the ankle at its target.

    The knee is a hinge: thigh and shin share their sideways axis, and it points midway between body and foot.
    """
    line = foot.ankle - socket
    distance = np.linalg.norm(line, axis=-1, keepdims=True)
    down = line / distance
    heading = (yaw + foot.yaw) / 2 + outward
    forward = np.stack([np.sin(heading), 0 * heading, np.cos(heading)], axis=-1)
    across = np.cross(-down, forward)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    ahead = np.cross(across, -down)
    along = (THIGH**2 - SHIN**2 + distance**2) / (2 * distance)
    knee = along * down + np.sqrt(np.maximum(THIGH**2 - along**2, 0.0)) * ahead
    bones = [_bone(-knee / THIGH, across), _bone((knee - line) / SHIN, across)]
    bones += [_foot(foot.yaw, pitch) for pitch in (foot.pitch, foot.toe_pitch)]
    parents = [pelvis, *bones[:-1]]
    pairs = zip(parents, bones, strict=True)
    return np.stack([quat_multiply(quat_conjugate(parent), bone) for parent, bone in pairs], axis=1)


def _bone(up: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Returns the rotation whose +Y is `up` [T, 3] and whose +X is `across` [T, 3]."""
    return quat_from_matrix(np.stack([across, up, np.cross(across, up)], axis=-1))


def _foot(yaw: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    return quat_multiply(quat_from_yaw(yaw), quat_from_axis_angle(X, pitch))
