"""Filters and the median along the time axis, the first of their arrays. SciPy is imported by the filter that needs it.

`scipy.signal` alone takes a second to import, which commands that filter nothing need not pay.
"""

from __future__ import annotations

import numpy as np


def gaussian_filter(values: np.ndarray, sigma: float) -> np.ndarray:
    """Smooths values [T, ...] by a Gaussian of `sigma` frames; beyond the ends the outermost values hold."""
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(values, sigma, axis=0, mode="nearest")


def moving_average(values: np.ndarray, frames: int) -> np.ndarray:
    """Averages values [T, ...] over an odd number of frames around each; beyond the ends the outermost values hold."""
    from scipy.ndimage import uniform_filter1d

    return uniform_filter1d(values, frames, axis=0, mode="nearest")


def moving_minimum(values: np.ndarray, frames: int) -> np.ndarray:
    """Returns the lowest of values [T, ...] in an odd number of frames around each."""
    from scipy.ndimage import minimum_filter1d

    return minimum_filter1d(values, frames, axis=0)


def low_pass(values: np.ndarray, cutoff: float, fps: float) -> np.ndarray:
    """Filters values [T, ...] by a Butterworth low-pass of order 2, run forwards and backwards so that nothing lags.

    Args:
        values: T frames.
        cutoff: Hz.
        fps: frames per second.
    """
    from scipy.signal import butter, sosfiltfilt

    sections = butter(2, cutoff, fs=fps, output="sos")
    return sosfiltfilt(sections, values, axis=0, padlen=min(round(fps / cutoff), len(values) - 1))


def median(values: np.ndarray) -> np.ndarray:
    """Returns the median [...] of finite values [T, ...], T > 0; `np.median` would import `numpy.ma` first."""
    low, high = (len(values) - 1) // 2, len(values) // 2
    ordered = np.partition(values, (low, high), axis=0)
    return (ordered[low] + ordered[high]) / 2
