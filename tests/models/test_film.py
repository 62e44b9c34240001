"""Laws of FiLM and one-hot styles, and of networks with them."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.models.config import NetworkConfig
from pfnn_jax.models.layers.bias import BiasLayer
from pfnn_jax.models.layers.film import FiLMStyle, layer_norm, layer_norm_sample
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.layers.one_hot import OneHot
from pfnn_jax.models.network import Dropout, Network, forward
from pfnn_jax.models.style import mix_styles
from tests.models.helpers import normal, random_network, randomise

FLOAT64 = 1e-12  # a few small layers in double precision
NO_VARIANCE = 1e-7  # relative effect of 1e-8 inside the root on variances near one

HIDDEN, POINTS, INPUTS = 7, 4, 5
KEY = jax.random.key(21)


def features(seed: int = 1) -> jax.Array:
    return normal(seed, HIDDEN)


def random_film(seed: int = 2) -> FiLMStyle:
    return randomise(FiLMStyle.identity(HIDDEN), seed)


def small_network(inputs: int = INPUTS) -> Network:
    return random_network(NetworkConfig(inputs, 3, HIDDEN, POINTS), 4, 0.5)


def frame() -> tuple[jax.Array, jax.Array]:
    """Returns (coefficients [K], x [I])."""
    return jnp.asarray([0.1, 0.2, 0.3, 0.4]), normal(5, INPUTS)


def test_layer_norm_has_mean_zero_and_standard_deviation_one(float64: None):
    f = 5 * features() + 3
    assert layer_norm(f).mean() == pytest.approx(0, abs=FLOAT64)
    assert layer_norm(f).std() == pytest.approx(1, abs=NO_VARIANCE)
    assert layer_norm_sample(f).std(ddof=1) == pytest.approx(1, abs=2e-6)  # 1e-6 on a standard deviation of at least 1


@pytest.mark.parametrize("normalise", [layer_norm, layer_norm_sample])
def test_normalisation_is_invariant_to_offset_and_scale(normalise, float64: None):
    np.testing.assert_allclose(normalise(7 * features() - 2), normalise(features()), atol=2e-6)


def test_the_two_statistics_differ_by_their_divisor(float64: None):
    ratio = np.sqrt((HIDDEN - 1) / HIDDEN)
    np.testing.assert_allclose(layer_norm_sample(features()), ratio * layer_norm(features()), rtol=2e-6)


@pytest.mark.parametrize("normalise", [layer_norm, layer_norm_sample])
@pytest.mark.parametrize("value", [0.0, -3.0, 1e4])
def test_a_constant_vector_has_value_zero_and_a_finite_gradient(normalise, value: float):
    with jax.enable_x64(True):  # in single precision the rounding of the mean is as large as the constant in the root
        np.testing.assert_allclose(normalise(jnp.full(HIDDEN, value)), np.zeros(HIDDEN), atol=1e-7)
    constant = jnp.full(HIDDEN, value, jnp.float32)
    assert np.isfinite(jax.jacrev(normalise)(constant)).all()
    assert np.isfinite(jax.jacfwd(normalise)(constant)).all()


def test_modulate_is_scale_and_shift_of_its_own_row():
    film, f = random_film(), features()
    for index in (0, 1):
        expected = film.scale[index] * layer_norm(f) + film.shift[index]
        np.testing.assert_array_equal(film.modulate(index, f, layer_norm), expected)
    np.testing.assert_array_equal(FiLMStyle.identity(HIDDEN).modulate(1, f), layer_norm(f))


def test_scale_zero_gives_the_shift():
    film = replace(random_film(), scale=jnp.zeros((2, HIDDEN)))
    np.testing.assert_array_equal(film.modulate(0, features()), film.shift[0])


def test_vector_order_is_scale_and_shift_of_each_layer_in_turn():
    vector = jnp.arange(4.0 * HIDDEN)
    film = FiLMStyle.from_vector(vector)
    np.testing.assert_array_equal(film.scale, np.stack([vector[:HIDDEN], vector[2 * HIDDEN : 3 * HIDDEN]]))
    np.testing.assert_array_equal(film.shift, np.stack([vector[HIDDEN : 2 * HIDDEN], vector[3 * HIDDEN :]]))
    np.testing.assert_array_equal(film.to_vector(), vector)


@pytest.mark.parametrize("normalise", [layer_norm, layer_norm_sample])
def test_forward_with_film_is_equation_3(normalise, float64: None):
    """Affine, then normalisation, then scale and shift, then ELU, on both hidden layers and not on the output."""
    network, film, (c, x) = small_network(), random_film(), frame()
    first, second, third = network.layers
    hidden = jax.nn.elu(film.scale[0] * normalise(first(c, x)) + film.shift[0])
    hidden = jax.nn.elu(film.scale[1] * normalise(second(c, hidden)) + film.shift[1])
    expected = third(c, hidden)
    np.testing.assert_allclose(forward(network, film, c, x, norm=normalise), expected, atol=FLOAT64)


def test_no_film_means_no_normalisation():
    network, (c, x) = small_network(), frame()
    plain = forward(network, None, c, x)
    np.testing.assert_array_equal(forward(network, None, c, x, norm=layer_norm_sample), plain)
    assert (forward(network, FiLMStyle.identity(HIDDEN), c, x) != plain).all()


def test_vmap_over_film_styles_equals_single_frames(float64: None):
    network, (c, x) = small_network(), frame()
    films = randomise(jax.tree.map(lambda leaf: jnp.zeros((6, *leaf.shape)), FiLMStyle.identity(HIDDEN)), 8)
    batched = jax.vmap(lambda film: forward(network, film, c, x))(films)
    for index in range(6):
        one = jax.tree.map(lambda leaf, i=index: leaf[i], films)
        np.testing.assert_allclose(batched[index], forward(network, one, c, x), atol=FLOAT64)


def test_gradients_of_forward_with_film(float64: None):
    def dropped(network, film, c, x):
        rates = Dropout(main=jnp.asarray(0.3), adapter=jnp.asarray(0.0))
        return forward(network, film, c, x, dropout=rates, key=KEY)

    arguments = (small_network(), random_film(), *frame())
    check_grads(jax.jit(forward), arguments, order=1, modes=("fwd", "rev"))
    check_grads(jax.jit(dropped), arguments, order=1, modes=("fwd", "rev"))


@pytest.mark.parametrize("normalise", [layer_norm, layer_norm_sample])
def test_gradients_of_modulate(normalise, float64: None):
    check_grads(jax.jit(lambda film, f: film.modulate(0, f, normalise)), (random_film(), features()), order=2)


def test_a_mixture_is_linear_before_modulation(float64: None):
    films = [random_film(seed) for seed in (1, 2, 3)]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *films)
    mixed = mix_styles(stacked, jnp.asarray([0.2, 0.3, 0.5]))
    expected = 0.2 * films[0].scale + 0.3 * films[1].scale + 0.5 * films[2].scale
    np.testing.assert_allclose(mixed.scale, expected, atol=FLOAT64)


def one_hot_of(first: BlendedLayer, style: int) -> OneHot:
    return OneHot(shift=BiasLayer(biases=first.weights[:, INPUTS + style]))


@pytest.mark.parametrize("style", [0, 2])
def test_a_one_hot_style_is_a_one_hot_input(style: int, float64: None):
    """Compares a network with three more inputs, one of them set, to a network with that input's columns as a style."""
    wide, (c, x) = small_network(INPUTS + 3), frame()
    first = wide.layers[0]
    assert isinstance(first, BlendedLayer)
    narrow = replace(wide, layers=(replace(first, weights=first.weights[:, :INPUTS]), *wide.layers[1:]))
    expected = forward(wide, None, c, jnp.concatenate([x, jnp.eye(3)[style]]))
    np.testing.assert_allclose(forward(narrow, one_hot_of(first, style), c, x), expected, atol=FLOAT64)


def test_a_one_hot_input_is_kept_or_dropped_as_a_whole(float64: None):
    """Its one input, 1, is dropped at the adapter's rate: the style vanishes, or is scaled by 1 / (1 - rate)."""
    network, (c, x) = small_network(), frame()
    style = OneHot(shift=BiasLayer(biases=normal(21, POINTS, HIDDEN)))
    double = jax.tree.map(lambda leaf: 2 * leaf, style)
    rates = Dropout(main=jnp.asarray(0.0), adapter=jnp.asarray(0.5))
    keys = jax.random.split(KEY, 12)
    rows = jax.vmap(lambda key: forward(network, style, c, x, dropout=rates, key=key))(keys)
    kept = np.isclose(rows, forward(network, double, c, x)[None], atol=FLOAT64).all(axis=1)
    gone = np.isclose(rows, forward(network, None, c, x)[None], atol=FLOAT64).all(axis=1)
    assert (kept ^ gone).all() and kept.any() and gone.any()


def test_gradients_of_forward_with_a_one_hot_style(float64: None):
    style = OneHot(shift=BiasLayer(biases=normal(21, POINTS, HIDDEN)))
    arguments = (small_network(), style, *frame())
    check_grads(jax.jit(forward), arguments, order=1, modes=("fwd", "rev"))


def test_film_style_of_another_width_is_refused():
    with pytest.raises(AssertionError):
        FiLMStyle.identity(HIDDEN + 1).modulate(0, features())
