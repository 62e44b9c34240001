"""The output adapter: a CP layer that is added to the network's output."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Self

import jax
from flax import struct

from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.style import Affine, Drop, Style


@struct.dataclass(kw_only=True)
class CPOutput(Style):
    """A CP-decomposed residual of the third layer: `y = third(h) + layer(h)`, h the second hidden layer.

    A residual of the second layer can only recombine the poses that the shared third layer makes. This one reaches
    poses that no style of pretraining has, such as arms raised further.
    """

    layer: CPLayer  # from H to O

    kind: ClassVar[str] = "cp_output"

    @classmethod
    def init(cls, inputs: int, outputs: int, num_experts: int, *, rank: int = 30, key: jax.Array) -> Self:
        return cls(layer=CPLayer.init(inputs, outputs, num_experts, rank=rank, key=key))

    @classmethod
    def for_network(cls, sizes: NetworkConfig, *, rank: int = 30, key: jax.Array) -> Self:
        return cls.init(sizes.hidden, sizes.output_size, sizes.num_control_points, rank=rank, key=key)

    @property
    def config(self) -> AdapterConfig:
        return AdapterConfig(kind=self.kind, rank=self.layer.rank)

    def after_third(self, y: jax.Array, coefficients: jax.Array, hidden: jax.Array, drop: Drop) -> jax.Array:
        return y + self.layer(coefficients, drop(hidden))

    def at(self, coefficients: jax.Array) -> Self:
        return type(self)(layer=self.layer.at(coefficients))

    def affine_terms(self, coefficients: Any) -> Mapping[int, Affine]:
        return {2: self.layer.affine(coefficients)}

    def mix(self, weights: jax.Array) -> Self:
        return type(self)(layer=self.layer.mix(weights))

    def mix_dynamic(self, weights: jax.Array) -> Self:
        return replace(self, layer=self.layer.mix_dynamic(weights))
