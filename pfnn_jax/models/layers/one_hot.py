"""The one-hot style: one more input of the network, which is always 1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.layers.bias import BiasLayer
from pfnn_jax.models.style import Affine, Drop, Style


@struct.dataclass(kw_only=True)
class OneHot(Style):
    """The blended column of first-layer weights that belongs to the style's input of 1.

    It is added to the first layer's output before activation, which is what that input would add. It starts at zero.
    """

    shift: BiasLayer  # biases [K, H]

    kind: ClassVar[str] = "one_hot"

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        return cls(shift=BiasLayer.init(inputs, outputs, num_experts, key=key))

    def after_first(self, f: jax.Array, coefficients: jax.Array, x: jax.Array, drop: Drop) -> jax.Array:
        return f + drop(jnp.ones((), f.dtype)) * self.shift(coefficients, x)

    def at(self, coefficients: jax.Array) -> Self:
        return type(self)(shift=self.shift.at(coefficients))

    def affine_terms(self, coefficients: Any) -> Mapping[int, Affine]:
        return {0: self.shift.affine(coefficients)}
