"""Splits a motion into the travel of its root along the ground and the motion in place.

Game engines take travel from the root joint (root motion) or move the character themselves and want a walk on the spot.
Both come from one split, such that one is the other with or without its root: the root is a point on the ground that
travels and turns evenly; sway, bob and the swing of the hips stay with the body.

- A cycle (its last pose is its first, moved along the ground) has a root that moves along a circular arc at constant
  speed, so that the cycle in place closes exactly.
- The root of any other motion is the path of the hips without what is faster than a step, and the heading of hips and
  shoulders likewise. Public clips in place (Mixamo) keep turns; here turns leave with the travel, since a walk in a
  circle that turns on the spot is of no use to an engine that turns the character itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.ground import facing_of, to_local, to_world, turn, wrap_angle, yaw_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.kinematics import positions_of, quat_conjugate, quat_from_yaw, quat_multiply, quat_normalise

SMOOTHING_SECONDS = 0.5
"""Standard deviation of the Gaussian that smooths the root: of a sway at one stride a second it leaves one per cent."""

SAME = 1e-6
"""Largest difference of two equal poses: of quaternion components, and of the hips' height in metres."""

STRAIGHT = 1e-6  # radians of turn in a cycle below which its path is a line


@dataclass(frozen=True, eq=False)
class RootMotion:
    """The travel of a root along the ground.

    Attributes:
        positions: [T, 3] metres, on y = 0.
        yaw: [T] radians about +Y, continuous; 0 faces +Z.
    """

    positions: np.ndarray
    yaw: np.ndarray

    @property
    def rotations(self) -> np.ndarray:
        """[T, 4] wxyz."""
        return quat_from_yaw(self.yaw)


def split_root(clip: MotionClip) -> tuple[RootMotion, MotionClip]:
    """Returns the travel of a clip and the clip in place, at the origin facing +Z.

    Moving and turning each frame of the second by the first gives the clip again.

    Raises:
        InputError: for a skeleton without humanoid map, which shows where the body faces.
    """
    path, yaw = _closed_root(clip) if is_cycle(clip) else _smooth_root(clip)
    local = to_local(clip.root_positions - path, facing_of(yaw))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(quat_from_yaw(-yaw), rotations[:, 0])
    return RootMotion(path, yaw), replace(clip, root_positions=local, rotations=rotations)


def in_place(clip: MotionClip) -> MotionClip:
    """Returns the clip on the spot: at the origin facing +Z, without travel and turns; raises as `split_root`."""
    return split_root(clip)[1]


def is_cycle(clip: MotionClip) -> bool:
    """Returns whether the last pose of a clip is its first, moved along the ground and turned about the vertical."""
    first, last = quat_normalise(clip.rotations[[0, -1]])  # clips in single precision have lengths off by 1e-6
    if clip.num_frames < 3 or abs(clip.root_positions[-1, 1] - clip.root_positions[0, 1]) > SAME:
        return False
    again = first.copy()
    again[0] = quat_multiply(quat_from_yaw(_turn_between(first[0], last[0])), first[0])
    return bool(np.all(1.0 - np.abs(np.sum(again * last, axis=-1)) <= SAME))


def cycle_yaw(clip: MotionClip) -> float:
    """Returns by how many radians, in [-π, π), a cycle turns from its first to its last frame."""
    return _turn_between(clip.rotations[0, 0], clip.rotations[-1, 0])


def _turn_between(first: np.ndarray, last: np.ndarray) -> float:
    """Returns the yaw in radians, in [-π, π), of the rotation from one orientation [4] to another."""
    w, _, y, _ = quat_multiply(last, quat_conjugate(first))
    return float(wrap_angle(2.0 * np.arctan2(y, w)))


def _closed_root(clip: MotionClip) -> tuple[np.ndarray, np.ndarray]:
    """Returns the path [T, 3] and the yaw [T] of a cycle: an arc, or a line, on whose middle the hips sway."""
    share = np.linspace(0.0, 1.0, clip.num_frames)
    hips, yaw = _hips_and_yaw(clip)
    angle = cycle_yaw(clip)
    turned = share * angle
    facing = float(np.mean(yaw[:-1] - turned[:-1]))
    step = clip.root_positions[-1] - clip.root_positions[0]
    origin = clip.root_positions[0]
    # the rigid motion of the ground from the first frame to the last, shared out evenly
    if abs(angle) < STRAIGHT:
        path = origin + share[:, None] * step
    else:
        cos, sin = np.cos(angle) - 1.0, np.sin(angle)
        x, z = np.linalg.solve(np.array([[cos, sin], [-sin, cos]]), step[[0, 2]])
        arm = np.array([x, 0.0, z])  # from the centre of the arc
        path = origin - arm + turn(np.tile(arm, (clip.num_frames, 1)), turned)
    path = path * np.array([1.0, 0.0, 1.0])
    sway = to_local(hips - path, facing_of(turned))[:-1].mean(axis=0) * np.array([1.0, 0.0, 1.0])
    return path + to_world(np.broadcast_to(sway, path.shape), facing_of(turned)), facing + turned


def _smooth_root(clip: MotionClip) -> tuple[np.ndarray, np.ndarray]:
    """Returns the path [T, 3] and the yaw [T] of a motion, without what is faster than a step."""
    hips, yaw = _hips_and_yaw(clip)
    smooth = _smooth(np.concatenate([hips[:, [0, 2]], yaw[:, None]], axis=-1), SMOOTHING_SECONDS * clip.fps)
    return np.stack([smooth[:, 0], np.zeros(len(hips)), smooth[:, 1]], axis=-1), smooth[:, 2]


def _smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    """Returns values [T, n] smoothed by a Gaussian of `sigma` frames; beyond both ends they go on as they came."""
    pad = min(int(np.ceil(4 * sigma)), len(values) - 1)
    if pad < 1:
        return values
    before = 2 * values[:1] - values[pad:0:-1]
    after = 2 * values[-1:] - values[-2 : -pad - 2 : -1]
    return gaussian_filter(np.concatenate([before, values, after]), sigma)[pad : pad + len(values)]


def _hips_and_yaw(clip: MotionClip) -> tuple[np.ndarray, np.ndarray]:
    """Returns the hips [T, 3] in metres and the continuous yaw [T] in radians to which hips and shoulders face."""
    body = need_humanoid(clip.skeleton, clip.source or "clip")
    pairs = [(body.left_thigh, body.right_thigh), (body.left_upper_arm, body.right_upper_arm)]
    joints = [joint for pair in pairs for joint in pair if joint is not None]
    positions = positions_of([body.hips, *joints], clip.skeleton, clip.root_positions, clip.rotations)
    across = np.sum(positions[:, 1::2] - positions[:, 2::2], axis=1)
    forward = np.cross(across, (0.0, 1.0, 0.0))
    return positions[:, 0], np.unwrap(yaw_of(forward[:, [0, 2]]))
