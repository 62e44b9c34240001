"""The blended layer: K full weight matrices (Holden 2017 Eq. 2)."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.batched_form import with_batched_form
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.style import Affine, Layer, small_uniform


def _flat_product(weights: jax.Array, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """Returns Σ_k c_k (x W_k) [O] of weights [K, I, O], as one product of the flattened c ⊗ x."""
    scaled = (coefficients[:, None] * x[None, :]).reshape(-1)
    return scaled @ weights.reshape(scaled.shape[0], -1)


@with_batched_form(_flat_product)
def _expert_products(weights: jax.Array, coefficients: jax.Array, x: jax.Array) -> jax.Array:
    """Returns Σ_k c_k (x W_k) [O] of weights [K, I, O], as the sum of K products.

    On processors XLA fuses a product whose result is a vector with the reshaping of its matrix, into a loop that reads
    the matrix column by column: one frame then takes ten times as long. The K products are a batch, whose result is a
    matrix, which is not fused. For many frames their K results would be written and read again.
    """
    scaled = coefficients[:, None] * x[None, :]
    return jnp.einsum("ki,kio->ko", scaled, weights).sum(axis=0)


@struct.dataclass(kw_only=True)
class BlendedLayer(Layer):
    """K full weight matrices: `y = Σ_k c_k (x W_k + b_k)`. As a style: the full residual.

    Under `vmap` the layer is one matrix product over the flattened c ⊗ x, so that no weight matrix of a single sample
    is ever built. One frame is K products of a vector and a matrix (`_expert_products`).
    """

    weights: jax.Array  # [K, I, O]
    biases: jax.Array  # [K, O]

    kind: ClassVar[str] = "full"
    foldable: ClassVar[bool] = True
    rank: ClassVar[None] = None

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        return cls(weights=small_uniform(key, (num_experts, inputs, outputs)), biases=jnp.zeros((num_experts, outputs)))

    @property
    def num_control_points(self) -> int:
        return self.weights.shape[0]

    @property
    def input_size(self) -> int:
        return self.weights.shape[1]

    @property
    def output_size(self) -> int:
        return self.weights.shape[2]

    def __call__(self, coefficients: jax.Array, x: jax.Array) -> jax.Array:
        chex.assert_rank([coefficients, x], 1)
        chex.assert_shape(self.weights, (coefficients.shape[0], x.shape[0], None))
        return _expert_products(self.weights, coefficients, x) + coefficients @ self.biases

    def at(self, coefficients: jax.Array) -> DenseLayer:
        """Returns the layer at coefficients [K]: a dense one, whose product with one frame is not fused into a loop."""
        return DenseLayer(weights=self._blend(coefficients), biases=coefficients @ self.biases)

    def affine(self, coefficients: Any) -> Affine:
        return self._blend(coefficients).T, coefficients @ self.biases

    def _blend(self, coefficients: Any) -> Any:
        """Returns the weights [I, O] at coefficients [K], in the arrays' own library."""
        return (coefficients @ self.weights.reshape(len(self.weights), -1)).reshape(self.weights.shape[1:])
