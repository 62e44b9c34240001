"""Evaluates a trained network in the units of its layout: parameters, one style and normalisation statistics."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.inference.mixture import load_choice
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.models.layers.film import layer_norm
from pfnn_jax.models.network import Network, coefficients, forward
from pfnn_jax.models.style import Norm, Style
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.run import Run


@struct.dataclass
class Predictor:
    """Everything needed to evaluate one frame.

    Attributes:
        network: shared parameters.
        style: one style's parameters, or None for style-agnostic motion.
        input_mean, input_std: [Dx] statistics of x, in layout units.
        output_mean, output_std: [Dy] statistics of y, in layout units.
        gating_mean, gating_std: [G] statistics of the gating input, or None for a scalar phase.
    """

    network: Network
    style: Style | None
    input_mean: jax.Array
    input_std: jax.Array
    output_mean: jax.Array
    output_std: jax.Array
    gating_mean: jax.Array | None = None
    gating_std: jax.Array | None = None


def make_predictor(run: Run, style: StyleChoice = None) -> Predictor:
    """Returns the predictor of a style of a run, of a mixture of styles, or of style-agnostic motion.

    Args:
        run: a loaded run.
        style: a name; weights by name that sum to one; or None for style-agnostic motion (for a FiLM run, the mean of
            its styles).

    Raises:
        InputError: for an unknown style, one that does not belong to the run's shared network, or weights that do not
            sum to one.
    """
    return assemble_predictor(run.shared, load_choice(run, style), run.normaliser)


def assemble_predictor(network: Network, style: Style | None, normaliser: Normaliser) -> Predictor:
    """Returns the predictor of parameters in memory; `style` is None for style-agnostic motion."""

    def on_device(values: np.ndarray) -> jax.Array:
        return jnp.asarray(values, jnp.float32)

    gating = normaliser.phases
    return Predictor(
        network=network,
        style=style,
        input_mean=on_device(normaliser.inputs.mean),
        input_std=on_device(normaliser.inputs.std),
        output_mean=on_device(normaliser.outputs.mean),
        output_std=on_device(normaliser.outputs.std),
        gating_mean=None if gating is None else on_device(gating.mean),
        gating_std=None if gating is None else on_device(gating.std),
    )


def evaluate(predictor: Predictor, x: jax.Array, gating_input: jax.Array, *, norm: Norm = layer_norm) -> jax.Array:
    """Evaluates one frame (Mason 2018 Eq. 1 and 4, Mason 2022 Eq. 3 and 4); use `vmap` for many.

    Args:
        predictor: the network.
        x: [Dx] input in layout units.
        gating_input: [] radians for the exact spline, or the gating input [G] in layout units.
        norm: layer norm of a FiLM style: `layer_norm`, or `layer_norm_sample` as in the authors' training.

    Returns:
        [Dy] output in layout units.
    """
    if predictor.gating_mean is not None and predictor.gating_std is not None:
        gating_input = (gating_input - predictor.gating_mean) / predictor.gating_std
    return evaluate_at(predictor, x, coefficients(predictor.network, gating_input), norm=norm)


def evaluate_at(predictor: Predictor, x: jax.Array, blending: jax.Array, *, norm: Norm = layer_norm) -> jax.Array:
    """Evaluates one frame at given blending coefficients [K]: x [Dx] -> [Dy], both in layout units."""
    normalised = (x - predictor.input_mean) / predictor.input_std
    y = forward(predictor.network, predictor.style, blending, normalised, norm=norm)
    return y * predictor.output_std + predictor.output_mean
