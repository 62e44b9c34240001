"""The CP layer: a blended matrix in the form of a canonical polyadic decomposition (Mason 2018 §5.2)."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.style import Affine, Layer, small_uniform, weighted_sum


@struct.dataclass(kw_only=True)
class CPLayer(Layer):
    """A canonical polyadic decomposition: `y = A diag(D(c)) Bᵀ x + bias` (Mason 2018 Eq. 6).

    Only the diagonal is blended; the factors and the bias are the same at every phase, as in the authors' code. A
    lookup table therefore keeps the factors, which its entries share, and is not foldable.
    """

    a: jax.Array  # [O, R]
    b: jax.Array  # [I, R]
    d: jax.Array  # [K, R]
    bias: jax.Array  # [O]

    kind: ClassVar[str] = "cp"

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        """Returns a layer of rank R with all three factors uniform.

        The uniform D is the authors' choice. D = 0 would leave the network unchanged at the start, but with factors
        this small its gradient is so weak that the layer barely trains at the paper's learning rate of 1e-4.
        """
        key_a, key_b, key_d = jax.random.split(key, 3)
        return cls(
            a=small_uniform(key_a, (outputs, rank)),
            b=small_uniform(key_b, (rank, inputs)).T,
            d=small_uniform(key_d, (num_experts, 1, rank))[:, 0],
            bias=jnp.zeros(outputs),
        )

    @property
    def config(self) -> AdapterConfig:
        return AdapterConfig(kind=self.kind, rank=self.rank)

    @property
    def rank(self) -> int:
        return self.d.shape[-1]

    @property
    def num_control_points(self) -> int:
        return self.d.shape[0]

    @property
    def input_size(self) -> int:
        return self.b.shape[0]

    @property
    def output_size(self) -> int:
        return self.a.shape[0]

    def __call__(self, coefficients: jax.Array, x: jax.Array) -> jax.Array:
        chex.assert_rank([coefficients, x], 1)
        chex.assert_shape([self.b, self.d], [(x.shape[0], None), (coefficients.shape[0], None)])
        return self.a @ ((coefficients @ self.d) * (x @ self.b)) + self.bias

    def at(self, coefficients: jax.Array) -> Self:
        return type(self)(a=self.a, b=self.b, d=(coefficients @ self.d)[None], bias=self.bias)

    def affine(self, coefficients: Any) -> Affine:
        return (self.a * (coefficients @ self.d)[None]) @ self.b.T, self.bias

    def mix(self, weights: jax.Array) -> Self:
        """Returns the mixture of S layers of rank R as one layer of rank S R, with the weights in its diagonal."""
        scaled = weights[:, None, None] * self.d
        a, b, d = (jnp.concatenate(list(factor), axis=-1) for factor in (self.a, self.b, scaled))
        return type(self)(a=a, b=b, d=d, bias=weighted_sum(self.bias, weights))
