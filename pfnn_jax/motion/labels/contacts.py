"""Which feet are on the ground, and which gait a character is in: labels that are read off speed and height.

Contacts are measured from the motion. Gait labels, which only layout `pfnn2017` uses, are read from `.gait` files or
estimated from speed.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pfnn_jax.io.text_rows import read_rows
from pfnn_jax.motion.features.layout import GAITS
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.skeleton import Roles

MAX_SPEED = 0.6
"""Leg lengths per second below which a foot part counts as still (about 0.5 m/s for a leg of 0.85 m)."""

MAX_HEIGHT = 0.09
"""Leg lengths above its own resting height up to which a foot part counts as on the ground."""

SMOOTHING_SECONDS = 1 / 60
"""Gaussian of one frame at 60 fps: removes the ripple of motion that was captured at 30 fps and resampled."""

GROUND_PERCENTILE = 5.0  # a foot part rests for far more than this share of any gait


def measured_leg_length(positions: np.ndarray, roles: Roles) -> float:
    """Returns the longest distance from hip to ankle in a clip in metres: legs are nearly straight once a stride.

    Args:
        positions: [T, J, 3] metres.
        roles: hips and feet.
    """
    pairs = ((roles.left_hip, roles.left_foot[0]), (roles.right_hip, roles.right_foot[0]))
    return max(float(np.linalg.norm(positions[:, hip] - positions[:, heel], axis=-1).max()) for hip, heel in pairs)


def foot_joints(roles: Roles) -> list[int]:
    """Returns the joints in the order of contacts: left heel, left toe, right heel, right toe."""
    return [*roles.left_foot, *roles.right_foot]


def slow_feet(positions: np.ndarray, roles: Roles, fps: float, speed: float) -> np.ndarray:
    """Returns which feet move slower than `speed` to the next frame (Holden et al. 2017, without a height test).

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
    """Returns which parts of the feet are on the ground: those that are slow and low.

    Speeds are central differences of smoothed positions. Heights are measured above each joint's 5th percentile in the
    clip, so that no setting depends on the skeleton or on the height of the floor.

    Args:
        positions: [T, J, 3] metres.
        roles: hips and feet.
        fps: frames per second.
        max_speed: leg lengths per second.
        max_height: leg lengths.

    Returns:
        [T, 4] bool: left heel, left toe, right heel, right toe.
    """
    leg = measured_leg_length(positions, roles)
    feet = gaussian_filter(positions[:, foot_joints(roles)], SMOOTHING_SECONDS * fps)
    speed = np.linalg.norm(np.gradient(feet, 1 / fps, axis=0), axis=-1)
    height = feet[..., 1] - np.percentile(feet[..., 1], GROUND_PERCENTILE, axis=0)
    return (speed < max_speed * leg) & (height < max_height * leg)


CROUCH = GAITS.index("crouch")

GAIT_FILE_COLUMNS = 8
"""Columns of a `.gait` file: stand, walk, jog, run, crouch, jump, crawl, unknown."""

GRAVITY = 9.81  # metres per second squared
STAND_SPEED = 0.1
"""Speed over sqrt(gravity × leg length) below which a character stands."""

JOG_SPEED = 0.7
"""Speed over sqrt(gravity × leg length) above which it jogs: people change gait at a Froude number of about 0.5."""

FADE = 0.25  # half-width of the cross-fade around each limit, as a share of it
GAIT_SMOOTHING_SECONDS = 1 / 3  # speed swings within a step


def read_gait(path: Path, num_frames: int | None = None) -> np.ndarray:
    """Reads the gait of every frame of a BVH file from the `.gait` file next to it.

    Eight columns become six: jog and run are added, and so are crouch and crawl.

    Args:
        path: text file, one line of eight numbers for each frame.
        num_frames: frames of the BVH file; None does not check the number of lines.

    Returns:
        [T, 6] in the order of `layout.GAITS`.

    Raises:
        InputError: if the number of lines or columns is wrong, or a value lies outside [0, 1].
    """
    stand, walk, jog, run, crouch, jump, crawl, unknown = read_rows(path, GAIT_FILE_COLUMNS, num_frames).T
    return np.stack([stand, walk, jog + run, crouch + crawl, jump, unknown], axis=-1)


def flat_crouch(gait: np.ndarray, head_height: np.ndarray) -> np.ndarray:
    """Replaces the label of crouching by a measurement, as the authors do on flat ground.

    Args:
        gait: [T, 6].
        head_height: [T] metres above the clip's origin.

    Returns:
        [T, 6] in which crouch is `1 - clip((head height - 0.8 m) / 0.5 m, 0, 1)`.
    """
    crouch = 1.0 - np.clip((head_height - 0.8) / 0.5, 0.0, 1.0)
    return np.insert(np.delete(gait, CROUCH, axis=1), CROUCH, crouch, axis=1)


def resample_gait(gait: np.ndarray, fps_from: float, fps_to: float, num_frames: int) -> np.ndarray:
    """Resamples gait labels linearly to [num_frames, 6], where frame k is at k / fps_to seconds."""
    source = np.arange(num_frames) * (fps_from / fps_to)
    return np.stack([np.interp(source, np.arange(len(gait)), column) for column in gait.T], axis=-1)


def estimate_gait(root_positions: np.ndarray, leg: float, fps: float) -> np.ndarray:
    """Estimates the gait from speed alone: stand, walk or jog, cross-faded linearly around each limit.

    Args:
        root_positions: [T, 2] metres on the ground.
        leg: leg length, metres.
        fps: frames per second.

    Returns:
        [T, 6] in the order of `layout.GAITS`; rows sum to 1; crouch, jump and bump are 0.
    """
    velocity = np.gradient(root_positions, 1 / fps, axis=0)
    velocity = gaussian_filter(velocity, GAIT_SMOOTHING_SECONDS * fps)
    speed = np.linalg.norm(velocity, axis=-1) / np.sqrt(GRAVITY * leg)
    moving, jogging = (
        np.clip((speed - (1 - FADE) * limit) / (2 * FADE * limit), 0.0, 1.0) for limit in (STAND_SPEED, JOG_SPEED)
    )
    none = np.zeros_like(speed)
    return np.stack([1 - moving, moving * (1 - jogging), moving * jogging, none, none, none], axis=-1)
