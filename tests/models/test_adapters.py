"""Style adapters: sizes, what a checkpoint of each holds, and which of them start as the identity."""

from __future__ import annotations

from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.models.adapters import AdapterConfig, AdapterKind, init_adapter
from pfnn_jax.models.layers import linear
from pfnn_jax.models.network import num_parameters
from tests.models.helpers import shapes

HIDDEN, POINTS = 512, 4  # of the paper


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [("full", 1_050_624), ("diagonal", 4_096), ("cp", 31_352), ("bias", 2_048)],
)
def test_numbers_per_style(kind: AdapterKind, numbers: int):
    """Table 1 of Mason 2018 in parameters; the CP bias is not blended, as in the authors' code."""
    adapter = init_adapter(AdapterConfig(kind=kind, rank=30), HIDDEN, POINTS, jax.random.key(0))
    assert num_parameters(adapter) == numbers


def test_parameter_trees():
    def tree(kind: AdapterKind) -> dict[str, tuple[tuple[int, ...], str]]:
        return shapes(init_adapter(AdapterConfig(kind=kind, rank=30), HIDDEN, POINTS, jax.random.key(0)))

    assert tree("cp") == {
        ".a": ((512, 30), "float32"),
        ".b": ((512, 30), "float32"),
        ".d": ((4, 30), "float32"),
        ".bias": ((512,), "float32"),
    }
    assert tree("full") == {".weights": ((4, 512, 512), "float32"), ".biases": ((4, 512), "float32")}
    assert tree("diagonal") == {".weights": ((4, 512), "float32"), ".biases": ((4, 512), "float32")}
    assert tree("bias") == {".biases": ((4, 512), "float32")}


def test_a_fresh_bias_adapter_is_the_identity_and_can_leave_it():
    adapter = init_adapter(AdapterConfig(kind="bias"), 8, POINTS, jax.random.key(0))
    coefficients, x = jnp.full(POINTS, 0.25), jnp.ones(8)
    np.testing.assert_array_equal(linear(adapter, coefficients, x), np.zeros(8))
    gradient = jax.grad(lambda layer: linear(layer, coefficients, x).sum())(adapter)
    assert all((leaf != 0).all() for leaf in jax.tree.leaves(gradient))


@pytest.mark.parametrize("kind", ["cp", "full", "diagonal"])
def test_other_fresh_adapters_are_small_and_not_the_identity(kind: AdapterKind):
    """The authors' uniform weights: a zero factor would leave CP with a gradient too weak to train."""
    adapter = init_adapter(AdapterConfig(kind=kind, rank=4), 64, POINTS, jax.random.key(0))
    residual = linear(adapter, jnp.full(POINTS, 0.25), jnp.ones(64))
    assert 0 < np.abs(residual).max() < 1


def test_messages_of_the_config():
    with pytest.raises(ValueError, match=r"AdapterConfig.kind must be cp, full, .* or film, got 'lora'\."):
        AdapterConfig(kind=cast(AdapterKind, cast(Any, "lora")))
    with pytest.raises(ValueError, match=r"AdapterConfig.rank must be at least 1, got 0\."):
        AdapterConfig(rank=0)
