"""Which parts of the feet stand on the ground, from speed and height, with thresholds scaled to the skeleton."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from pfnn_jax.motion.skeleton import Roles

MAX_SPEED = 0.6
"""Leg lengths per second below which a foot part stands still (about 0.5 m/s for a leg of 0.85 m)."""

MAX_HEIGHT = 0.09
"""Leg lengths above its own resting height up to which a foot part can stand on the ground."""

SMOOTHING_SECONDS = 1 / 60
"""Gaussian of one frame at 60 fps: takes the ripple off motion that was captured at 30 fps and resampled."""

GROUND_PERCENTILE = 5.0  # a foot part rests for far more than this share of any gait


def leg_length(positions: np.ndarray, roles: Roles) -> float:
    """Longest distance from hip to ankle in the clip, metres: a leg is nearly straight once in every stride.

    Args:
        positions: [T, J, 3] metres.
        roles: hips and feet.
    """
    pairs = ((roles.left_hip, roles.left_foot[0]), (roles.right_hip, roles.right_foot[0]))
    return max(float(np.linalg.norm(positions[:, hip] - positions[:, heel], axis=-1).max()) for hip, heel in pairs)


def foot_joints(roles: Roles) -> list[int]:
    """Joints in the order of contacts: left heel, left toe, right heel, right toe."""
    return [*roles.left_foot, *roles.right_foot]


def slow_feet(positions: np.ndarray, roles: Roles, fps: float, speed: float) -> np.ndarray:
    """Feet that move less than `speed` to the next frame: the rule of Holden et al. 2017, without a height test.

    Args:
        positions: [T, J, 3] metres.
        roles: feet.
        fps: frames per second.
        speed: metres per second.

    Returns:
        [T, 4] bool: left heel, left toe, right heel, right toe. The last frame repeats the one before.
    """
    feet = positions[:, foot_joints(roles)]
    step = np.linalg.norm(np.diff(feet, axis=0), axis=-1) * fps
    return np.concatenate([step, step[-1:]]) < speed


def foot_contacts(
    positions: np.ndarray,
    roles: Roles,
    fps: float,
    max_speed: float = MAX_SPEED,
    max_height: float = MAX_HEIGHT,
) -> np.ndarray:
    """Foot parts that are slow and low.

    Speed is that of the smoothed central difference; height is measured above the lowest part of the clip for that
    joint (5th percentile), so that ankles and toes of any skeleton, and a floor that is not at zero, need no setting.

    Args:
        positions: [T, J, 3] metres.
        roles: hips and feet.
        fps: frames per second.
        max_speed: leg lengths per second.
        max_height: leg lengths.

    Returns:
        [T, 4] bool: left heel, left toe, right heel, right toe.
    """
    leg = leg_length(positions, roles)
    feet = gaussian_filter1d(positions[:, foot_joints(roles)], SMOOTHING_SECONDS * fps, axis=0, mode="nearest")
    speed = np.linalg.norm(np.gradient(feet, 1 / fps, axis=0), axis=-1)
    height = feet[..., 1] - np.percentile(feet[..., 1], GROUND_PERCENTILE, axis=0)
    return (speed < max_speed * leg) & (height < max_height * leg)
