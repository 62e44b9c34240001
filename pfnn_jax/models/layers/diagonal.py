"""The diagonal layer: a blended scale of every unit (Mason 2018 §7.1)."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.style import Affine, Layer, small_uniform


@struct.dataclass(kw_only=True)
class DiagonalLayer(Layer):
    """A blended diagonal matrix and bias: `y = Σ_k c_k (w_k ∘ x + b_k)`, I = O = H."""

    weights: jax.Array  # [K, H]
    biases: jax.Array  # [K, H]

    kind: ClassVar[str] = "diagonal"
    foldable: ClassVar[bool] = True

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        return cls(
            weights=small_uniform(key, (num_experts, 1, outputs))[:, 0], biases=jnp.zeros((num_experts, outputs))
        )

    def __call__(self, coefficients: jax.Array, x: jax.Array) -> jax.Array:
        chex.assert_rank([coefficients, x], 1)
        chex.assert_shape(self.weights, (coefficients.shape[0], x.shape[0]))
        return (coefficients @ self.weights) * x + coefficients @ self.biases

    def at(self, coefficients: jax.Array) -> Self:
        return type(self)(weights=(coefficients @ self.weights)[None], biases=(coefficients @ self.biases)[None])

    def affine(self, coefficients: Any) -> Affine:
        diagonal = coefficients @ self.weights
        identity = diagonal.__array_namespace__().eye(len(diagonal), dtype=diagonal.dtype)
        return identity * diagonal[None], coefficients @ self.biases
