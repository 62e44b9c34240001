"""Dropout masks: their rate, their independence, and that a mask belongs to one frame."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.models.dropout import drop, random_bytes

KEY = jax.random.key(3)
NUMBER = 200_000
DEVIATIONS = 5  # standard deviations that a measured share may be off
RATE = jnp.float32(0.3)
UNITS = 101  # does not fill its last word of four bytes


@pytest.mark.parametrize("rate", [0.004, 0.3, 0.7])
def test_the_share_dropped_is_the_rate_in_256ths(rate: float):
    rounded = round(rate * 256) / 256
    values = np.asarray(drop(KEY, jnp.float32(rate), jnp.ones(NUMBER)))
    spread = DEVIATIONS * np.sqrt(rounded * (1 - rounded) / NUMBER)
    assert np.mean(values == 0) == pytest.approx(rounded, abs=spread)
    np.testing.assert_allclose(values[values != 0], 1 / (1 - rounded), rtol=1e-6)


@pytest.mark.parametrize("lag", [1, 2, 3, 4, 8])
def test_units_are_dropped_independently(lag: int):
    """Also those whose bytes are cut from one word."""
    kept = np.asarray(drop(KEY, jnp.float32(0.5), jnp.ones(NUMBER))) != 0
    assert np.mean(kept[lag:] & kept[:-lag]) == pytest.approx(0.25, abs=DEVIATIONS * np.sqrt(0.1875 / NUMBER))


def test_bytes_are_uniform():
    counts = np.bincount(np.asarray(random_bytes(KEY, (NUMBER,))), minlength=256)
    expected = NUMBER / 256
    assert np.sum((counts - expected) ** 2 / expected) < 255 + DEVIATIONS * np.sqrt(2 * 255)  # chi-squared


def test_a_mask_belongs_to_its_frame():
    """It is the same in a batch and alone, whatever the other frames are; and no two frames share it."""
    keys, x = jax.random.split(KEY, 8), jnp.ones((8, UNITS))
    together = jax.vmap(drop, in_axes=(0, None, 0))(keys, RATE, x)
    np.testing.assert_array_equal(together[5], drop(keys[5], RATE, x[5]))
    assert len(np.unique(np.asarray(together), axis=0)) == 8


@pytest.mark.parametrize("shape", [(), (1,), (3, 5)])
def test_any_shape_is_drawn(shape):
    assert random_bytes(KEY, shape).shape == shape
