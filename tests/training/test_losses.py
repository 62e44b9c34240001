"""The loss: values by hand, gradients against finite differences."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.training.losses import l1_penalty, squared_error

FLOAT32 = 1e-6  # a few ulp over sums of six terms near one


def test_squared_error_is_the_mean_over_all_axes():
    prediction = jnp.array([[1.0, 2.0], [0.0, -1.0]])
    target = jnp.array([[0.0, 4.0], [0.0, 1.0]])
    assert squared_error(prediction, target) == (1 + 4 + 0 + 4) / 4


def test_squared_error_is_symmetric_and_zero_where_equal():
    first, second = jax.random.normal(jax.random.key(0), (2, 3, 4))
    assert squared_error(first, second) == squared_error(second, first) > 0
    assert squared_error(first, first) == 0


def test_squared_error_refuses_broadcasting():
    with pytest.raises(AssertionError):
        squared_error(jnp.zeros((3, 1)), jnp.zeros((3, 4)))


def test_l1_penalty_averages_within_arrays_and_then_over_arrays():
    tree = {"wide": jnp.array([1.0, -3.0, 2.0, -2.0]), "narrow": jnp.array([[-6.0]])}
    assert l1_penalty(tree) == (8 / 4 + 6) / 2


def test_l1_penalty_sums_where_asked():
    tree = {"wide": jnp.array([1.0, -3.0, 2.0, -2.0]), "narrow": jnp.array([[-6.0]])}
    assert l1_penalty(tree, "sum") == 14


@pytest.mark.parametrize("norm", ["mean", "sum"])
def test_l1_penalty_is_homogeneous(norm):
    tree = [jax.random.normal(jax.random.key(0), (2, 3)), jax.random.normal(jax.random.key(1), (5,))]
    scaled = jax.tree.map(lambda leaf: -3.0 * leaf, tree)
    np.testing.assert_allclose(l1_penalty(scaled, norm), 3.0 * l1_penalty(tree, norm), rtol=FLOAT32)


@pytest.mark.parametrize("norm", ["mean", "sum"])
def test_l1_penalty_does_not_push_a_zero(norm):
    gradient = jax.grad(lambda leaf: l1_penalty([leaf], norm))(jnp.zeros(3))
    assert jnp.all(gradient == 0)


def test_gradient_of_squared_error():
    with jax.enable_x64(True):
        prediction, target = jax.random.normal(jax.random.key(0), (2, 3, 4))
        check_grads(squared_error, (prediction, target), order=2, modes=("fwd", "rev"))


@pytest.mark.parametrize("norm", ["mean", "sum"])
def test_gradient_of_l1_penalty_away_from_zero(norm):
    with jax.enable_x64(True):
        signs = jnp.array([1.0, -1.0, -1.0, 1.0])
        tree = (signs * jnp.linspace(0.5, 2.0, 4), -jnp.ones((2, 2)))
        check_grads(lambda *leaves: l1_penalty(leaves, norm), tree, order=2, modes=("fwd", "rev"))
