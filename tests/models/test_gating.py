"""Laws of the gating network, and of networks with one."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.config import NetworkConfig
from pfnn_jax.models.gating import Gating, gate, init_gating
from pfnn_jax.models.network import Dropout, Network, coefficients, config_of, forward, init_network
from pfnn_jax.models.spline import catmull_rom_basis
from tests.models.helpers import normal, predict, random_network, randomise, shapes

FLOAT64 = 1e-12  # a softmax over a few small layers in double precision
FLOAT32 = 1e-6  # the same in single precision

LIMBS, WIDTH, EXPERTS = 3, 6, 5
KEY = jax.random.key(11)


def small_gating() -> Gating:
    return randomise(jax.eval_shape(lambda: init_gating(LIMBS, WIDTH, EXPERTS, key=KEY)), 1)


def phase(seed: int = 2) -> jax.Array:
    return normal(seed, LIMBS)


def with_logits(gating: Gating, logits: jax.Array) -> Gating:
    """Returns the gating network with the given logits for any input."""
    last = jax.tree.map(jnp.zeros_like, gating.layers[2])
    return Gating(layers=(*gating.layers[:2], replace(last, biases=logits)))


def small_network(experts: int = EXPERTS) -> Network:
    config = NetworkConfig(4, 3, 6, experts, phase_size=LIMBS, gating_hidden=WIDTH)
    return random_network(config, 3, 0.5)


def test_gate_equals_its_formula(float64: None):
    gating = small_gating()

    def dense(index: int, value: np.ndarray) -> np.ndarray:
        return value @ np.asarray(gating.layers[index].weights) + np.asarray(gating.layers[index].biases)

    def elu(value: np.ndarray) -> np.ndarray:
        return np.where(value > 0, value, np.exp(value) - 1)

    logits = dense(2, elu(dense(1, elu(dense(0, np.asarray(phase()))))))
    np.testing.assert_allclose(gate(gating, phase()), np.exp(logits) / np.exp(logits).sum(), atol=FLOAT64)


def test_coefficients_are_positive_with_sum_one():
    rows = jax.vmap(gate, (None, 0))(small_gating(), 3 * normal(11, 50, LIMBS))
    assert (rows >= 0).all()
    np.testing.assert_allclose(rows.sum(axis=1), 1, atol=FLOAT32)


def test_equal_logits_give_equal_coefficients():
    gating = with_logits(small_gating(), jnp.full(EXPERTS, 7.0))
    np.testing.assert_allclose(gate(gating, phase()), np.full(EXPERTS, 1 / EXPERTS), atol=FLOAT32)


@pytest.mark.parametrize("expert", [0, EXPERTS - 1])
def test_extreme_logits_choose_one_expert(expert: int):
    """The network is then that expert's ordinary perceptron, and gradients are finite."""
    network = small_network()
    gating = network.gating
    assert gating is not None
    chosen = replace(network, gating=with_logits(gating, 1e6 * jnp.eye(EXPERTS)[expert]))
    np.testing.assert_array_equal(coefficients(chosen, phase()), np.eye(EXPERTS)[expert])
    alone = Network(layers=jax.tree.map(lambda leaf: leaf[expert : expert + 1], network.layers))
    x = jnp.linspace(-1.0, 1.0, 4)
    expected = forward(alone, None, jnp.ones(1), x)
    np.testing.assert_allclose(predict(chosen, None, x, phase()), expected, atol=FLOAT32)
    gradient = jax.jit(jax.grad(lambda n: predict(n, None, x, phase()).sum()))(chosen)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def test_gradients(float64: None):
    check_grads(jax.jit(gate), (small_gating(), phase()), order=2, modes=("fwd", "rev"))


def test_gradients_of_predict(float64: None):
    x = normal(11, 4)
    arguments = (small_network(), None, x, phase())
    check_grads(jax.jit(predict), arguments, order=1, modes=("fwd", "rev"))


def test_gradients_with_dropout(float64: None):
    rates = Dropout(main=jnp.asarray(0.3), adapter=jnp.asarray(0.0))
    x = normal(11, 4)

    def dropped(network, x, phase):
        return forward(network, None, coefficients(network, phase, dropout=rates, key=KEY), x, dropout=rates, key=KEY)

    check_grads(jax.jit(dropped), (small_network(), x, phase()), order=1, modes=("fwd", "rev"))


def test_rate_zero_is_the_identity():
    kept = gate(small_gating(), phase(), dropout=jnp.asarray(0.0), key=KEY)
    np.testing.assert_array_equal(kept, gate(small_gating(), phase()))


def test_dropout_rate_one_leaves_the_last_biases():
    gating = small_gating()
    dropped = gate(gating, phase(), dropout=jnp.asarray(1.0), key=KEY)
    np.testing.assert_allclose(dropped, jax.nn.softmax(gating.layers[2].biases), atol=FLOAT32)


def test_dropout_acts_on_the_gating_input():
    """If the layers only add, the coefficients of a single input take two values: kept, or dropped."""
    keys = jax.random.split(KEY, 64)
    gating = init_gating(1, 64, 2, key=KEY)
    wide = jax.vmap(lambda key: gate(gating, jnp.ones(1), dropout=jnp.asarray(0.5), key=key))(keys)
    np.testing.assert_allclose(wide.sum(axis=1), 1, atol=FLOAT32)
    assert (wide == 0.5).all(axis=1).any()  # biases are zero: a dropped input leaves equal logits
    assert (wide != 0.5).any()


def test_masks_of_gating_and_of_layers_are_independent():
    """`coefficients` and `forward` may be given the same key: they draw different masks from it."""
    ours = np.asarray(jax.random.key_data(jax.random.fold_in(KEY, 4)))
    theirs = np.asarray(jax.random.key_data(jax.random.split(KEY, 4)))
    assert not (ours == theirs).all(axis=-1).any()


def test_dropout_needs_a_key():
    with pytest.raises(ValueError, match="`key` is needed where `dropout` is given, got None"):
        gate(small_gating(), phase(), dropout=jnp.asarray(0.3))
    with pytest.raises(ValueError, match="`key` is needed where `dropout` is given, got None"):
        coefficients(small_network(), phase(), dropout=Dropout(main=jnp.asarray(0.3), adapter=jnp.asarray(0.3)))


def test_a_batch_of_phases_needs_vmap():
    with pytest.raises(AssertionError):
        gate(small_gating(), jnp.zeros((2, LIMBS)))


def test_without_gating_the_coefficients_are_the_spline():
    network = init_network(NetworkConfig(4, 3, 6, 5), key=KEY)
    np.testing.assert_array_equal(coefficients(network, jnp.asarray(1.0)), catmull_rom_basis(jnp.asarray(1.0), 5))


def test_parameter_tree_and_initial_weights():
    """Uniform in ± sqrt(6 / (inputs + outputs)), unlike the blended layers; biases zero."""
    gating = init_gating(8, 32, 8, key=KEY)
    assert shapes(gating) == {
        ".layers[0].weights": ((8, 32), "float32"),
        ".layers[0].biases": ((32,), "float32"),
        ".layers[1].weights": ((32, 32), "float32"),
        ".layers[1].biases": ((32,), "float32"),
        ".layers[2].weights": ((32, 8), "float32"),
        ".layers[2].biases": ((8,), "float32"),
    }
    for layer in gating.layers:
        bound = np.sqrt(6 / sum(layer.weights.shape))
        assert 0.9 * bound < np.abs(layer.weights).max() <= bound
        assert (layer.biases == 0).all()


def test_the_layers_of_a_network_do_not_depend_on_its_gating():
    gated, spline = (init_network(NetworkConfig(4, 3, 6, 5, phase_size=size), key=KEY) for size in (LIMBS, 0))
    assert jax.tree.all(jax.tree.map(lambda a, b: bool((a == b).all()), gated.layers, spline.layers))


@pytest.mark.parametrize("experts", [1, 2, 8])
@pytest.mark.parametrize("rank", [None, 2])
def test_config_is_read_from_the_parameters(experts: int, rank: int | None):
    config = NetworkConfig(4, 3, 6, experts, rank, phase_size=2, gating_hidden=7)
    network = jax.eval_shape(lambda: init_network(config, key=KEY))
    assert config_of(network) == config
    assert network.num_control_points == experts


def test_messages_of_the_config():
    with pytest.raises(ValueError, match=r"NetworkConfig.num_control_points must be at least 1, got 0\."):
        NetworkConfig(5, 7, num_control_points=0, phase_size=8)
    with pytest.raises(ValueError, match=r"NetworkConfig.phase_size must be at least 0, got -1\."):
        NetworkConfig(5, 7, phase_size=-1)
    with pytest.raises(ValueError, match=r"NetworkConfig.gating_hidden must be at least 1, got 0\."):
        NetworkConfig(5, 7, phase_size=8, gating_hidden=0)
