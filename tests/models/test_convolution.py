"""Convolutions over time against loops, pooling and depooling, and their gradients."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.convolution import (
    Convolution,
    average_depool,
    convolve,
    convolve_repeated,
    max_pool,
)
from tests.models.helpers import normal

FLOAT64 = 1e-12
"""Sums of a hundred terms of size one in double precision."""

WIDTHS = (1, 2, 3, 4, 5, 25)
ODD = tuple(width for width in WIDTHS if width % 2)


def random(seed: int, *shape: int) -> jax.Array:
    return normal(seed, *shape)


def slow_convolution(frames: np.ndarray, filters: np.ndarray, before: int) -> np.ndarray:
    """Computes each frame by a loop over taps, with zeros beyond the ends."""
    value = np.zeros((len(frames), filters.shape[2]))
    for t in range(len(frames)):
        for w in range(len(filters)):
            if 0 <= t + w - before < len(frames):
                value[t] += frames[t + w - before] @ filters[w]
    return value


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("num_frames", [1, 2, 7, 40])
def test_convolution_equals_loops_over_frames_and_taps(width: int, num_frames: int, float64: None):
    frames, filters, bias = random(0, num_frames, 3), random(1, width, 3, 4), random(2, 4)
    expected = slow_convolution(np.asarray(frames), np.asarray(filters), width // 2)
    np.testing.assert_allclose(convolve(frames, filters), expected, atol=FLOAT64)
    layer = Convolution(filters=filters, bias=bias)
    np.testing.assert_allclose(layer(frames), expected + np.asarray(bias), atol=FLOAT64)


@pytest.mark.parametrize("width", WIDTHS)
def test_convolution_equals_that_of_xla(width: int, float64: None):
    frames, filters = random(0, 30, 3), random(1, width, 3, 4)
    layout = ("NWC", "WIO", "NWC")
    padding = [(width // 2, width - 1 - width // 2)]
    expected = jax.lax.conv_general_dilated(frames[None], filters, (1,), padding, dimension_numbers=layout)[0]
    np.testing.assert_allclose(convolve(frames, filters), expected, atol=FLOAT64)


@pytest.mark.parametrize("width", ODD)
def test_convolution_of_repeated_frames_is_that_of_their_repetition(width: int, float64: None):
    frames, filters = random(0, 11, 3), random(1, width, 3, 4)
    repeated = jnp.repeat(frames, 2, axis=0)
    np.testing.assert_allclose(convolve_repeated(frames, filters), convolve(repeated, filters), atol=FLOAT64)


def test_depooling_keeps_the_sum_over_time_and_pooling_halves_it_back(float64: None):
    frames = random(3, 12, 5)
    depooled = average_depool(frames)
    np.testing.assert_allclose(depooled.sum(axis=0), frames.sum(axis=0), atol=FLOAT64)
    np.testing.assert_allclose(max_pool(depooled), frames / 2, atol=FLOAT64)


def test_pooling_takes_the_larger_of_two_frames():
    frames = random(4, 12, 5)
    np.testing.assert_array_equal(max_pool(frames), np.asarray(frames).reshape(6, 2, 5).max(axis=1))


def test_gradients_are_those_of_finite_differences(float64: None):
    frames, filters = random(5, 8, 2), random(6, 5, 2, 3)
    for function in (convolve, convolve_repeated):
        check_grads(jax.jit(function), (frames, filters), order=2, modes=("fwd", "rev"))
