"""The dense layer: a matrix that is not blended."""

from __future__ import annotations

from typing import Any, ClassVar, Self

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.style import Affine, Layer, small_uniform


@struct.dataclass(kw_only=True)
class DenseLayer(Layer):
    """An ordinary layer `y = x W + b`, the same at every phase: it ignores the coefficients, whatever their number.

    A blended layer at fixed coefficients is one (`BlendedLayer.at`). As a style: the residual that Mason 2022 gives to
    networks without a global phase (§5.2.1).
    """

    weights: jax.Array  # [I, O]
    biases: jax.Array  # [O]

    kind: ClassVar[str] = "dense"
    foldable: ClassVar[bool] = True
    rank: ClassVar[None] = None
    num_control_points: ClassVar[int] = 1

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        return cls(weights=small_uniform(key, (inputs, outputs)), biases=jnp.zeros(outputs))

    @property
    def input_size(self) -> int:
        return self.weights.shape[0]

    @property
    def output_size(self) -> int:
        return self.weights.shape[1]

    def __call__(self, coefficients: jax.Array, x: jax.Array) -> jax.Array:
        chex.assert_rank([coefficients, x], 1)
        chex.assert_shape(self.weights, (x.shape[0], None))
        return x @ self.weights + self.biases

    def at(self, coefficients: jax.Array) -> Self:
        return self

    def affine(self, coefficients: Any) -> Affine:
        return self.weights.T, self.biases

    def plus(self, weights: jax.Array, biases: jax.Array) -> Self:
        """Returns the layer with weights [O, I] and biases [O] added, or the scalar zero where there are none."""
        return type(self)(weights=self.weights + weights.T, biases=self.biases + biases)
