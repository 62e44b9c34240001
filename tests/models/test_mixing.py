"""Mixtures of layers: the weighted sum of what each adds."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.one_hot import OneHot
from pfnn_jax.models.style import MixedLayer, mix_styles
from tests.models.helpers import LAYER_KINDS, random_layer, randomise

FLOAT64 = 1e-12  # a few small products in double precision
POINTS, HIDDEN, RANK = 4, 7, 2
COEFFICIENTS = np.array([0.1, 0.2, 0.3, 0.4])
X = np.linspace(-1.0, 1.0, HIDDEN)


def bank(kind: str):
    return randomise(
        jax.tree.map(lambda leaf: jnp.zeros((3, *leaf.shape)), random_layer(kind, POINTS, HIDDEN, HIDDEN, RANK)), 9
    )


@pytest.mark.parametrize("kind", LAYER_KINDS)
@pytest.mark.parametrize("weights", [[0.0, 1.0, 0.0], [0.5, 0.2, 0.3], [0.0, 1.5, -0.5]])
def test_a_mixture_is_the_weighted_sum_of_outputs(kind: str, weights: list[float], float64: None):
    layers, shares = bank(kind), jnp.asarray(weights)
    mixed = MixedLayer(layers=layers, weights=shares)(jnp.asarray(COEFFICIENTS), jnp.asarray(X))
    each = jax.vmap(lambda layer: layer(jnp.asarray(COEFFICIENTS), jnp.asarray(X)))(layers)
    np.testing.assert_allclose(mixed, shares @ each, atol=FLOAT64)


@pytest.mark.parametrize("kind", LAYER_KINDS)
@pytest.mark.parametrize("weights", [[0.0, 1.0, 0.0], [0.5, 0.2, 0.3], [0.0, 1.5, -0.5]])
def test_mixed_parameters_say_what_mixed_outputs_say(kind: str, weights: list[float], float64: None):
    layers, shares = bank(kind), jnp.asarray(weights)
    one = mix_styles(layers, shares)
    expected = MixedLayer(layers=layers, weights=shares)(jnp.asarray(COEFFICIENTS), jnp.asarray(X))
    assert type(one) is type(layers)
    np.testing.assert_allclose(one(jnp.asarray(COEFFICIENTS), jnp.asarray(X)), expected, atol=FLOAT64)


def test_ranks_of_mixed_cp_layers_add_up():
    one = mix_styles(bank("cp"), jnp.ones(3))
    assert isinstance(one, CPLayer)
    assert (one.a.shape, one.b.shape, one.d.shape) == ((HIDDEN, 3 * RANK), (HIDDEN, 3 * RANK), (POINTS, 3 * RANK))


def test_shifts_of_the_first_layer_are_mixed_by_parameters(float64: None):
    shifts, weights = bank("bias"), jnp.asarray([0.5, 0.2, 0.3])
    one = mix_styles(OneHot(shift=shifts), weights)
    assert isinstance(one, OneHot)
    np.testing.assert_allclose(one.shift.biases, jnp.tensordot(weights, shifts.biases, 1), atol=FLOAT64)


def test_a_mixture_at_a_vertex_is_that_layer():
    layers = bank("cp")
    coefficients, x = jnp.asarray(COEFFICIENTS, jnp.float32), jnp.asarray(X, jnp.float32)
    for index in range(3):
        mixed = MixedLayer(layers=layers, weights=jnp.eye(3)[index])(coefficients, x)
        alone = jax.tree.map(lambda leaf, i=index: leaf[i], layers)(coefficients, x)
        np.testing.assert_array_equal(mixed, alone)


def test_no_sample_of_a_batch_has_a_matrix_of_its_own():
    layers, batch = bank("full"), 50
    weights, x = jnp.ones((batch, 3)), jnp.ones((batch, HIDDEN))

    def many(layers, weights, x):
        one = lambda w, row: MixedLayer(layers=layers, weights=w)(jnp.ones(POINTS), row)  # noqa: E731
        return jax.vmap(one)(weights, x)

    compiled = jax.jit(many).lower(layers, weights, x).compile().as_text()
    assert compiled is not None and f"f32[{batch},{HIDDEN},{HIDDEN}]" not in compiled
    assert f"f32[{batch},{POINTS},{HIDDEN},{HIDDEN}]" not in compiled
