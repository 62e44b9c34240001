"""Benchmark of run time: one frame of one character, compared to plain NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.benchmarks.timing import Figure, Work, figure, interleave
from pfnn_jax.inference.lookup import NUM_SLICES, Lookup, evaluate_lookup, make_lookup
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style

CYCLE = 60
"""Frames per gait cycle: consecutive frames read neighbouring slices, as in a walk."""

LOOKUP_AIM = 2.0
"""Largest allowed time of the lookup, relative to plain NumPy."""


def random_predictor(sizes: NetworkConfig, adapter: AdapterConfig | None = None) -> Predictor:
    """Returns a freshly initialised network with unit statistics, and with a fresh adapter if one is configured."""
    key = jax.random.key(0)
    style = None if adapter is None else init_style(adapter, sizes, key=key)
    widths = [width for width in (sizes.input_size, sizes.output_size, sizes.phase_size) if width]
    statistics = [values for width in widths for values in (jnp.zeros(width), jnp.ones(width))]
    return Predictor(init_network(sizes, key=key), style, *statistics)


class NumpyTable:
    """The lookup written in plain NumPy, the baseline: 50 blended networks, three matrix products per frame."""

    def __init__(self, lookup: Lookup):
        layers = [[layer for layer in s.network.layers if isinstance(layer, BlendedLayer)] for s in lookup.slices]
        # Stored as [O, I], like the files of the released controllers.
        self.weights = [[np.array(layer.weights[0].T) for layer in network] for network in layers]
        self.biases = [[np.array(layer.biases[0]) for layer in network] for network in layers]
        p = lookup.predictor
        self.statistics = [np.array(v) for v in (p.input_mean, p.input_std, p.output_mean, p.output_std)]

    def __call__(self, x: np.ndarray, phase: float) -> np.ndarray:
        """Returns outputs y [Dy] of inputs x [Dx] at a phase in radians, both in layout units."""
        slices = len(self.weights)
        index = math.floor(phase * slices / (2 * math.pi) + 0.5) % slices
        (w0, w1, w2), (b0, b1, b2) = self.weights[index], self.biases[index]
        input_mean, input_std, output_mean, output_std = self.statistics
        h = elu(w0 @ ((x - input_mean) / input_std) + b0)
        h = elu(w1 @ h + b1)
        return (w2 @ h + b2) * output_std + output_mean


def elu(x: np.ndarray) -> np.ndarray:
    """Returns the exponential linear unit of x, in NumPy."""
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


def character_figures(sizes: NetworkConfig, rank: int, repetitions: int, num_frames: int) -> list[Figure]:
    """Compares one frame of one character, by exact spline and by lookup, to the lookup in plain NumPy.

    Inputs and outputs are NumPy arrays, as in an application.
    """
    section = "one character, one frame"
    plain, styled = random_predictor(sizes), random_predictor(sizes, AdapterConfig("cp", rank))
    lookup, styled_lookup = (make_lookup(predictor, NUM_SLICES) for predictor in (plain, styled))
    works = {
        "NumPy": NumpyTable(lookup),
        "lookup": partial(evaluate_lookup, lookup),
        "exact": partial(jax.jit(evaluate), plain),
        "lookup with CP": partial(evaluate_lookup, styled_lookup),
        "exact with CP": partial(jax.jit(evaluate), styled),
    }
    works = {name: walk(evaluate_frame, sizes.input_size, num_frames) for name, evaluate_frame in works.items()}
    seconds = interleave(works, repetitions)
    times = [figure(section, name, 1e6 * value / num_frames, "us") for name, value in seconds.items()]
    ratio = figure(section, "lookup over NumPy", seconds["lookup"] / seconds["NumPy"], "x", at_most=LOOKUP_AIM)
    return [*times, ratio]


def walk(evaluate_frame: Callable, input_size: int, num_frames: int, phase_size: int = 0) -> Work:
    """Returns the work of evaluating one character's frames in sequence, with NumPy inputs and outputs.

    Args:
        evaluate_frame: computes one frame: (x [Dx], phase) -> y.
        input_size: Dx.
        num_frames: length of the walk.
        phase_size: G, size of a gating input that oscillates like local phases; 0 for a scalar phase in radians.
    """
    x = np.random.default_rng(0).normal(size=input_size).astype(np.float32)
    phases = [np.float32(2 * math.pi * (frame % CYCLE) / CYCLE) for frame in range(num_frames)]
    if phase_size:
        phases = [np.sin(phase + np.arange(phase_size, dtype=np.float32)) for phase in phases]

    def work():
        for phase in phases:
            np.asarray(evaluate_frame(x, phase))

    return work
