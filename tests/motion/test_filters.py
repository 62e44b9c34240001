"""Filters along the time axis."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.motion.filters import median


@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_the_median_is_that_of_numpy(count):
    values = np.random.default_rng(count).normal(size=(count, 3, 2))
    np.testing.assert_array_equal(median(values), np.median(values, axis=0))
    assert float(median(values[:, 0, 0])) == np.median(values[:, 0, 0])
