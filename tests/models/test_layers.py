"""Laws of the blended layers: each equals the formula it stands for, written the slow way."""

from __future__ import annotations

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.layers import (
    BiasLayer,
    BlendedLayer,
    CPLayer,
    DenseLayer,
    DiagonalLayer,
    Layer,
    init_bias,
    init_blended,
    init_cp,
    init_dense,
    init_diagonal,
    linear,
)
from tests.models.helpers import KINDS, random_layer, shapes

FLOAT64 = 1e-12  # sums of a few dozen terms of size one in double precision

POINTS, SIZE, RANK, BATCH = 5, 6, 3, 4


def coefficients(seed: int = 7) -> jax.Array:
    return jax.random.normal(jax.random.key(seed), (POINTS,))


def inputs(seed: int = 8) -> jax.Array:
    return jax.random.normal(jax.random.key(seed), (SIZE,))


def test_blended_layer_is_the_network_with_blended_weights(float64: None):
    """The formulation of every published implementation: blend the weights of each sample, then multiply."""
    layer = random_layer("blended", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, BlendedLayer)
    c = jax.random.normal(jax.random.key(1), (BATCH, POINTS))
    x = jax.random.normal(jax.random.key(2), (BATCH, SIZE))
    weights = jnp.einsum("bk,kio->bio", c, layer.weights)
    naive = jnp.einsum("bi,bio->bo", x, weights) + jnp.einsum("bk,ko->bo", c, layer.biases)
    batched = jax.vmap(linear, (None, 0, 0))(layer, c, x)
    np.testing.assert_allclose(batched, naive, atol=FLOAT64)


def test_cp_layer_is_its_factors_multiplied_out(float64: None):
    layer = random_layer("cp", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, CPLayer)
    matrix = layer.a @ jnp.diag(coefficients() @ layer.d) @ layer.b.T
    np.testing.assert_allclose(linear(layer, coefficients(), inputs()), matrix @ inputs() + layer.bias, atol=FLOAT64)


def test_cp_layer_is_the_blended_layer_of_its_tensor(float64: None):
    """A rank-R tensor [K, I, O] blended in full; the CP bias is the same at every phase, so c must sum to one."""
    layer = random_layer("cp", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, CPLayer)
    tensor = jnp.einsum("ir,kr,or->kio", layer.b, layer.d, layer.a)
    full = BlendedLayer(weights=tensor, biases=jnp.tile(layer.bias, (POINTS, 1)))
    c = coefficients() / coefficients().sum()
    np.testing.assert_allclose(linear(layer, c, inputs()), linear(full, c, inputs()), rtol=1e-10)


def test_diagonal_layer_is_a_blended_diagonal_matrix(float64: None):
    layer = random_layer("diagonal", POINTS, SIZE, SIZE, RANK)
    assert isinstance(layer, DiagonalLayer)
    full = BlendedLayer(weights=jax.vmap(jnp.diag)(layer.weights), biases=layer.biases)
    expected = linear(full, coefficients(), inputs())
    np.testing.assert_allclose(linear(layer, coefficients(), inputs()), expected, atol=FLOAT64)


def test_bias_layer_is_a_blended_layer_without_weights(float64: None):
    layer = random_layer("bias", POINTS, SIZE, SIZE, RANK)
    assert isinstance(layer, BiasLayer)
    full = BlendedLayer(weights=jnp.zeros((POINTS, SIZE, SIZE)), biases=layer.biases)
    expected = linear(full, coefficients(), inputs())
    np.testing.assert_allclose(linear(layer, coefficients(), inputs()), expected, atol=FLOAT64)


def test_dense_layer_is_a_blended_layer_of_equal_experts(float64: None):
    """What is the same in every expert is not blended, where the coefficients sum to one."""
    layer = random_layer("dense", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, DenseLayer)
    full = BlendedLayer(weights=jnp.tile(layer.weights, (POINTS, 1, 1)), biases=jnp.tile(layer.biases, (POINTS, 1)))
    c = coefficients() / coefficients().sum()
    np.testing.assert_allclose(linear(layer, c, inputs()), linear(full, c, inputs()), rtol=1e-10)
    np.testing.assert_array_equal(linear(layer, c, inputs()), linear(layer, jnp.zeros(2), inputs()))


@pytest.mark.parametrize("kind", KINDS)
def test_gradients(kind: str, float64: None):
    layer = random_layer(kind, POINTS, SIZE, SIZE, RANK)
    check_grads(linear, (layer, coefficients(), inputs()), order=2, modes=("fwd", "rev"))


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_where_everything_is_zero(kind: str, float64: None):
    layer = jax.tree.map(jnp.zeros_like, random_layer(kind, POINTS, SIZE, SIZE, RANK))
    zeros = jnp.zeros(POINTS), jnp.zeros(SIZE)
    check_grads(linear, (layer, *zeros), order=1, modes=("fwd", "rev"))


@pytest.mark.parametrize("kind", KINDS)
def test_knows_its_number_of_control_points(kind: str):
    layer = random_layer(kind, POINTS, SIZE, SIZE, RANK)
    assert isinstance(layer, DenseLayer) or layer.num_control_points == POINTS


def test_parameter_trees():
    key = jax.random.key(0)
    assert shapes(init_blended(key, 4, 234, 512)) == {
        ".weights": ((4, 234, 512), "float32"),
        ".biases": ((4, 512), "float32"),
    }
    assert shapes(init_cp(key, 4, 234, 512, 30)) == {
        ".a": ((512, 30), "float32"),
        ".b": ((234, 30), "float32"),
        ".d": ((4, 30), "float32"),
        ".bias": ((512,), "float32"),
    }
    assert shapes(init_diagonal(key, 4, 512)) == {
        ".weights": ((4, 512), "float32"),
        ".biases": ((4, 512), "float32"),
    }
    assert shapes(init_dense(key, 512, 342)) == {".weights": ((512, 342), "float32"), ".biases": ((342,), "float32")}
    assert shapes(init_bias(4, 512)) == {".biases": ((4, 512), "float32")}


def test_initial_weights_are_uniform_in_the_bounds_of_the_authors():
    """± sqrt(6 / product of the last two sizes), filled to its edges; a vector counts as a matrix of one row."""
    key = jax.random.key(0)
    cp, diagonal = init_cp(key, 4, 64, 128, 30), init_diagonal(key, 4, 512)
    for weights, fan in (
        (init_blended(key, 4, 64, 128).weights, 64 * 128),
        (cp.a, 128 * 30),
        (cp.b, 30 * 64),
        (cp.d, 30),
        (diagonal.weights, 512),
        (init_dense(key, 64, 128).weights, 64 * 128),
    ):
        bound = np.sqrt(6 / fan)
        assert 0.9 * bound < np.abs(weights).max() <= bound
        assert np.abs(weights.mean()) < 0.2 * bound


def test_layers_of_one_key_are_equal_and_of_two_keys_differ():
    one, again, other = (init_cp(jax.random.key(seed), 4, 8, 8, 3) for seed in (0, 0, 1))
    assert all(jax.tree.leaves(jax.tree.map(lambda a, b: bool((a == b).all()), one, again)))
    assert not (one.a == other.a).any()


def test_sizes_that_do_not_fit_are_refused():
    layer = random_layer("blended", POINTS, SIZE, SIZE, RANK)
    with pytest.raises(AssertionError):
        linear(layer, coefficients(), jnp.zeros(SIZE + 1))
    with pytest.raises(AssertionError):
        linear(layer, jnp.zeros(POINTS - 1), inputs())
    with pytest.raises(AssertionError):
        linear(layer, coefficients(), jnp.zeros((BATCH, SIZE)))


def test_something_else_than_a_layer_is_refused():
    with pytest.raises(TypeError, match="`layer` must be a BlendedLayer, .* got dict"):
        linear(cast(Layer, cast(Any, {})), coefficients(), inputs())
