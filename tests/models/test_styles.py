"""Laws that every kind of style obeys: each is tested for all registered kinds, and for one that is defined here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import struct
from jax.test_util import check_grads

from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers import style_class, style_kinds
from pfnn_jax.models.layers.bias import BiasLayer
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.layers.one_hot import OneHot
from pfnn_jax.models.network import Network, forward, num_parameters
from pfnn_jax.models.style import Drop, Layer, Style, init_bank, init_style, mix_styles
from tests.models.helpers import (
    LAYER_KINDS,
    STYLE_KINDS,
    random_bank,
    random_layer,
    random_network,
    random_style,
    shapes,
)

FLOAT64 = 1e-12  # a few small products in double precision
INPUTS, OUTPUTS, HIDDEN, POINTS, RANK = 5, 6, 7, 4, 2
SIZES = NetworkConfig(INPUTS, OUTPUTS, HIDDEN, POINTS)
WEIGHTS = ([0.0, 1.0, 0.0], [0.5, 0.2, 0.3], [0.0, 1.5, -0.5])


def network() -> Network:
    """Returns a network with normal parameters, small enough that ELU is not linear."""
    return random_network(SIZES, 1, 0.3)


def coefficients() -> jax.Array:
    return jnp.asarray([0.1, -0.2, 0.5, 0.6])


def frame() -> jax.Array:
    return jnp.linspace(-1.0, 1.0, INPUTS)


def hidden_frame() -> jax.Array:
    return jnp.linspace(-1.0, 1.0, HIDDEN)


def one_of(bank: Style, index: int) -> Style:
    return jax.tree.map(lambda leaf: leaf[index], bank)


# Laws, as functions of a kind.


def a_bank_has_the_shapes_of_its_styles(kind: str) -> None:
    config = AdapterConfig(kind, RANK)
    style = init_style(config, SIZES, key=jax.random.key(0))
    bank = init_bank(config, SIZES, 3, key=jax.random.key(0))
    assert type(style) is type(bank) is style_class(kind)
    assert {path: ((3, *shape), dtype) for path, (shape, dtype) in shapes(style).items()} == shapes(bank)
    assert style.config.kind == kind
    again = init_style(style.config, SIZES, key=jax.random.key(1))
    assert shapes(again) == shapes(style)


def named_arrays_hold_all_parameters(kind: str) -> None:
    style = random_style(kind, SIZES, RANK)
    assert sum(array.size for array in style.named_arrays().values()) == num_parameters(style)


def a_style_at_coefficients_needs_no_others(kind: str) -> None:
    style, c = random_style(kind, SIZES, RANK), coefficients()
    expected = forward(network(), style, c, frame())
    found = forward(network().at(c), style.at(c), jnp.ones(1), frame())
    np.testing.assert_allclose(found, expected, atol=FLOAT64)


def both_mixtures_are_the_same_function(kind: str) -> None:
    bank = random_bank(kind, 3, SIZES, RANK)
    for weights in map(jnp.asarray, WEIGHTS):
        fixed, dynamic = mix_styles(bank, weights), bank.mix_dynamic(weights)
        assert type(fixed) is type(bank)
        expected = forward(network(), fixed, coefficients(), frame())
        np.testing.assert_allclose(forward(network(), dynamic, coefficients(), frame()), expected, atol=FLOAT64)


def a_mixture_at_a_vertex_is_that_style(kind: str) -> None:
    bank = random_bank(kind, 3, SIZES, RANK)
    for index in range(3):
        expected = forward(network(), one_of(bank, index), coefficients(), frame())
        for mixture in (bank.mix(jnp.eye(3)[index]), bank.mix_dynamic(jnp.eye(3)[index])):
            np.testing.assert_allclose(forward(network(), mixture, coefficients(), frame()), expected, atol=FLOAT64)


def gradients_agree_with_finite_differences(kind: str) -> None:
    style = random_style(kind, SIZES, RANK)

    def output(style: Style, c: jax.Array, x: jax.Array) -> jax.Array:
        return forward(network(), style, c, x)

    check_grads(output, (style, coefficients(), frame()), order=1, modes=("fwd", "rev"))


LAWS = (
    a_bank_has_the_shapes_of_its_styles,
    named_arrays_hold_all_parameters,
    a_style_at_coefficients_needs_no_others,
    both_mixtures_are_the_same_function,
    a_mixture_at_a_vertex_is_that_style,
    gradients_agree_with_finite_differences,
)


@pytest.mark.parametrize("kind", STYLE_KINDS)
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_every_kind(law: Callable[[str], None], kind: str, float64: None):
    law(kind)


@pytest.fixture(scope="module")
def new_kind() -> str:
    """Defines a kind of style, as a user would: a gain of every hidden unit, linear in its parameters."""

    @struct.dataclass(kw_only=True)
    class GainStyle(Style):
        gain: jax.Array  # [2, H]

        kind: ClassVar[str] = "gain"

        @classmethod
        def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
            return cls(gain=jnp.zeros((2, outputs)))

        def modulate(self, index: int, f: jax.Array, normalise: Any) -> jax.Array:
            return f * (1.0 + self.gain[index])

    return GainStyle.kind


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_a_new_kind_needs_only_its_class(law: Callable[[str], None], new_kind: str, float64: None):
    assert new_kind in style_kinds()
    law(new_kind)


@pytest.mark.parametrize("kind", LAYER_KINDS)
def test_a_layer_at_coefficients_is_a_layer_of_one_control_point(kind: str, float64: None):
    layer, c, x = random_layer(kind, POINTS, HIDDEN, HIDDEN, RANK), coefficients(), hidden_frame()
    at = layer.at(c)
    assert isinstance(at, Layer)
    np.testing.assert_allclose(at(jnp.ones(1), x), layer(c, x), atol=FLOAT64)


@pytest.mark.parametrize("kind", LAYER_KINDS)
def test_a_layer_is_affine(kind: str, float64: None):
    layer, c, x = random_layer(kind, POINTS, HIDDEN, HIDDEN, RANK), coefficients(), hidden_frame()
    weights, biases = layer.affine(c)
    product = jnp.broadcast_to(weights, (HIDDEN, HIDDEN)) @ x
    np.testing.assert_allclose(product + biases, layer(c, x), atol=FLOAT64)
    in_numpy = jax.tree.map(np.asarray, layer).affine(np.asarray(c))
    assert all(isinstance(array, np.ndarray) for array in in_numpy)
    np.testing.assert_allclose(in_numpy[1], biases, atol=FLOAT64)


@pytest.mark.parametrize("kind", LAYER_KINDS)
@pytest.mark.parametrize("weights", WEIGHTS)
def test_a_mixture_of_layers_is_the_weighted_sum_of_outputs(kind: str, weights: list[float], float64: None):
    bank = random_bank(kind, 3, SIZES, RANK)
    each = jnp.stack([one_layer(bank, i)(coefficients(), hidden_frame()) for i in range(3)])
    mixed = bank.mix_dynamic(jnp.asarray(weights))
    assert isinstance(mixed, Layer)
    expected = jnp.asarray(weights) @ each
    np.testing.assert_allclose(mixed(coefficients(), hidden_frame()), expected, atol=FLOAT64)
    at = mixed.at(coefficients())
    assert isinstance(at, Layer)
    np.testing.assert_allclose(at(jnp.ones(1), hidden_frame()), expected, atol=FLOAT64)


def one_layer(bank: Style, index: int) -> Layer:
    layer = one_of(bank, index)
    assert isinstance(layer, Layer)
    return layer


def test_ranks_of_mixed_cp_layers_add_up():
    mixed = random_bank("cp", 3, SIZES, RANK).mix(jnp.ones(3))
    assert isinstance(mixed, CPLayer) and mixed.rank == 3 * RANK
    assert mixed.a.shape == mixed.b.shape == (HIDDEN, 3 * RANK)


def test_layers_of_weight_zero_are_not_evaluated():
    """A layer of weight zero may even hold NaN."""
    bank = random_bank("full", 3, SIZES, RANK)
    spoilt = jax.tree.map(lambda leaf: leaf.at[1].set(jnp.nan), bank)
    mixed = spoilt.mix_dynamic(jnp.asarray([0.5, 0.0, 0.5]))
    assert isinstance(mixed, Layer)
    assert jnp.isfinite(mixed(coefficients(), hidden_frame())).all()


def test_no_sample_of_a_batch_of_mixtures_has_its_own_matrix():
    bank, batch = random_bank("full", 3, SIZES, RANK), 50

    def outputs(bank: Style, weights: jax.Array, x: jax.Array) -> jax.Array:
        def one(w: jax.Array, row: jax.Array) -> jax.Array:
            layer = bank.mix_dynamic(w)
            assert isinstance(layer, Layer)
            return layer(jnp.ones(POINTS), row)

        return jax.vmap(one)(weights, x)

    compiled = jax.jit(outputs).lower(bank, jnp.ones((batch, 3)), jnp.ones((batch, HIDDEN))).compile().as_text()
    assert compiled is not None and f"f32[{batch},{HIDDEN},{HIDDEN}]" not in compiled
    assert f"f32[{batch},{POINTS},{HIDDEN},{HIDDEN}]" not in compiled


def test_dropout_of_a_style_acts_on_its_own_input():
    """With all of its input dropped, a residual leaves its biases and a one-hot style leaves nothing."""

    def drop_all(x: jax.Array) -> jax.Array:
        return jnp.zeros_like(x)

    drop: Drop = drop_all
    f, c, one_hot = hidden_frame(), coefficients(), random_style("one_hot", SIZES, RANK)
    np.testing.assert_array_equal(one_hot.after_first(f, c, frame(), drop), f)
    full = random_layer("full", POINTS, HIDDEN, HIDDEN, RANK)
    np.testing.assert_allclose(full.after_second(f, c, f, drop), f + full(c, jnp.zeros(HIDDEN)), rtol=1e-6)


# Facts of single kinds, from the papers.


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        ("full", 1_050_624),
        ("diagonal", 4_096),
        ("cp", 31_352),
        ("bias", 2_048),
        ("dense", 262_656),
        ("one_hot", 2_048),
        ("cp_output", 27_880),
        ("film", 2_048),
    ],
)
def test_parameters_per_style(kind: str, numbers: int):
    """Table 1 of Mason 2018 and the last column of Table 2 of Mason 2022; K = 4, H = 512, R = 30.

    The CP bias is not blended, as in the authors' code.
    """
    style = jax.eval_shape(
        lambda: init_style(AdapterConfig(kind, 30), NetworkConfig(234, 400, 512, 4), key=jax.random.key(0))
    )
    assert num_parameters(style) == numbers


@pytest.mark.parametrize(
    ("kind", "tree"),
    [
        ("cp", {".a": (512, 30), ".b": (512, 30), ".d": (4, 30), ".bias": (512,)}),
        ("full", {".weights": (4, 512, 512), ".biases": (4, 512)}),
        ("diagonal", {".weights": (4, 512), ".biases": (4, 512)}),
        ("bias", {".biases": (4, 512)}),
        ("dense", {".weights": (512, 512), ".biases": (512,)}),
        ("one_hot", {".shift.biases": (4, 512)}),
        (
            "cp_output",
            {".layer.a": (400, 30), ".layer.b": (512, 30), ".layer.d": (4, 30), ".layer.bias": (400,)},
        ),
        ("film", {".scale": (2, 512), ".shift": (2, 512)}),
    ],
)
def test_parameter_trees_as_run_directories_store_them(kind: str, tree: dict[str, tuple[int, ...]]):
    style = jax.eval_shape(
        lambda: init_style(AdapterConfig(kind, 30), NetworkConfig(234, 400, 512, 4), key=jax.random.key(0))
    )
    assert shapes(style) == {path: (shape, "float32") for path, shape in tree.items()}


def test_a_fresh_bias_adapter_is_the_identity_and_has_a_gradient():
    style = init_style(AdapterConfig("bias"), SIZES, key=jax.random.key(0))
    assert isinstance(style, BiasLayer)
    np.testing.assert_array_equal(style(coefficients(), hidden_frame()), np.zeros(HIDDEN))
    gradient = jax.grad(lambda layer: layer(coefficients(), hidden_frame()).sum())(style)
    assert (gradient.biases != 0).all()


@pytest.mark.parametrize("kind", ["cp", "full", "diagonal", "dense"])
def test_other_fresh_adapters_are_small_and_not_the_identity(kind: str):
    """The authors' uniform weights: with a factor of zero, the gradient of CP would be too weak to train."""
    layer = init_style(AdapterConfig(kind, rank=4), NetworkConfig(64, 64, 64, POINTS), key=jax.random.key(0))
    assert isinstance(layer, Layer)
    added = layer(jnp.full(POINTS, 0.25), jnp.ones(64))
    assert 0 < np.abs(added).max() < 1


def test_a_fresh_one_hot_style_is_zero_and_fresh_film_scales_by_one():
    one_hot, film = (
        init_style(AdapterConfig(kind), NetworkConfig(8, 8, 8, POINTS), key=jax.random.key(0))
        for kind in ("one_hot", "film")
    )
    assert isinstance(one_hot, OneHot) and isinstance(film, FiLMStyle)
    np.testing.assert_array_equal(one_hot.shift.biases, np.zeros((POINTS, 8)))
    np.testing.assert_array_equal(film.scale, np.ones((2, 8)))
    np.testing.assert_array_equal(film.shift, np.zeros((2, 8)))


def test_a_mixture_of_film_styles_is_not_affine():
    with pytest.raises(TypeError, match="film"):
        random_style("film", SIZES, RANK).affine_terms(coefficients())


def test_configurations_that_are_refused():
    with pytest.raises(ValueError, match=r"AdapterConfig.kind must be bias, cp, .* or .*, got 'lora'\."):
        AdapterConfig(kind="lora")
    with pytest.raises(ValueError, match=r"AdapterConfig.rank must be at least 1, got 0\."):
        AdapterConfig(rank=0)
