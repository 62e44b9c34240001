"""Means and deviations of rows that are never in memory together: of each take, then merged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Moments:
    """Of some rows of D columns.

    Attributes:
        count: rows.
        mean: [D] float64.
        squares: [D] float64, sum of squared deviations from the mean.
    """

    count: int
    mean: np.ndarray
    squares: np.ndarray

    def merge(self, other: Moments) -> Moments:
        """Of the rows of both (Chan, Golub and LeVeque 1979)."""
        if not self.count or not other.count:
            return other if not self.count else self
        count = self.count + other.count
        step = other.mean - self.mean
        share = other.count / count
        return Moments(
            count, self.mean + share * step, self.squares + other.squares + step * step * (self.count * share)
        )

    def rows(self) -> np.ndarray:
        """[2, D] float64 two rows of the same mean and deviation, to stand for all rows in `fit_normaliser`."""
        std = np.sqrt(self.squares / max(self.count, 1))
        return np.stack([self.mean - std, self.mean + std])


NO_ROWS = Moments(0, np.zeros(1), np.zeros(1))
"""Of no rows, of any number of columns."""


def moments_of(rows: np.ndarray) -> Moments:
    """Of rows [N, D]."""
    values = rows.astype(np.float64)
    mean = values.mean(axis=0) if len(values) else np.zeros(values.shape[1])
    values -= mean
    return Moments(len(values), mean, np.einsum("nd,nd->d", values, values))
