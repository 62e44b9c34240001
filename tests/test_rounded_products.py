"""The emulation of products of reduced precision, by which the effect of `precision` is measured on a CPU."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import ml_dtypes
import numpy as np
import pytest

from experiments.common.rounded_products import round_products
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.pretraining import init_state
from pfnn_jax.training.steps import predict_batch
from tests.training.toy import toy_rows

SUMS = 1e-6  # of sums of 8 products near 1, in another order
X, W = (np.asarray(jax.random.normal(jax.random.key(key), shape)) for key, shape in ((0, (4, 8)), (1, (8, 3))))


def to_bfloat16(value: np.ndarray) -> np.ndarray:
    return value.astype(ml_dtypes.bfloat16).astype(np.float64)


def test_factors_are_rounded_to_bfloat16():
    found = jax.jit(round_products(jnp.matmul, "bfloat16"))(X, W)
    np.testing.assert_allclose(found, to_bfloat16(X) @ to_bfloat16(W), atol=SUMS)
    assert np.abs(found - X @ W).max() > 1e-3  # of 8 bits


def test_products_of_gradients_are_rounded_too():
    gradient = jax.grad(lambda w: jnp.sum(jax.nn.elu(X @ w) * 1.1))
    found = jax.jit(round_products(gradient, "bfloat16"))(W)
    slope = np.float32(1.1) * np.where((y := to_bfloat16(X) @ to_bfloat16(W)) > 0, 1, np.exp(np.minimum(y, 0)))
    np.testing.assert_allclose(found, to_bfloat16(X).T @ to_bfloat16(slope), atol=0.02)  # a slope may round up or down
    assert np.abs(found - X.T @ slope).max() > 1e-3


def test_float32_and_what_is_no_product_stay_as_they_are():
    np.testing.assert_array_equal(round_products(jnp.matmul, "float32")(X, W), jnp.matmul(X, W))
    np.testing.assert_array_equal(round_products(lambda x: jnp.exp(x) + 1, "bfloat16")(X), jnp.exp(X) + 1)


def test_a_network_deviates_more_the_fewer_bits_there_are():
    rows = toy_rows().on_device()
    state = init_state(PretrainConfig(AdapterConfig("cp", 3), hidden=8), toy_rows().layout, 1)
    style = jax.tree.map(lambda leaf: leaf[0], state.params.modulation)

    def outputs(batch):
        return predict_batch(state.params.shared, style, batch, None, None)

    off = [
        float(jnp.abs(round_products(outputs, p)(rows) - outputs(rows)).max()) for p in ("float32", "tf32", "bfloat16")
    ]
    assert off[0] < off[1] < off[2]


def test_products_inside_loops_are_refused():
    looped = round_products(lambda x: jax.lax.fori_loop(0, 2, lambda _, y: y @ W[:3], x), "tf32")
    with pytest.raises(NotImplementedError, match="not rounded"):
        looped(X[:, :3])
