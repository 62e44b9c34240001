"""Clips as they stand: with Y up, and the direction that the body faces in every frame."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.reading import Up
from pfnn_jax.motion.skeleton import Roles
from pfnn_jax.motion.up_axis import find_up, stand_up


def upright(clip: MotionClip, up: Up = "auto") -> MotionClip:
    """Returns the clip with Y up, which all drawing assumes.

    Args:
        clip: the motion. Clips that were read from a file have Y up already.
        up: the axis that points up in the clip; `auto` finds it from how the body stands, if the skeleton has a map.
    """
    if up == "auto":
        up = "y"
        if clip.skeleton.humanoid is not None and clip.reading is None:
            positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
            up = find_up(positions, clip.skeleton.humanoid)[0]
    return stand_up(clip, up)


def facing_angles(positions: np.ndarray, roles: Roles | None) -> np.ndarray:
    """Returns the facing direction [T] of hips and shoulders in radians; zero if the skeleton's roles are unknown.

    Args:
        positions: [T, J, 3] metres of the joints.
        roles: of the joints.
    """
    if roles is None:
        return np.zeros(len(positions))
    across = positions[:, roles.left_hip] - positions[:, roles.right_hip]
    across = across + positions[:, roles.left_shoulder] - positions[:, roles.right_shoulder]
    return np.arctan2(-across[:, 2], across[:, 0])
