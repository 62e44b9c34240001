"""Styles: what one style adds to the shared network, and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.film import FiLMStyle, identity_film, mix
from pfnn_jax.models.layers import (
    BiasLayer,
    CPLayer,
    Layer,
    init_bias,
    init_blended,
    init_cp,
    init_dense,
    init_diagonal,
)

AdapterKind = Literal["cp", "full", "diagonal", "bias", "dense", "one_hot", "film"]


@struct.dataclass(kw_only=True)
class OneHot:
    """A style that is one more input, always 1: its blended column of first-layer weights.

    It is added to the first layer's output before activation, which is what the input with the style's number set
    would add.
    """

    shift: BiasLayer  # biases [K, H]


# A layer is a residual beside the second layer, a one-hot style shifts the first, a Film modulates both.
Style: TypeAlias = Layer | OneHot | FiLMStyle


@dataclass(frozen=True)
class AdapterConfig:
    """The form of a style.

    Attributes:
        kind: a residual on the second layer, namely `cp` (Mason 2018 Eq. 6), `full` (a blended matrix), `diagonal`,
            `bias` (a blended bias alone) or `dense` (a matrix that is not blended, Mason 2022 §5.2.1); or `one_hot`
            (a blended shift of the first layer); or `film` (scales and shifts of both hidden layers, Mason 2022 Eq. 3).
        rank: R of the CP factors; the other kinds have none and ignore it.
    """

    kind: AdapterKind = "cp"
    rank: int = 30

    def __post_init__(self):
        kinds = get_args(AdapterKind)
        if self.kind not in kinds:
            rule = ", ".join(kinds[:-1]) + f" or {kinds[-1]}"
            raise ValueError(f"AdapterConfig.kind must be {rule}, got {self.kind!r}.")
        if self.rank < 1:
            raise ValueError(f"AdapterConfig.rank must be at least 1, got {self.rank}.")


def init_style(config: AdapterConfig, hidden: int, num_experts: int, *, key: jax.Array) -> Style:
    """A fresh style of the configured kind for a network of H hidden units and K control points or experts.

    Bias and one-hot start at zero and Film at scale 1, shift 0; the others with the authors' small uniform weights.
    """
    match config.kind:
        case "cp":
            return init_cp(key, num_experts, hidden, hidden, config.rank)
        case "full":
            return init_blended(key, num_experts, hidden, hidden)
        case "diagonal":
            return init_diagonal(key, num_experts, hidden)
        case "bias":
            return init_bias(num_experts, hidden)
        case "dense":
            return init_dense(key, hidden, hidden)
        case "one_hot":
            return OneHot(shift=init_bias(num_experts, hidden))
        case "film":
            return identity_film(hidden)


def init_bank(config: AdapterConfig, hidden: int, num_experts: int, num_styles: int, *, key: jax.Array) -> Style:
    """Returns S freshly initialised styles of the configured kind, stacked: leaves [S, ...]."""
    keys = jax.random.split(key, num_styles)
    return jax.vmap(lambda k: init_style(config, hidden, num_experts, key=k))(keys)


def mix_styles(bank: Style, weights: jax.Array) -> Style:
    """The style that adds to the network the weighted sum of what S styles of one kind add.

    All kinds but one are linear in their parameters. The factors of a CP layer multiply each other, so that their
    weighted sum would be another motion: S layers of rank R stand beside each other as one of rank S R instead, the
    weights in its diagonal, which says exactly what `MixedLayer` says.

    Args:
        bank: any kind, with leaves [S, ...].
        weights: [S], usually with sum one; a vertex gives that style.
    """
    if not isinstance(bank, CPLayer):
        return mix(bank, weights)
    scaled = weights[:, None, None] * bank.d
    a, b, d = (jnp.concatenate(list(factor), axis=-1) for factor in (bank.a, bank.b, scaled))
    return CPLayer(a=a, b=b, d=d, bias=mix(bank.bias, weights))
