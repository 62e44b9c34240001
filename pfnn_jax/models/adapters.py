"""Style adapters: which layer is added to the second layer of the shared network for one style."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import jax

from pfnn_jax.models.layers import Layer, init_bias, init_blended, init_cp, init_diagonal

AdapterKind = Literal["cp", "full", "diagonal", "bias"]


@dataclass(frozen=True)
class AdapterConfig:
    """The form of a style's adapter.

    Attributes:
        kind: `cp` (Mason 2018 Eq. 6), `full` (a blended matrix), `diagonal`, or `bias` (a blended bias alone).
        rank: R of the CP factors; the other kinds have none and ignore it.
    """

    kind: AdapterKind = "cp"
    rank: int = 30

    def __post_init__(self):
        if self.kind not in ("cp", "full", "diagonal", "bias"):
            raise ValueError(f"AdapterConfig.kind must be cp, full, diagonal or bias, got {self.kind!r}.")
        if self.rank < 1:
            raise ValueError(f"AdapterConfig.rank must be at least 1, got {self.rank}.")


def init_adapter(config: AdapterConfig, hidden: int, num_control_points: int, key: jax.Array) -> Layer:
    """A fresh adapter H -> H of the configured kind (shapes in `pfnn_jax.models.layers`)."""
    match config.kind:
        case "cp":
            return init_cp(key, num_control_points, hidden, hidden, config.rank)
        case "full":
            return init_blended(key, num_control_points, hidden, hidden)
        case "diagonal":
            return init_diagonal(key, num_control_points, hidden)
        case "bias":
            return init_bias(num_control_points, hidden)
