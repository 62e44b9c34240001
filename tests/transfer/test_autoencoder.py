"""The motion autoencoder: Eq. 1 and 2 in loops, the adjoint, shifts in time, and clips that are padded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.convolution import Convolution
from pfnn_jax.transfer.autoencoder import MotionAutoencoder, config_of, init_autoencoder, transposed
from pfnn_jax.transfer.config import AutoencoderConfig

FLOAT64 = 1e-11
"""Sums of a few hundred terms of size one in double precision."""

SIZE, FRAMES = 5, 24
CONFIGS = (AutoencoderConfig(filters=7, width=9), AutoencoderConfig(filters=7, width=9, tied=False))
EACH_FORM = pytest.mark.parametrize("config", CONFIGS, ids=("tied", "untied"))


def make(config: AutoencoderConfig, seed: int = 0) -> MotionAutoencoder:
    """Returns an autoencoder whose biases are not zero."""
    fresh = init_autoencoder(config, SIZE, key=jax.random.key(seed))
    leaves, form = jax.tree.flatten(fresh)
    keys = jax.random.split(jax.random.key(seed + 1), len(leaves))
    return form.unflatten([jax.random.normal(key, leaf.shape) for key, leaf in zip(keys, leaves, strict=True)])


def rows(frames: int = FRAMES, seed: int = 5) -> jax.Array:
    return jax.random.normal(jax.random.key(seed), (frames, SIZE))


def slow_encode(autoencoder: MotionAutoencoder, x: np.ndarray) -> np.ndarray:
    """Computes Eq. 1 with loops: convolution, bias, maximum of two frames, ReLU."""
    filters, bias = np.asarray(autoencoder.encoder.filters), np.asarray(autoencoder.encoder.bias)
    width, half = len(filters), len(filters) // 2
    value = np.zeros((len(x), filters.shape[2]))
    for t in range(len(x)):
        for w in range(width):
            if 0 <= t + w - half < len(x):
                value[t] += x[t + w - half] @ filters[w]
    value += bias
    return np.maximum(np.maximum(value[0::2], value[1::2]), 0)


def slow_decode(autoencoder: MotionAutoencoder, hidden: np.ndarray) -> np.ndarray:
    """Computes Eq. 2 with loops: average depooling, minus b0, and each hidden frame spread by the same filters."""
    encoder, decoder = autoencoder.encoder, autoencoder.decoder
    depooled = np.repeat(hidden / 2, 2, axis=0)
    tied = decoder is None
    filters = np.asarray(encoder.filters if tied else decoder.filters)
    value = depooled - np.asarray(encoder.bias) if tied else depooled
    width, half = len(filters), len(filters) // 2
    y = np.zeros((len(value), SIZE))
    for t in range(len(value)):
        for w in range(width):
            source, target = (t, t + w - half) if tied else (t + w - half, t)
            if 0 <= source < len(value) and 0 <= target < len(value):
                y[target] += value[source] @ (filters[w].T if tied else filters[w])
    return y if tied else y + np.asarray(decoder.bias)


@EACH_FORM
def test_encoding_and_decoding_equal_their_formulas(config: AutoencoderConfig, float64: None):
    autoencoder, x = make(config), rows()
    hidden = autoencoder.encode(x)
    np.testing.assert_allclose(hidden, slow_encode(autoencoder, np.asarray(x)), atol=FLOAT64)
    np.testing.assert_allclose(autoencoder.decode(hidden), slow_decode(autoencoder, np.asarray(hidden)), atol=FLOAT64)
    np.testing.assert_allclose(autoencoder.project(x), autoencoder.decode(hidden), atol=FLOAT64)


def test_tied_decoder_is_the_adjoint_of_the_encoders_convolution(float64: None):
    """<conv(x), depooled h> = <x, decoded h> without biases."""
    autoencoder = make(CONFIGS[0])
    encoder = replace(autoencoder.encoder, bias=jnp.zeros(7))
    autoencoder = MotionAutoencoder(encoder=encoder)
    x, hidden = rows(), jax.random.normal(jax.random.key(8), (FRAMES // 2, 7))
    depooled = jnp.repeat(hidden / 2, 2, axis=0)
    np.testing.assert_allclose(jnp.vdot(encoder(x), depooled), jnp.vdot(x, autoencoder.decode(hidden)), rtol=1e-12)


def test_transposing_filters_twice_is_identity():
    filters = make(CONFIGS[0]).encoder.filters
    np.testing.assert_array_equal(transposed(transposed(filters)), filters)


@EACH_FORM
@pytest.mark.parametrize("shift", [2, 6])
def test_a_shift_by_an_even_number_of_frames_shifts_hidden_units(config: AutoencoderConfig, shift: int, float64: None):
    """Away from the ends, where the zeros beyond them are seen."""
    autoencoder, x = make(config), rows(60)
    later = jnp.roll(x, shift, axis=0)
    near = (config.width // 2 + shift) // 2 + 1
    hidden, moved = autoencoder.encode(x), autoencoder.encode(later)
    inner = slice(near, len(hidden) - near)
    np.testing.assert_allclose(jnp.roll(hidden, shift // 2, axis=0)[inner], moved[inner], atol=FLOAT64)


@EACH_FORM
def test_a_mask_keeps_a_padded_clip_as_it_is_alone(config: AutoencoderConfig, float64: None):
    autoencoder, x = make(config), rows()
    padded = jnp.pad(x, ((0, 16), (0, 0)))
    hidden = autoencoder.encode(padded)
    mask = (jnp.arange(len(hidden)) < FRAMES // 2).astype(hidden.dtype)
    np.testing.assert_allclose(hidden[: FRAMES // 2], autoencoder.encode(x), atol=FLOAT64)
    np.testing.assert_allclose(autoencoder.decode(hidden, mask)[:FRAMES], autoencoder.project(x), atol=FLOAT64)


@EACH_FORM
def test_many_clips_by_vmap_are_single_clips(config: AutoencoderConfig, float64: None):
    autoencoder, x = make(config), jnp.stack([rows(seed=1), rows(seed=2)])
    each = jnp.stack([autoencoder.project(clip) for clip in x])
    np.testing.assert_allclose(jax.vmap(autoencoder.project)(x), each, atol=FLOAT64)


@EACH_FORM
def test_gradients_are_those_of_finite_differences(config: AutoencoderConfig, float64: None):
    # Far from the kinks of ReLU and pooling, where finite differences would be wrong.
    small = replace(config, filters=3, width=3)
    autoencoder, x = make(small), rows(6)
    check_grads(lambda params, x: params.project(x), (autoencoder, x), order=1, modes=("fwd", "rev"), eps=1e-6)


@EACH_FORM
def test_sizes_are_read_from_the_parameters(config: AutoencoderConfig):
    assert config_of(make(config)) == config


def test_size_of_the_papers_autoencoder():
    """256 filters of 66 numbers and 25 frames, and 256 biases (Holden 2017, Loss Network)."""
    paper = jax.eval_shape(lambda: init_autoencoder(AutoencoderConfig(), 66, key=jax.random.key(0)))
    assert [leaf.shape for leaf in jax.tree.leaves(paper)] == [(25, 66, 256), (256,)]


def test_odd_clips_and_rows_of_another_width_are_refused():
    autoencoder = make(CONFIGS[0])
    for shape in ((FRAMES + 1, SIZE), (FRAMES, SIZE + 1)):
        with pytest.raises(AssertionError):
            autoencoder.encode(jnp.zeros(shape))


@pytest.mark.parametrize("wrong", [{"filters": 0}, {"width": 0}, {"width": 24}])
def test_impossible_sizes_are_refused(wrong: dict[str, Any]):
    with pytest.raises(ValueError, match=f"AutoencoderConfig.{next(iter(wrong))} must"):
        AutoencoderConfig(**wrong)


def test_a_convolution_starts_without_bias():
    assert not np.any(Convolution.init(5, 3, 4, key=jax.random.key(0)).bias)
