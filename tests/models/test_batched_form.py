"""Laws of products that are computed in one way for a frame and in another for a batch."""

from __future__ import annotations

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.style import Layer, init_bank

FLOAT32 = 1e-5  # a few ulp over sums of some tens of products in another order
POINTS, INPUTS, OUTPUTS, BATCH, STYLES, RANK = 4, 9, 7, 11, 3, 2
SIZES = NetworkConfig(INPUTS, OUTPUTS, hidden=13)


def normal(seed, *shape):
    return jax.random.normal(jax.random.key(seed), shape)


def layer():
    return BlendedLayer(weights=normal(0, POINTS, INPUTS, OUTPUTS), biases=normal(1, POINTS, OUTPUTS))


def forward(c, x):
    return layer()(c, x)


def float64(layer, c, x):
    weights, biases, c, x = (np.asarray(a, np.float64) for a in (layer.weights, layer.biases, c, x))
    return np.einsum("k,i,kio->o", c, x, weights) + c @ biases


def bank(kind):
    return init_bank(AdapterConfig(kind, RANK), SIZES, STYLES, key=jax.random.key(2))


def mixture(kind):
    def mixed(weights, c, x):
        style = bank(kind).mix_dynamic(weights)
        assert isinstance(style, Layer)
        return style(c, x)

    return mixed


def test_one_frame_and_a_batch_are_the_float64_product():
    c, x = normal(3, BATCH, POINTS), normal(4, BATCH, INPUTS)
    expected = np.stack([float64(layer(), *row) for row in zip(c, x, strict=True)])
    one = jnp.stack([jax.jit(forward)(*row) for row in zip(c, x, strict=True)])
    np.testing.assert_allclose(one, expected, rtol=FLOAT32, atol=FLOAT32)
    np.testing.assert_allclose(jax.jit(jax.vmap(forward))(c, x), expected, rtol=FLOAT32, atol=FLOAT32)


def test_a_batch_of_one_is_computed_as_one_frame():
    c, x = normal(3, POINTS), normal(4, INPUTS)
    np.testing.assert_array_equal(jax.jit(jax.vmap(forward))(c[None], x[None])[0], jax.jit(forward)(c, x))
    np.testing.assert_array_equal(jax.jit(jax.vmap(forward, (None, 0)))(c, x[None])[0], jax.jit(forward)(c, x))


def test_derivatives_of_one_frame_are_those_of_the_batch():
    c, x = normal(3, POINTS), normal(4, INPUTS)

    def size(layer, c, x):
        return jnp.sum(jnp.sin(layer(c, x)))

    def size_of_batch(layer, c, x):
        return jnp.sum(jnp.sin(jax.vmap(layer)(c[None], x[None])))

    one, many = (jax.grad(f, argnums=(0, 1, 2))(layer(), c, x) for f in (size, size_of_batch))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=FLOAT32, atol=FLOAT32), one, many)


def test_batch_is_one_product_over_all_experts():
    program = jax.jit(jax.vmap(forward)).lower(normal(3, BATCH, POINTS), normal(4, BATCH, INPUTS)).as_text()
    products = [line for line in program.splitlines() if "dot_general" in line]
    assert len(products) == 2  # the flattened weights, and the biases
    assert any(f"tensor<{BATCH}x{POINTS * INPUTS}xf32>, tensor<{POINTS * INPUTS}x{OUTPUTS}xf32>" in p for p in products)


@pytest.mark.parametrize("kind", ["cp", "full"])
def test_mixture_for_a_batch_equals_mixtures_one_by_one(kind):
    c, x, weights = normal(3, BATCH, POINTS), normal(4, BATCH, SIZES.hidden), normal(5, BATCH, STYLES)
    weights = weights.at[::2, 1].set(0.0)

    mixed = mixture(kind)
    one = jnp.stack([mixed(*row) for row in zip(weights, c, x, strict=True)])
    np.testing.assert_allclose(jax.vmap(mixed)(weights, c, x), one, rtol=FLOAT32, atol=FLOAT32)


@pytest.mark.parametrize("kind", ["cp", "full"])
def test_mixture_for_a_batch_builds_no_matrix_for_a_sample(kind):
    args = normal(5, BATCH, STYLES), normal(3, BATCH, POINTS), normal(4, BATCH, SIZES.hidden)
    program = jax.jit(jax.vmap(mixture(kind))).lower(*args).as_text()
    sizes = [
        [int(size) for size in shape.split("x")[:-1]]
        for shape in program.replace(">", "<").split("<")
        if shape.startswith(f"{BATCH}x")
    ]
    largest = BATCH * SIZES.hidden * (POINTS if kind == "full" else 1)
    assert sizes and max(math.prod(size) for size in sizes) <= largest


@pytest.mark.parametrize("kind", ["cp", "full"])
def test_derivatives_of_a_mixture_are_those_of_the_weighted_sum(kind, float64: None):
    """Also by the weight of a style that is left out, whose layer is not read."""
    c, x, weights = normal(3, POINTS), normal(4, SIZES.hidden), jnp.array([0.7, 0.0, 0.3])

    def size(mixed, *args):
        return jnp.sum(jnp.sin(mixed(*args)))

    def weighted_sum(weights, c, x):
        return jnp.einsum("s,so->o", weights, jax.vmap(lambda style: style(c, x))(bank(kind)))

    found, expected = (
        jax.grad(partial(size, f), argnums=(0, 1, 2))(weights, c, x) for f in (mixture(kind), weighted_sum)
    )
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=FLOAT32, atol=FLOAT32), found, expected)
    assert np.asarray(found[0])[1] != 0.0
    check_grads(mixture(kind), (weights, c, x), order=1, modes=["rev"])
