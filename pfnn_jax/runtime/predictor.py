"""A network ready to run: parameters, one style, statistics, and a frame in and out in the layout's units."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.layers import Layer
from pfnn_jax.models.network import Network, forward
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.motion.normaliser import Normaliser
from pfnn_jax.training.run import Run, load_style


@struct.dataclass
class Predictor:
    """Everything that one evaluation needs.

    Attributes:
        network: shared parameters.
        adapter: one style's parameters, or None for style-agnostic motion.
        input_mean, input_std: [Dx] statistics of x, in layout units.
        output_mean, output_std: [Dy] statistics of y, in layout units.
    """

    network: Network
    adapter: Layer | None
    input_mean: jax.Array
    input_std: jax.Array
    output_mean: jax.Array
    output_std: jax.Array


def make_predictor(run: Run, style: str | None = None) -> Predictor:
    """The predictor of one of a run's styles, or of its style-agnostic motion.

    Args:
        run: as `load_run` returns it.
        style: name of the style, or None.

    Raises:
        InputError: for an unknown style, or one that does not belong to the run's shared network.
    """
    return assemble_predictor(run.shared, load_style(run, style), run.normaliser)


def assemble_predictor(network: Network, adapter: Layer | None, normaliser: Normaliser) -> Predictor:
    """The predictor of parameters in memory; `adapter` None for style-agnostic motion."""
    inputs, outputs = normaliser.inputs, normaliser.outputs
    statistics = (inputs.mean, inputs.std, outputs.mean, outputs.std)
    return Predictor(network, adapter, *(jnp.asarray(value, jnp.float32) for value in statistics))


def evaluate(predictor: Predictor, x: jax.Array, phase: jax.Array) -> jax.Array:
    """One frame through the network at the exact spline (Mason 2018 Eq. 1 and 4); `vmap` for many.

    Args:
        predictor: the network.
        x: [Dx] input in layout units.
        phase: [] radians.

    Returns:
        [Dy] output in layout units.
    """
    return evaluate_at(predictor, x, catmull_rom_basis(phase, predictor.network.layers[0].num_control_points))


def evaluate_at(predictor: Predictor, x: jax.Array, coefficients: jax.Array) -> jax.Array:
    """`evaluate` at given blending coefficients [K]: x [Dx] -> [Dy], both in layout units."""
    normalised = (x - predictor.input_mean) / predictor.input_std
    y = forward(predictor.network, predictor.adapter, coefficients, normalised)
    return y * predictor.output_std + predictor.output_mean
