"""The share of the distance between two anchors that a method closes, with its bootstrap interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

RESAMPLES = 2000
"""Bootstrap samples of an interval."""


@dataclass(frozen=True)
class Share:
    """A share with its interval.

    Attributes:
        share: the estimate.
        low, high: 95 % interval by bootstrap.
    """

    share: float
    low: float
    high: float


def share_closed(
    none: Mapping[str, np.ndarray],
    full: Mapping[str, np.ndarray],
    method: Mapping[str, np.ndarray],
    *,
    seed: int = 0,
) -> Share:
    """Returns the share of the distance between two anchors that a method closes: 0 for `none`, 1 for `full`.

    Distances are averaged over seeds and takes of each style, then over styles. The bootstrap draws takes within styles
    and, independently, seeds; the same for the three, which are thus compared on the same takes.

    Args:
        none, full, method: by style, distances [takes] or [seeds, takes], of the same shapes.
        seed: of the draws.

    Raises:
        ValueError: if styles or shapes differ.
    """
    stacked = _stacked(none, full, method)
    rng = np.random.default_rng(seed)
    drawn = np.zeros((3, RESAMPLES))
    for values in stacked:  # [3, seeds, takes]
        seeds, takes = (rng.integers(count, size=(RESAMPLES, count)) for count in values.shape[1:])
        drawn += values[:, seeds[:, :, None], takes[:, None, :]].mean(axis=(2, 3)) / len(stacked)
    means = np.mean([values.mean(axis=(1, 2)) for values in stacked], axis=0)
    low, high = np.quantile(_closed(*drawn), [0.025, 0.975])
    return Share(float(_closed(*means)), float(low), float(high))


def _closed(none: np.ndarray, full: np.ndarray, method: np.ndarray) -> np.ndarray:
    return (none - method) / (none - full)


def _stacked(*methods: Mapping[str, np.ndarray]) -> list[np.ndarray]:
    """Returns the distances [methods, seeds, takes] of every style."""
    if any(set(method) != set(methods[0]) for method in methods) or not methods[0]:
        raise ValueError(f"all three must have the same styles, got {[sorted(method) for method in methods]}.")
    stacked = []
    for style in sorted(methods[0]):
        values = [np.atleast_2d(np.asarray(method[style], float)) for method in methods]
        if len({value.shape for value in values}) > 1:
            raise ValueError(f"{style}: all three must have one shape, got {[value.shape for value in values]}.")
        stacked.append(np.stack(values))
    return stacked
