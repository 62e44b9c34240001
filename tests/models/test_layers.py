"""Laws of the blended layers: each equals its formula, computed in a direct way."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.layers.bias import BiasLayer
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.layers.diagonal import DiagonalLayer
from pfnn_jax.models.layers.full import BlendedLayer
from tests.models.helpers import LAYER_KINDS, normal, random_layer, shapes

FLOAT64 = 1e-12  # sums of a few dozen terms of size one in double precision

POINTS, SIZE, RANK, BATCH = 5, 6, 3, 4


def coefficients(seed: int = 7) -> jax.Array:
    return normal(seed, POINTS)


def inputs(seed: int = 8) -> jax.Array:
    return normal(seed, SIZE)


def test_blended_layer_is_the_network_with_blended_weights(float64: None):
    """Published implementations blend the weights of each sample, then multiply."""
    layer = random_layer("full", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, BlendedLayer)
    c = normal(1, BATCH, POINTS)
    x = normal(2, BATCH, SIZE)
    weights = jnp.einsum("bk,kio->bio", c, layer.weights)
    naive = jnp.einsum("bi,bio->bo", x, weights) + jnp.einsum("bk,ko->bo", c, layer.biases)
    batched = jax.vmap(layer)(c, x)
    np.testing.assert_allclose(batched, naive, atol=FLOAT64)


def test_cp_layer_is_its_factors_multiplied_out(float64: None):
    layer = random_layer("cp", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, CPLayer)
    matrix = layer.a @ jnp.diag(coefficients() @ layer.d) @ layer.b.T
    np.testing.assert_allclose(layer(coefficients(), inputs()), matrix @ inputs() + layer.bias, atol=FLOAT64)


def test_cp_layer_is_the_blended_layer_of_its_tensor(float64: None):
    """A rank-R tensor [K, I, O] blended in full; the CP bias is the same at every phase, so c must sum to one."""
    layer = random_layer("cp", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, CPLayer)
    tensor = jnp.einsum("ir,kr,or->kio", layer.b, layer.d, layer.a)
    full = BlendedLayer(weights=tensor, biases=jnp.tile(layer.bias, (POINTS, 1)))
    c = coefficients() / coefficients().sum()
    np.testing.assert_allclose(layer(c, inputs()), full(c, inputs()), rtol=1e-10)


def test_diagonal_layer_is_a_blended_diagonal_matrix(float64: None):
    layer = random_layer("diagonal", POINTS, SIZE, SIZE, RANK)
    assert isinstance(layer, DiagonalLayer)
    full = BlendedLayer(weights=jax.vmap(jnp.diag)(layer.weights), biases=layer.biases)
    expected = full(coefficients(), inputs())
    np.testing.assert_allclose(layer(coefficients(), inputs()), expected, atol=FLOAT64)


def test_bias_layer_is_a_blended_layer_without_weights(float64: None):
    layer = random_layer("bias", POINTS, SIZE, SIZE, RANK)
    assert isinstance(layer, BiasLayer)
    full = BlendedLayer(weights=jnp.zeros((POINTS, SIZE, SIZE)), biases=layer.biases)
    expected = full(coefficients(), inputs())
    np.testing.assert_allclose(layer(coefficients(), inputs()), expected, atol=FLOAT64)


def test_dense_layer_is_a_blended_layer_of_equal_experts(float64: None):
    """Blending equal experts changes nothing if the coefficients sum to one."""
    layer = random_layer("dense", POINTS, SIZE, 9, RANK)
    assert isinstance(layer, DenseLayer)
    full = BlendedLayer(weights=jnp.tile(layer.weights, (POINTS, 1, 1)), biases=jnp.tile(layer.biases, (POINTS, 1)))
    c = coefficients() / coefficients().sum()
    np.testing.assert_allclose(layer(c, inputs()), full(c, inputs()), rtol=1e-10)
    np.testing.assert_array_equal(layer(c, inputs()), layer(jnp.zeros(2), inputs()))


@pytest.mark.parametrize("kind", LAYER_KINDS)
def test_gradients(kind: str, float64: None):
    layer = random_layer(kind, POINTS, SIZE, SIZE, RANK)
    check_grads(lambda layer, c, x: layer(c, x), (layer, coefficients(), inputs()), order=2, modes=("fwd", "rev"))


@pytest.mark.parametrize("kind", LAYER_KINDS)
def test_gradients_where_everything_is_zero(kind: str, float64: None):
    layer = jax.tree.map(jnp.zeros_like, random_layer(kind, POINTS, SIZE, SIZE, RANK))
    zeros = jnp.zeros(POINTS), jnp.zeros(SIZE)
    check_grads(lambda layer, c, x: layer(c, x), (layer, *zeros), order=1, modes=("fwd", "rev"))


def test_parameter_trees():
    key = jax.random.key(0)
    assert shapes(BlendedLayer.init(234, 512, 4, key=key)) == {
        ".weights": ((4, 234, 512), "float32"),
        ".biases": ((4, 512), "float32"),
    }
    assert shapes(CPLayer.init(234, 512, 4, rank=30, key=key)) == {
        ".a": ((512, 30), "float32"),
        ".b": ((234, 30), "float32"),
        ".d": ((4, 30), "float32"),
        ".bias": ((512,), "float32"),
    }
    assert shapes(DiagonalLayer.init(512, 512, 4, key=key)) == {
        ".weights": ((4, 512), "float32"),
        ".biases": ((4, 512), "float32"),
    }
    assert shapes(DenseLayer.init(512, 342, 4, key=key)) == {
        ".weights": ((512, 342), "float32"),
        ".biases": ((342,), "float32"),
    }
    assert shapes(BiasLayer.init(512, 512, 4, key=key)) == {".biases": ((4, 512), "float32")}


def test_initial_weights_are_uniform_in_the_bounds_of_the_authors():
    """± sqrt(6 / product of the last two sizes), reached nearly; a vector counts as a matrix of one row."""
    key = jax.random.key(0)
    cp, diagonal = CPLayer.init(64, 128, 4, rank=30, key=key), DiagonalLayer.init(512, 512, 4, key=key)
    for weights, fan in (
        (BlendedLayer.init(64, 128, 4, key=key).weights, 64 * 128),
        (cp.a, 128 * 30),
        (cp.b, 30 * 64),
        (cp.d, 30),
        (diagonal.weights, 512),
        (DenseLayer.init(64, 128, 4, key=key).weights, 64 * 128),
    ):
        bound = np.sqrt(6 / fan)
        assert 0.9 * bound < np.abs(weights).max() <= bound
        assert np.abs(weights.mean()) < 0.2 * bound


def test_layers_of_one_key_are_equal_and_of_two_keys_differ():
    one, again, other = (CPLayer.init(8, 8, 4, rank=3, key=jax.random.key(seed)) for seed in (0, 0, 1))
    assert all(jax.tree.leaves(jax.tree.map(lambda a, b: bool((a == b).all()), one, again)))
    assert not (one.a == other.a).any()


def test_sizes_that_do_not_fit_are_refused():
    layer = random_layer("full", POINTS, SIZE, SIZE, RANK)
    with pytest.raises(AssertionError):
        layer(coefficients(), jnp.zeros(SIZE + 1))
    with pytest.raises(AssertionError):
        layer(jnp.zeros(POINTS - 1), inputs())
    with pytest.raises(AssertionError):
        layer(coefficients(), jnp.zeros((BATCH, SIZE)))
