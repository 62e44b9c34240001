"""Lookup tables: networks blended in advance at evenly spaced phases, so that a frame costs three matrix products.

A table entry (Holden 2017 §7) is a predictor with a single control point, evaluated by the same forward pass. The entry
for a frame is chosen on the host and passed to the compiled function: gathering it from one stacked array would copy
2.4 MB per frame and take as long as the exact spline.

When the phase is traced (inside `jit`, `scan` or `vmap`), the host cannot choose. The entry is then blended from the
control points at the entry's phase: equal up to rounding, at the cost of the exact spline, and a batch of characters
remains one matrix product.
"""

from __future__ import annotations

import dataclasses
import math

import jax
import jax.numpy as jnp
from flax import struct
from jax.core import Tracer

from pfnn_jax.inference.modes import LookupMode
from pfnn_jax.inference.predictor import Predictor, evaluate, evaluate_at
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.network import Network
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.models.style import Style

NUM_SLICES = 50
"""Entries in the released controllers' tables."""


@struct.dataclass
class Lookup:
    """A table of predictors over the phase.

    Attributes:
        predictor: the network from which the table was made.
        slices: one predictor with a single control point for each table phase 2πi/N.
        mode: which entry is used for a phase: the nearest, or the last one passed (the released demo truncates).
    """

    predictor: Predictor
    slices: tuple[Predictor, ...]
    mode: LookupMode = struct.field(pytree_node=False)


def make_lookup(predictor: Predictor, num_slices: int = NUM_SLICES, mode: LookupMode = "nearest50") -> Lookup:
    """Blends a network at N phases.

    Full, dense, diagonal and bias adapters are added into the second layer's matrix. CP adapters of the second layer
    and of the output, like every layer of a CP network, keep their factors and have only their diagonal blended; a FiLM
    style is the same at every phase.

    Args:
        predictor: the network; a table of 50 entries at 234-512-512-400 takes 118 MB.
        num_slices: N.
        mode: `nearest50`, or `constant50` for the released demo's truncation.

    Raises:
        ValueError: for an unknown mode, no slices, or a gating network: tables need a cyclic phase.
    """
    _check_mode(mode)
    if predictor.network.gating is not None:
        raise ValueError("`predictor` must have a spline of a global phase, got a gating network.")
    if num_slices < 1:
        raise ValueError(f"`num_slices` must be at least 1, got {num_slices}.")
    phases = jnp.arange(num_slices, dtype=jnp.float32) * (2 * math.pi / num_slices)
    blending = jax.vmap(lambda phase: catmull_rom_basis(phase, predictor.network.num_control_points))(phases)
    return Lookup(predictor=predictor, slices=tuple(_slice(predictor, c) for c in blending), mode=mode)


def evaluate_lookup(lookup: Lookup, x: jax.Array, phase: jax.Array | float) -> jax.Array:
    """Evaluates one frame with the table entry of its phase.

    Args:
        lookup: the table.
        x: [Dx] input in layout units.
        phase: [] radians; may be traced, see the module docstring.

    Returns:
        [Dy] output in layout units; piecewise constant in the phase.
    """
    num_slices = len(lookup.slices)
    if isinstance(phase, Tracer):
        return evaluate(lookup.predictor, x, table_phase(phase, lookup.mode, num_slices))
    turns = float(phase) * num_slices / (2 * math.pi)
    index = math.floor(turns + _offset(lookup.mode)) % num_slices
    return _evaluate_slice(lookup.slices[index], x)


def table_phase(phase: jax.Array, mode: LookupMode, num_slices: int = NUM_SLICES) -> jax.Array:
    """Returns the phase [] in radians of the table entry for a phase [] in radians.

    Raises:
        ValueError: for an unknown mode.
    """
    _check_mode(mode)
    step = 2 * math.pi / num_slices
    return jnp.floor(phase / step + _offset(mode)) % num_slices * step


def _check_mode(mode: str) -> None:
    if mode not in ("nearest50", "constant50"):
        raise ValueError(f"`mode` must be nearest50 or constant50, got {mode!r}.")


def _offset(mode: LookupMode) -> float:
    return 0.5 if mode == "nearest50" else 0.0


@jax.jit
def _evaluate_slice(entry: Predictor, x: jax.Array) -> jax.Array:
    return evaluate_at(entry, x, jnp.ones(1, entry.input_mean.dtype))


def _slice(predictor: Predictor, coefficients: jax.Array) -> Predictor:
    """Returns the predictor at coefficients [K]. Not compiled, so that all entries share the factors of CP layers."""
    style = None if predictor.style is None else predictor.style.at(coefficients)
    network, style = _fold(predictor.network.at(coefficients), style)
    return dataclasses.replace(predictor, network=network, style=style)


def _fold(network: Network, style: Style | None) -> tuple[Network, Style | None]:
    """Returns network and style, both of one control point, with the style added into the network where it can be."""
    if style is None or not style.foldable:
        return network, style
    layers = list(network.layers)
    for index, (weights, biases) in style.affine_terms(jnp.ones(1)).items():
        layer = layers[index]
        if not isinstance(layer, DenseLayer):
            return network, style  # to multiply out the factors of a CP network would lose what they save
        layers[index] = layer.plus(weights, biases)
    return Network(layers=(layers[0], layers[1], layers[2])), None
