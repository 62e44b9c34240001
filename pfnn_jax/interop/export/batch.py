"""Builds the batched function that engines evaluate, and random rows to check it on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.inference.predictor import Predictor, evaluate, evaluate_at
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser

BatchFunction = Callable[..., jax.Array]
"""(x [B, Dx], phase [B] or [B, G]) -> y [B, Dy], in layout units; with a Film as input also (.., style [B, 4H])."""


def batch_function(predictor: Predictor, film_input: bool = False) -> BatchFunction:
    """Returns a predictor as a function of a batch, built from operations that every exchange format supports.

    Args:
        predictor: network, style and statistics, which become constants of the function.
        film_input: whether the style is a third argument [B, 4H], in the order scale 1, shift 1, scale 2, shift 2.
    """

    def one(x: jax.Array, blending: jax.Array, *film: jax.Array) -> jax.Array:
        own = replace(predictor, style=FiLMStyle.from_vector(film[0])) if film else predictor
        return evaluate_at(own, x, blending)

    def gated(x: jax.Array, phase: jax.Array, *film: jax.Array) -> jax.Array:
        own = replace(predictor, style=FiLMStyle.from_vector(film[0])) if film else predictor
        return evaluate(own, x, phase)

    def function(x: jax.Array, phase: jax.Array, *film: jax.Array) -> jax.Array:
        if predictor.network.gating is not None:
            return jax.vmap(gated)(x, phase, *film)
        return jax.vmap(one)(x, spline_weights(phase, predictor.network.num_control_points), *film)

    if film_input:
        return lambda x, phase, style: function(x, phase, style)
    return lambda x, phase: function(x, phase)


def spline_weights(phase: jax.Array, num_control_points: int) -> jax.Array:
    """Coefficients [B, K] of phases [B] in radians: `catmull_rom_basis` without gathering or scattering.

    A control point's weight depends on its distance from the phase alone, as a piecewise cubic (Mason 2018 Eq. 1).
    """
    knots = np.arange(num_control_points, dtype=np.float32)
    turns = phase[:, None] * (num_control_points / (2.0 * math.pi)) - knots[None]
    d = jnp.abs(turns - num_control_points * jnp.floor(turns / num_control_points + 0.5))
    near, far = (1.0 - d) * (1.0 + d - 1.5 * d * d), -0.5 * (d - 1.0) * (d - 2.0) * (d - 2.0)
    return jnp.where(d < 1.0, near, jnp.where(d < 2.0, far, 0.0))


def sample_rows(
    normaliser: Normaliser, layout: FrameLayout, num_rows: int, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Draws random float32 rows from a run's statistics: x [N, Dx] normal; phases uniform, or gating inputs normal."""
    generator = np.random.default_rng(seed)
    inputs, phases = normaliser.inputs, normaliser.phases
    x = inputs.mean + inputs.std * generator.normal(size=(num_rows, layout.input_size))
    if phases is None:
        phase = generator.uniform(0.0, 2.0 * math.pi, num_rows)
    else:
        phase = phases.mean + phases.std * generator.normal(size=(num_rows, layout.phase_size))
    return x.astype(np.float32), phase.astype(np.float32)


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """Returns the largest error over outputs [N, Dy], each relative to the largest magnitude of its column."""
    scale = np.maximum(np.abs(expected).max(axis=0), np.finfo(np.float32).tiny)
    return float((np.abs(found - expected) / scale).max())
