"""Angles between the heading that is commanded and the one that is walked, in NumPy on plain arrays.

A heading is the direction of the step from one frame to the next. Commanded headings are [T, 2], positions of the root
[T, 2], in metres; a command of zero, to stand, has no heading.
"""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.ground import angle_between

MOVING = 1e-6
"""Length below which a commanded velocity is the command to stand."""

SAME_HEADING = 1.0
"""Largest difference in degrees between the commanded headings of two frames that does not count as a change."""


def published_trajectory_error(commanded: np.ndarray, root: np.ndarray) -> float:
    """Returns CAMDM's trajectory error in degrees: |mean(commanded angle - walked angle)|, both in (-180, 180].

    The mean is of signed differences, so that errors to the left and to the right cancel, and the differences are not
    wrapped: where a character is commanded to walk along +X, at the cut of the angle, one that walks there with any
    sway is off by 0 or by 360 degrees. The command to stand counts as one to walk along -X. `heading_errors` has none
    of this.

    Args:
        commanded: [T, 2] (x, z) of any length.
        root: [T, 2] metres, positions of the hips.

    Source: code of CAMDM (Chen et al. 2024), `traj_error` of its evaluation, in the coordinates of this package.
    """
    steps = np.diff(root, axis=0)
    # Adding 0 makes a zero positive, as it is in the file: the angle of (-0, 0) is 180 degrees, that of (0, 0) is 0.
    angles = [np.rad2deg(np.arctan2(v[:, 1] + 0.0, 0.0 - v[:, 0])) for v in (commanded[: len(steps)], steps)]
    return float(abs(np.mean(angles[0] - angles[1])))


def heading_errors(commanded: np.ndarray, root: np.ndarray, lag: int = 0) -> np.ndarray:
    """Returns the absolute angle [T - 1] in degrees, at most 180, between the commanded heading and the walked one.

    Args:
        commanded: [T, 2] (x, z) of any length.
        root: [T, 2] metres.
        lag: frames after which a command is compared with what is walked.

    Returns:
        NaN for commands to stand, and for those of the last `lag` frames.
    """
    steps = np.diff(root, axis=0)
    steps = np.concatenate([steps[lag:], np.full((min(lag, len(steps)), 2), np.nan)])
    return angle_errors(commanded[: len(steps)], steps)


def angle_errors(commanded: np.ndarray, reached: np.ndarray) -> np.ndarray:
    """Returns the absolute angles [T] in degrees between two directions [T, 2]; NaN for commands to stand."""
    errors = np.abs(np.rad2deg(angle_between(commanded, reached)))
    return np.where(is_travel(commanded), errors, np.nan)


def is_travel(commanded: np.ndarray) -> np.ndarray:
    """Returns whether [T] commands [T, 2] are to move, not to stand."""
    return np.linalg.norm(commanded, axis=-1) > MOVING


def find_lag(commanded: np.ndarray, root: np.ndarray, longest: int) -> int:
    """Returns the lag in frames, from 0 to `longest`, for which the mean of `heading_errors` is least.

    Lags of more than half of the frames, of which too few would be left, are not tried.
    """
    lags = range(min(longest, len(root) // 2) + 1)
    return int(np.argmin([mean_of_numbers(heading_errors(commanded, root, lag)) for lag in lags]))


def seconds_since_change(commanded: np.ndarray, fps: float) -> np.ndarray:
    """Returns the time [T] in seconds since the commanded heading changed, or the walk began; NaN for standing.

    Args:
        commanded: [T, 2] (x, z) of any length.
        fps: frames per second.
    """
    moving, frames = is_travel(commanded), np.arange(len(commanded))
    same = np.abs(np.rad2deg(angle_between(commanded[:-1], commanded[1:]))) <= SAME_HEADING
    changed = np.concatenate([[True], ~(same & moving[:-1] & moving[1:])])
    since = frames - np.maximum.accumulate(np.where(changed, frames, 0))
    return np.where(moving, since / fps, np.nan)


def mean_of_numbers(values: np.ndarray) -> float:
    """Returns the mean of those values that are not NaN; NaN if there are none."""
    values = values[~np.isnan(values)]
    return float(values.mean()) if len(values) else float("nan")
