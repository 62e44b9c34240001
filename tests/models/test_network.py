"""The composed forward pass: exact sizes, laws of dropout and adapters, gradients, and batching."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.config import AdapterConfig, AdapterKind, NetworkConfig
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Dropout, Network, coefficients, drop, forward, init_network, num_parameters
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.models.style import Layer, init_style
from tests.models.helpers import (
    LAYER_KINDS,
    array_sizes,
    normal,
    predict,
    random_layer,
    random_network,
    shapes,
)

FLOAT64 = 1e-12  # three small layers in double precision
# The mean of n kept-or-dropped numbers at rate r deviates by sqrt(r / (1 - r) / n): five of those, at n = 200,000.
MEAN_OF_DROPOUT = 5 * (1 / 200_000) ** 0.5

SIZES = NetworkConfig(input_size=5, output_size=7, hidden=6)
KEY = jax.random.key(3)


def small_network(seed: int = 0, rank: int | None = None) -> Network:
    """Returns a network with non-zero biases, whose weights are small enough that ELU is not linear."""
    config = NetworkConfig(SIZES.input_size, SIZES.output_size, SIZES.hidden, rank=rank)
    return random_network(config, seed, 0.5)


def adapter_of(kind: str, seed: int = 1) -> Layer:
    return random_layer(kind, 4, SIZES.hidden, SIZES.hidden, 2, seed)


def frame(seed: int = 2) -> tuple[jax.Array, jax.Array]:
    """Returns (coefficients [K], x [I])."""
    return catmull_rom_basis(jnp.asarray(1.1)), normal(seed, SIZES.input_size)


def rates(main: float, adapter: float) -> Dropout:
    return Dropout(main=jnp.asarray(main), adapter=jnp.asarray(adapter))


def test_size_of_the_papers_network():
    network = init_network(NetworkConfig(234, 400), key=KEY)
    assert num_parameters(network) == 2_352_704
    assert shapes(network) == {
        ".layers[0].weights": ((4, 234, 512), "float32"),
        ".layers[0].biases": ((4, 512), "float32"),
        ".layers[1].weights": ((4, 512, 512), "float32"),
        ".layers[1].biases": ((4, 512), "float32"),
        ".layers[2].weights": ((4, 512, 400), "float32"),
        ".layers[2].biases": ((4, 400), "float32"),
    }


def test_size_of_the_decomposed_network():
    """Every layer as a CP decomposition (mentioned in Mason 2018 §7.1)."""
    network = init_network(NetworkConfig(234, 400, rank=30), key=KEY)
    assert shapes(network) == {
        ".layers[0].a": ((512, 30), "float32"),
        ".layers[0].b": ((234, 30), "float32"),
        ".layers[0].d": ((4, 30), "float32"),
        ".layers[0].bias": ((512,), "float32"),
        ".layers[1].a": ((512, 30), "float32"),
        ".layers[1].b": ((512, 30), "float32"),
        ".layers[1].d": ((4, 30), "float32"),
        ".layers[1].bias": ((512,), "float32"),
        ".layers[2].a": ((400, 30), "float32"),
        ".layers[2].b": ((512, 30), "float32"),
        ".layers[2].d": ((4, 30), "float32"),
        ".layers[2].bias": ((400,), "float32"),
    }
    assert num_parameters(network) == 82_244


def test_forward_is_equation_4(float64: None):
    """ELU(W0 x + b0), then the second layer plus the adapter, then the third (Mason 2018 Eq. 4), with loops."""
    network, adapter = small_network(), adapter_of("full")
    coefficients, x = frame()

    def blended(layer: Layer, value: np.ndarray) -> np.ndarray:
        assert isinstance(layer, BlendedLayer)
        weights = sum(float(c) * np.asarray(w) for c, w in zip(coefficients, layer.weights, strict=True))
        biases = sum(float(c) * np.asarray(b) for c, b in zip(coefficients, layer.biases, strict=True))
        return value @ weights + biases

    def elu(value: np.ndarray) -> np.ndarray:
        return np.where(value > 0, value, np.exp(value) - 1)

    first = elu(blended(network.layers[0], np.asarray(x)))
    second = elu(blended(network.layers[1], first) + blended(adapter, first))
    expected = blended(network.layers[2], second)
    np.testing.assert_allclose(forward(network, adapter, coefficients, x), expected, atol=FLOAT64)


def test_predict_is_forward_on_the_spline(float64: None):
    network, adapter = small_network(), adapter_of("cp")
    _, x = frame()
    phase = jnp.asarray(4.0)
    expected = forward(network, adapter, catmull_rom_basis(phase), x)
    np.testing.assert_array_equal(predict(network, adapter, x, phase), expected)


@pytest.mark.parametrize("kind", LAYER_KINDS)
def test_a_zero_adapter_gives_style_agnostic_motion(kind: str):
    network, (coefficients, x) = small_network(), frame()
    zero = jax.tree.map(jnp.zeros_like, adapter_of(kind))
    without = forward(network, None, coefficients, x)
    np.testing.assert_array_equal(forward(network, zero, coefficients, x), without)
    assert (forward(network, adapter_of(kind), coefficients, x) != without).all()


@pytest.mark.parametrize("rank", [None, 2])
@pytest.mark.parametrize("kind", [None, *LAYER_KINDS])
def test_gradients_of_forward(kind: str | None, rank: int | None, float64: None):
    network, adapter = small_network(rank=rank), None if kind is None else adapter_of(kind)
    check_grads(forward, (network, adapter, *frame()), order=1, modes=("fwd", "rev"))


@pytest.mark.parametrize("kind", [None, *LAYER_KINDS])
def test_gradients_of_forward_with_dropout(kind: str | None, float64: None):
    adapter = None if kind is None else adapter_of(kind)

    def dropped(network, adapter, coefficients, x):
        return forward(network, adapter, coefficients, x, dropout=rates(0.3, 0.5), key=KEY)

    check_grads(dropped, (small_network(), adapter, *frame()), order=1, modes=("fwd", "rev"))


@pytest.mark.parametrize("kind", [None, *LAYER_KINDS])
def test_gradients_of_predict(kind: str | None, float64: None):
    adapter = None if kind is None else adapter_of(kind)
    arguments = (small_network(), adapter, frame()[1], jnp.asarray(2.5))
    check_grads(predict, arguments, order=1, modes=("fwd", "rev"))


def test_gradients_near_the_kink_of_elu(float64: None):
    """All activations exactly zero: ELU is differentiable there, and no branch may give NaN."""
    network = jax.tree.map(jnp.zeros_like, small_network())
    check_grads(forward, (network, None, frame()[0], jnp.zeros(5)), order=1, modes=("fwd", "rev"))


def test_gradients_are_finite_for_huge_activations():
    network = jax.tree.map(lambda leaf: 1e4 * leaf, small_network())
    gradient = jax.grad(lambda n: forward(n, None, *frame()).sum())(network)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def test_rate_zero_is_the_identity():
    network, adapter, (coefficients, x) = small_network(), adapter_of("cp"), frame()
    kept = forward(network, adapter, coefficients, x, dropout=rates(0.0, 0.0), key=KEY)
    np.testing.assert_array_equal(kept, forward(network, adapter, coefficients, x))


@pytest.mark.parametrize("rate", [0.1, 0.3, 0.5])
def test_dropout_preserves_the_mean(rate: float):
    values = drop(KEY, jnp.float32(rate), jnp.ones(200_000))
    assert values.mean() == pytest.approx(1.0, abs=MEAN_OF_DROPOUT)
    assert (values == 0).mean() == pytest.approx(rate, abs=MEAN_OF_DROPOUT)


def test_rate_one_drops_everything_with_finite_gradients():
    """The scale of what is kept is infinite there: it must not reach the value or the gradient."""
    value, gradient = jax.value_and_grad(lambda x: drop(KEY, jnp.float32(1.0), x).sum())(jnp.ones(100))
    assert value == 0
    np.testing.assert_array_equal(gradient, np.zeros(100))


def test_gradients_of_drop(float64: None):
    check_grads(lambda x: drop(KEY, jnp.asarray(0.3), x), (frame()[1],), order=2, modes=("fwd", "rev"))


def test_adapter_mask_differs_from_the_layers_masks():
    """Dropping the whole adapter leaves the shared branch untouched, and vice versa."""
    network, adapter, (coefficients, x) = small_network(), adapter_of("cp"), frame()
    assert isinstance(adapter, CPLayer)
    without_bias = replace(adapter, bias=jnp.zeros(SIZES.hidden))
    dropped = forward(network, without_bias, coefficients, x, dropout=rates(0.0, 1.0), key=KEY)
    np.testing.assert_array_equal(dropped, forward(network, None, coefficients, x))
    twice = [forward(network, without_bias, coefficients, x, dropout=rates(main, 0.5), key=KEY) for main in (0.0, 0.5)]
    assert (twice[0] != twice[1]).any()


def test_main_and_adapter_masks_differ():
    """An adapter that undoes the second layer cancels it only where both branches keep the same numbers."""
    network = small_network()
    second = network.layers[1]
    opposite = jax.tree.map(jnp.negative, second)
    coefficients, x = frame()
    cancelled = forward(network, opposite, coefficients, x)
    masked = forward(network, opposite, coefficients, x, dropout=rates(0.5, 0.5), key=KEY)
    third_only = Network(layers=(network.layers[0], jax.tree.map(jnp.zeros_like, second), network.layers[2]))
    np.testing.assert_allclose(cancelled, forward(third_only, None, coefficients, x), atol=1e-6)
    same_masks = forward(third_only, None, coefficients, x, dropout=rates(0.5, 0.5), key=KEY)
    assert not np.allclose(masked, same_masks, atol=1e-3)


def test_dropout_needs_a_key():
    with pytest.raises(ValueError, match="`key` is needed where `dropout` is given, got None"):
        forward(small_network(), None, *frame(), dropout=rates(0.3, 0.3))


def test_messages_of_the_config():
    with pytest.raises(ValueError, match=r"NetworkConfig.hidden must be at least 1, got 0\."):
        NetworkConfig(5, 7, hidden=0)
    with pytest.raises(ValueError, match=r"NetworkConfig.rank must be at least 1, got 0\."):
        NetworkConfig(5, 7, rank=0)
    with pytest.raises(ValueError, match=r"NetworkConfig.num_control_points must be at least 4, got 3\."):
        NetworkConfig(5, 7, num_control_points=3)


def test_integer_phase_equals_float_phase():
    network, (_, x) = small_network(), frame()
    np.testing.assert_array_equal(
        predict(network, None, x, jnp.asarray(2)), predict(network, None, x, jnp.asarray(2.0))
    )


# Primes, so that all products of sizes differ.
BATCH, INPUT, HIDDEN, OUTPUT, POINTS, LIMBS = 101, 31, 37, 41, 5, 3


def batch_of(
    kind: AdapterKind | None, rank: int | None, phase_size: int
) -> tuple[Callable[..., jax.Array], tuple[object, ...]]:
    """Returns the loss of a batch of training frames, and its arguments."""
    config = NetworkConfig(INPUT, OUTPUT, HIDDEN, POINTS, rank=rank, phase_size=phase_size)
    network = init_network(config, key=KEY)
    style = None if kind is None else init_style(AdapterConfig(kind, rank=7), config, key=KEY)
    x, phase = jnp.ones((BATCH, INPUT)), jnp.linspace(0.0, 6.0, BATCH)
    if phase_size:
        phase = jnp.tile(phase[:, None], phase_size)

    def loss(parameters, x, phase, keys):
        def one(x, phase, key):
            network, style = parameters
            blend = coefficients(network, phase, dropout=rates(0.3, 0.3), key=key)
            return forward(network, style, blend, x, dropout=rates(0.3, 0.3), key=key)

        return jnp.mean(jax.vmap(one)(x, phase, keys) ** 2)

    return loss, ((network, style), x, phase, jax.random.split(KEY, BATCH))


def assert_no_matrix_of_a_sample(kind: AdapterKind | None, rank: int | None, phase_size: int) -> None:
    loss, arguments = batch_of(kind, rank, phase_size)
    compiled = jax.jit(jax.value_and_grad(loss)).lower(*arguments)
    smallest = BATCH * min(INPUT * HIDDEN, HIDDEN * HIDDEN, HIDDEN * OUTPUT)
    for text in (compiled.as_text(), compiled.compile().as_text()):
        sizes = array_sizes(str(text))
        assert BATCH * HIDDEN in sizes  # the pattern matches this compiler's text
        assert max(sizes) < smallest, max(sizes)


@pytest.mark.parametrize("rank", [None, 7])
@pytest.mark.parametrize("kind", [None, "full", "cp", "diagonal", "bias"])
def test_no_weight_matrix_of_a_sample_is_ever_built(kind: AdapterKind | None, rank: int | None):
    """Neither forward nor backward holds an array as large as one weight matrix per sample."""
    assert_no_matrix_of_a_sample(kind, rank, 0)


@pytest.mark.parametrize("kind", [None, "dense", "one_hot", "film"])
def test_no_weight_matrix_of_a_sample_is_ever_built_from_experts(kind: AdapterKind | None):
    assert_no_matrix_of_a_sample(kind, None, LIMBS)
