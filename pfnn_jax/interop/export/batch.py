"""Builds the batched function that engines evaluate, and random rows to check it on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import jax
import numpy as np

from pfnn_jax.inference.predictor import Predictor, evaluate
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

    def one(x: jax.Array, gating_input: jax.Array, *film: jax.Array) -> jax.Array:
        style = FiLMStyle.from_vector(film[0]) if film else predictor.style
        return evaluate(replace(predictor, style=style), x, gating_input)

    if film_input:
        return lambda x, phase, style: jax.vmap(one)(x, phase, style)
    return lambda x, phase: jax.vmap(one)(x, phase)


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
