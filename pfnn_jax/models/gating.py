"""The gating network Ω, from which the blending coefficients of the experts come (Mason 2022 §4.1 and §4.3)."""

from __future__ import annotations

from itertools import pairwise

import chex
import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.dropout import drop, need_key
from pfnn_jax.models.layers.dense import DenseLayer


@struct.dataclass(kw_only=True)
class Gating:
    """Three dense layers G -> H -> H -> K, with ELU between them and a softmax at the end."""

    layers: tuple[DenseLayer, DenseLayer, DenseLayer]

    @property
    def input_size(self) -> int:
        return self.layers[0].weights.shape[0]

    @property
    def hidden(self) -> int:
        return self.layers[0].weights.shape[1]


def init_gating(inputs: int, hidden: int, num_experts: int, *, key: jax.Array) -> Gating:
    """Returns a freshly initialised gating network: Glorot-uniform weights and zero biases, as the authors' code."""
    init = jax.nn.initializers.glorot_uniform()
    pairs = zip(jax.random.split(key, 3), pairwise((inputs, hidden, hidden, num_experts)), strict=True)
    layers = [DenseLayer(weights=init(k, (i, o)), biases=jnp.zeros(o)) for k, (i, o) in pairs]
    return Gating(layers=(layers[0], layers[1], layers[2]))


def gate(
    gating: Gating, gating_input: jax.Array, *, dropout: jax.Array | None = None, key: jax.Array | None = None
) -> jax.Array:
    """Returns the blending coefficients of one frame (Mason 2022 §4.1: the outputs of Ω).

    Args:
        gating: parameters.
        gating_input: [G] normalised local phases, or end-effector velocities.
        dropout: [] drop probability before each of the three layers, including the first; None at run time.
        key: random key, needed with `dropout`.

    Returns:
        [K] coefficients, positive, with sum one.

    Raises:
        ValueError: if `dropout` is given without `key`.
    """
    chex.assert_rank(gating_input, 1)
    need_key(dropout, key)
    keys = None if key is None else jax.random.split(key, 3)
    value = gating_input
    for index, layer in enumerate(gating.layers):
        if dropout is not None and keys is not None:
            value = drop(keys[index], dropout, value)
        value = value @ layer.weights + layer.biases
        value = jax.nn.elu(value) if index < 2 else jax.nn.softmax(value)
    return value
