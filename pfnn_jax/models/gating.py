"""The gating network: what a frame's limbs do -> how the experts are blended (Mason 2022 §4.1 and §4.3)."""

from __future__ import annotations

from itertools import pairwise

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.dropout import drop, need_key
from pfnn_jax.models.layers import DenseLayer


@struct.dataclass(kw_only=True)
class Gating:
    """Three dense layers G -> H -> H -> K, ELU between them and a softmax behind."""

    layers: tuple[DenseLayer, DenseLayer, DenseLayer]


def init_gating(inputs: int, hidden: int, num_experts: int, *, key: jax.Array) -> Gating:
    """A fresh gating network: weights uniform in ± sqrt(6 / (I + O)), biases zero, as the authors'."""
    sizes = pairwise((inputs, hidden, hidden, num_experts))
    layers = [_init(k, i, o) for k, (i, o) in zip(jax.random.split(key, 3), sizes, strict=True)]
    return Gating(layers=(layers[0], layers[1], layers[2]))


def gate(
    gating: Gating, phase: jax.Array, *, dropout: jax.Array | None = None, key: jax.Array | None = None
) -> jax.Array:
    """Blending coefficients of one frame (Mason 2022 §4.1: the outputs of Ω).

    Args:
        gating: parameters.
        phase: [G] normalised local phases, or end-effector velocities.
        dropout: [] drop probability before each of the three layers, the inputs included; None at run time.
        key: random key, needed with `dropout`.

    Returns:
        [K] coefficients, positive, with sum one.

    Raises:
        ValueError: if `dropout` comes without `key`.
    """
    chex.assert_rank(phase, 1)
    need_key(dropout, key)
    keys = None if key is None else jax.random.split(key, 3)
    value = phase
    for index, layer in enumerate(gating.layers):
        if dropout is not None and keys is not None:
            value = drop(keys[index], dropout, value)
        value = value @ layer.weights + layer.biases
        value = jax.nn.elu(value) if index < 2 else jax.nn.softmax(value)
    return value


def _init(key: jax.Array, inputs: int, outputs: int) -> DenseLayer:
    bound = (6.0 / (inputs + outputs)) ** 0.5
    weights = jax.random.uniform(key, (inputs, outputs), minval=-bound, maxval=bound)
    return DenseLayer(weights=weights, biases=jnp.zeros(outputs))
