"""A network ready to run: parameters, one style, statistics, and a frame in and out in the layout's units."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.inference.mixture import load_choice
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.models.layers.film import layer_norm
from pfnn_jax.models.network import Network, coefficients, forward
from pfnn_jax.models.style import Normalise, Style
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.run import Run


@struct.dataclass
class Predictor:
    """Everything that one evaluation needs.

    Attributes:
        network: shared parameters.
        style: one style's parameters, or None for style-agnostic motion.
        input_mean, input_std: [Dx] statistics of x, in layout units.
        output_mean, output_std: [Dy] statistics of y, in layout units.
        phase_mean, phase_std: [G] statistics of what a gating network reads, or None for a scalar phase.
    """

    network: Network
    style: Style | None
    input_mean: jax.Array
    input_std: jax.Array
    output_mean: jax.Array
    output_std: jax.Array
    phase_mean: jax.Array | None = None
    phase_std: jax.Array | None = None


def make_predictor(run: Run, style: StyleChoice = None) -> Predictor:
    """The predictor of one of a run's styles, of a mixture of them, or of its style-agnostic motion.

    Args:
        run: as `load_run` returns it.
        style: name of the style; weights that sum to one by name; or None, which on a FiLM run is the mean of its
            styles.

    Raises:
        InputError: for an unknown style, one that does not belong to the run's shared network, or weights that do not
            sum to one.
    """
    return assemble_predictor(run.shared, load_choice(run, style), run.normaliser)


def assemble_predictor(network: Network, style: Style | None, normaliser: Normaliser) -> Predictor:
    """The predictor of parameters in memory; `style` None for style-agnostic motion."""
    records = (normaliser.inputs, normaliser.outputs)
    if normaliser.phases is not None:
        records = (*records, normaliser.phases)
    values = [jnp.asarray(value, jnp.float32) for record in records for value in (record.mean, record.std)]
    return Predictor(network, style, *values)


def evaluate(predictor: Predictor, x: jax.Array, phase: jax.Array, *, normalise: Normalise = layer_norm) -> jax.Array:
    """One frame through the network (Mason 2018 Eq. 1 and 4, Mason 2022 Eq. 2 to 4); `vmap` for many.

    Args:
        predictor: the network.
        x: [Dx] input in layout units.
        phase: [] radians, for the exact spline; or [G] in layout units, for a gating network.
        normalise: layer norm of a FiLM style: `layer_norm`, or `layer_norm_sample` as in the authors' training.

    Returns:
        [Dy] output in layout units.
    """
    if predictor.phase_mean is not None and predictor.phase_std is not None:
        phase = (phase - predictor.phase_mean) / predictor.phase_std
    return evaluate_at(predictor, x, coefficients(predictor.network, phase), normalise=normalise)


def evaluate_at(
    predictor: Predictor, x: jax.Array, blending: jax.Array, *, normalise: Normalise = layer_norm
) -> jax.Array:
    """`evaluate` at given blending coefficients [K]: x [Dx] -> [Dy], both in layout units."""
    normalised = (x - predictor.input_mean) / predictor.input_std
    y = forward(predictor.network, predictor.style, blending, normalised, normalise=normalise)
    return y * predictor.output_std + predictor.output_mean
