"""Smooth interpolation between frames: cubic splines, whose acceleration is continuous."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.kinematics import quat_align, quat_normalise

REACH = 16
"""Frames after which a cubic spline no longer shows how it went on: their share in it is below 1e-8."""


def interpolate(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Returns values [T, ...] at other times [N] by cubic spline; at whole frames they are the given ones.

    Where linear interpolation to a higher frame rate would kink at every frame, and jerk, this does not. At the first
    and last frame the velocity is that of the values, and the acceleration zero.

    Args:
        values: T frames.
        times: frames, in [0, T - 1].
    """
    from scipy.ndimage import spline_filter1d

    whole = np.rint(times).astype(int)
    if len(values) < 2 or np.abs(times - whole).max() < 1e-6:
        return values[whole]
    ends = ((REACH, REACH),) + ((0, 0),) * (values.ndim - 1)
    knots = spline_filter1d(np.pad(values, ends, "reflect", reflect_type="odd"), order=3, axis=0, mode="mirror")
    before = np.minimum(times.astype(int), len(values) - 2)
    s = (times - before).reshape((-1,) + (1,) * (values.ndim - 1))
    weights = (1 - s) ** 3, 3 * s**3 - 6 * s**2 + 4, -3 * s**3 + 3 * s**2 + 3 * s + 1, s**3
    last = len(knots) - 1
    taps = (last - np.abs(last - np.abs(before + REACH + shift)) for shift in (-1, 0, 1, 2))
    return np.sum([weight / 6 * knots[tap] for weight, tap in zip(weights, taps, strict=True)], axis=0)


def interpolate_rotations(rotations: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Returns rotations [T, J, 4] at other times [N], as `interpolate` does; neighbouring frames must be near."""
    return quat_normalise(interpolate(quat_align(rotations), times))
