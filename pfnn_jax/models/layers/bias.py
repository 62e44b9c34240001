"""The bias layer: a blended bias alone."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.style import Affine, Layer


@struct.dataclass(kw_only=True)
class BiasLayer(Layer):
    """A blended bias that ignores its input: `y = Σ_k c_k b_k`.

    It starts at zero, where as an adapter it leaves the network unchanged, and its gradient does not vanish there.
    """

    biases: jax.Array  # [K, H]

    kind: ClassVar[str] = "bias"
    foldable: ClassVar[bool] = True

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        return cls(biases=jnp.zeros((num_experts, outputs)))

    def __call__(self, coefficients: jax.Array, x: jax.Array) -> jax.Array:
        chex.assert_rank([coefficients, x], 1)
        return coefficients @ self.biases

    def at(self, coefficients: jax.Array) -> Self:
        return type(self)(biases=(coefficients @ self.biases)[None])

    def affine(self, coefficients: Any) -> Affine:
        biases = coefficients @ self.biases
        return biases.__array_namespace__().zeros((), dtype=biases.dtype), biases
