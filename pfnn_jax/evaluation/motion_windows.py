"""Windows of motion, the inputs of the style classifier, from clips or from joint positions."""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from pfnn_jax.motion.body_points import POINT_NAMES
from pfnn_jax.motion.clip import MotionClip, mirror_clip
from pfnn_jax.motion.ground import to_local
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.skeleton import Roles, need_roles
from pfnn_jax.motion.trajectory import relative_to_root, root_motion
from pfnn_jax.transfer.clip_rows import clip_points

WINDOW_FPS = 60.0
"""Frame rate of the windows."""

WINDOW_FRAMES = 60
"""Frames per window: one second, about one gait cycle."""

STRIDE = 30
"""Frames between the starts of two windows."""

_POINT = POINT_NAMES.index

POINT_ROLES = Roles(
    hips=_POINT("hips"),
    left_hip=_POINT("left_thigh"),
    right_hip=_POINT("right_thigh"),
    left_shoulder=_POINT("left_upper_arm"),
    right_shoulder=_POINT("right_upper_arm"),
    left_foot=(_POINT("left_foot"), _POINT("left_toe")),
    right_foot=(_POINT("right_foot"), _POINT("right_toe")),
    left_hand=_POINT("left_hand"),
    right_hand=_POINT("right_hand"),
    head=_POINT("head"),
)
"""Roles of the 21 points of a body."""


def motion_windows(
    positions: np.ndarray,
    roles: Roles,
    fps: float,
    *,
    frames: int = WINDOW_FRAMES,
    stride: int = STRIDE,
    pad: bool = False,
) -> np.ndarray:
    """Returns windows of joint positions and velocities, each frame relative to its own root.

    The root is computed from the joints (`root_motion`), for real and generated motion alike. Heights are kept;
    position on the ground, heading and frame number are removed.

    Args:
        positions: [T, J, 3] metres, world joint positions.
        roles: hips, shoulders.
        fps: frames per second; motion at another rate than `WINDOW_FPS` is resampled linearly.
        frames: frames per window, at `WINDOW_FPS`.
        stride: frames between the starts of two windows.
        pad: repeat the first and the last frame of motion that is shorter than one window.

    Returns:
        [N, frames, 6 J] float32, positions in metres and velocities in metres per second; N is 0 if the motion is
        shorter than one window and not padded.
    """
    positions = _at_rate(np.asarray(positions, np.float64), fps)
    if pad and (missing := frames + 1 - len(positions)) > 0:
        positions = np.pad(positions, ((missing // 2, missing - missing // 2), (0, 0), (0, 0)), mode="edge")
    if len(positions) < frames + 1:
        return np.zeros((0, frames, 6 * positions.shape[1]), np.float32)
    root = root_motion(positions, roles, WINDOW_FPS)
    velocities = to_local(np.diff(positions, axis=0) * WINDOW_FPS, root.facing[1:])
    rows = np.concatenate([relative_to_root(positions, root)[1:], velocities], axis=1).reshape(len(positions) - 1, -1)
    starts = np.arange(0, len(rows) - frames + 1, stride)
    return rows[starts[:, None] + np.arange(frames)].astype(np.float32)


def clip_windows(
    clip: MotionClip, *, mirror: bool = False, frames: int = WINDOW_FRAMES, stride: int = STRIDE
) -> np.ndarray:
    """Returns the `motion_windows` of a clip with roles, followed by those of its mirror image if `mirror` is set."""
    roles = need_roles(clip.skeleton, clip.source)
    parts = [
        motion_windows(_world(one), roles, one.fps, frames=frames, stride=stride)
        for one in ((clip, mirror_clip(clip)) if mirror else (clip,))
    ]
    return np.concatenate(parts)


def point_windows(clip: MotionClip, *, frames: int = WINDOW_FRAMES, stride: int = STRIDE) -> np.ndarray:
    """Returns the `motion_windows` [N, frames, 126] of a clip's 21 points, padded to at least one window.

    Fingers and helper joints, which not all skeletons have, do not count.
    """
    return motion_windows(clip_points(clip), POINT_ROLES, clip.fps, frames=frames, stride=stride, pad=True)


def _world(clip: MotionClip) -> np.ndarray:
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def _at_rate(positions: np.ndarray, fps: float) -> np.ndarray:
    if abs(fps - WINDOW_FPS) < 1e-6:
        return positions
    step = float(Fraction(fps / WINDOW_FPS).limit_denominator(1000))
    times = np.arange(int(np.floor((len(positions) - 1) / step + 1e-6)) + 1) * step
    before = np.minimum(times.astype(int), len(positions) - 1)
    after = np.minimum(before + 1, len(positions) - 1)
    share = (times - before)[:, None, None]
    return positions[before] * (1 - share) + positions[after] * share
