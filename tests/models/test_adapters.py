"""Style adapters: sizes, what a checkpoint of each holds, and which of them start as the identity."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.models.config import AdapterConfig, AdapterKind
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.layers.one_hot import OneHot
from pfnn_jax.models.network import num_parameters
from pfnn_jax.models.style import Layer, init_style
from tests.models.helpers import shapes

HIDDEN, POINTS = 512, 4  # of the paper


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        ("full", 1_050_624),
        ("diagonal", 4_096),
        ("cp", 31_352),
        ("bias", 2_048),
        ("dense", 262_656),
        ("one_hot", 2_048),
        ("film", 2_048),
    ],
)
def test_numbers_per_style(kind: AdapterKind, numbers: int):
    """Table 1 of Mason 2018 in parameters and the last column of Table 2 of Mason 2022.

    The CP bias is not blended, as in the authors' code.
    """
    adapter = init_style(AdapterConfig(kind=kind, rank=30), HIDDEN, POINTS, key=jax.random.key(0))
    assert num_parameters(adapter) == numbers


def residual(config: AdapterConfig, hidden: int) -> Layer:
    """A fresh style that is a layer beside the second."""
    style = init_style(config, hidden, POINTS, key=jax.random.key(0))
    assert isinstance(style, Layer)
    return style


def test_parameter_trees():
    def tree(kind: AdapterKind) -> dict[str, tuple[tuple[int, ...], str]]:
        return shapes(init_style(AdapterConfig(kind=kind, rank=30), HIDDEN, POINTS, key=jax.random.key(0)))

    assert tree("cp") == {
        ".a": ((512, 30), "float32"),
        ".b": ((512, 30), "float32"),
        ".d": ((4, 30), "float32"),
        ".bias": ((512,), "float32"),
    }
    assert tree("full") == {".weights": ((4, 512, 512), "float32"), ".biases": ((4, 512), "float32")}
    assert tree("diagonal") == {".weights": ((4, 512), "float32"), ".biases": ((4, 512), "float32")}
    assert tree("bias") == {".biases": ((4, 512), "float32")}
    assert tree("dense") == {".weights": ((512, 512), "float32"), ".biases": ((512,), "float32")}
    assert tree("one_hot") == {".shift.biases": ((4, 512), "float32")}
    assert tree("film") == {".scale": ((2, 512), "float32"), ".shift": ((2, 512), "float32")}


def test_a_fresh_bias_adapter_is_the_identity_and_can_leave_it():
    adapter = residual(AdapterConfig(kind="bias"), 8)
    coefficients, x = jnp.full(POINTS, 0.25), jnp.ones(8)
    np.testing.assert_array_equal(adapter(coefficients, x), np.zeros(8))
    gradient = jax.grad(lambda layer: layer(coefficients, x).sum())(adapter)
    assert all((leaf != 0).all() for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize("kind", ["cp", "full", "diagonal", "dense"])
def test_other_fresh_adapters_are_small_and_not_the_identity(kind: AdapterKind):
    """The authors' uniform weights: a zero factor would leave CP with a gradient too weak to train."""
    adapter = residual(AdapterConfig(kind=kind, rank=4), 64)
    added = adapter(jnp.full(POINTS, 0.25), jnp.ones(64))
    assert 0 < np.abs(added).max() < 1


def test_a_fresh_one_hot_style_is_zero_and_a_fresh_film_scales_by_one():
    one_hot, film = (init_style(AdapterConfig(kind), 8, POINTS, key=jax.random.key(0)) for kind in ("one_hot", "film"))
    assert isinstance(one_hot, OneHot) and isinstance(film, FiLMStyle)
    np.testing.assert_array_equal(one_hot.shift.biases, np.zeros((POINTS, 8)))
    np.testing.assert_array_equal(film.scale, np.ones((2, 8)))
    np.testing.assert_array_equal(film.shift, np.zeros((2, 8)))


def test_messages_of_the_config():
    with pytest.raises(
        ValueError, match=r"AdapterConfig.kind must be bias, cp, dense, diagonal, film, full or one_hot, got 'lora'\."
    ):
        AdapterConfig(kind="lora")
    with pytest.raises(ValueError, match=r"AdapterConfig.rank must be at least 1, got 0\."):
        AdapterConfig(rank=0)
