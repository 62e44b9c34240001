"""Benchmark of run time: one frame of one character, compared to plain NumPy."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.benchmarks.other_libraries import check_equal, is_installed, other_frames, torch_lookup
from pfnn_jax.benchmarks.timing import REST, Figure, Work, figure, interleave
from pfnn_jax.inference.lookup import NUM_SLICES, Lookup, evaluate_lookup, make_lookup
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style

CYCLE = 60
"""Frames per gait cycle: consecutive frames read neighbouring slices, as in a walk."""

CHECKED = 7
"""Frames on which other libraries are compared to ours before they are timed."""

LOOKUP_AIM = 1.3
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
        layers = [[layer for layer in s.network.layers if isinstance(layer, DenseLayer)] for s in lookup.slices]
        # Stored as [O, I], like the files of the released controllers.
        self.weights = [[np.array(layer.weights.T) for layer in network] for network in layers]
        self.biases = [[np.array(layer.biases) for layer in network] for network in layers]
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


def character_figures(
    sizes: NetworkConfig, rank: int, repetitions: int, num_frames: int, rest: float = REST
) -> list[Figure]:
    """Compares one frame of one character, by exact spline and by lookup, to plain NumPy, PyTorch and onnxruntime.

    Inputs and outputs are NumPy arrays, as in an application.
    """
    plain, styled = random_predictor(sizes), random_predictor(sizes, AdapterConfig("cp", rank))
    lookup, styled_lookup = (make_lookup(predictor, NUM_SLICES) for predictor in (plain, styled))
    exact = partial(jax.jit(evaluate), plain)
    others = {f"exact, {name}": frame for name, frame in other_frames(plain, np.float32(0)).items()}
    x, phases = frame_inputs(sizes, num_frames)
    for name, frame in others.items():
        check_equal(name, frame, exact, x, phases[:CHECKED])
    if is_installed("PyTorch"):
        others["lookup, PyTorch"] = torch_lookup(lookup)
        check_equal("lookup, PyTorch", others["lookup, PyTorch"], partial(evaluate_lookup, lookup), x, phases[:CHECKED])
    frames = {
        "NumPy": NumpyTable(lookup),
        "lookup": partial(evaluate_lookup, lookup),
        "exact": exact,
        "lookup with CP": partial(evaluate_lookup, styled_lookup),
        "exact with CP": partial(jax.jit(evaluate), styled),
        **others,
    }
    pairs = {"lookup": ("NumPy", "lookup, PyTorch"), "exact": tuple(name for name in others if "exact" in name)}
    section = "one character, one frame"
    return frame_figures(section, frames, sizes, repetitions, num_frames, rest, pairs, LOOKUP_AIM)


def frame_figures(
    section: str,
    frames: Mapping[str, Callable],
    sizes: NetworkConfig,
    repetitions: int,
    num_frames: int,
    rest: float,
    pairs: Mapping[str, Sequence[str]],
    aim: float,
) -> list[Figure]:
    """Returns the time of a frame by several functions, and the ratios of some to others in the same repetition.

    Args:
        section: of the figures.
        frames: functions (x, phase) -> y by name.
        sizes: of the network.
        repetitions, num_frames: number of measurements, and frames of each.
        rest: seconds of sleep before each measurement.
        pairs: for a name the names that it is compared to, where they are in `frames`.
        aim: largest allowed ratio of the first pair.
    """
    works = {name: walk(frame, sizes, num_frames) for name, frame in frames.items()}
    seconds = interleave(works, repetitions, rest=rest)
    times = [figure(section, name, 1e6 * value / num_frames, "us") for name, value in seconds.items()]
    compared = [(name, other) for name, others in pairs.items() for other in others if other in seconds]
    return times + [
        figure(section, f"{name} over {other}", seconds[name] / seconds[other], "x", at_most=None if index else aim)
        for index, (name, other) in enumerate(compared)
    ]


def frame_inputs(sizes: NetworkConfig, num_frames: int) -> tuple[np.ndarray, list[Any]]:
    """Returns an input x [Dx] and the phase of every frame of a walk: radians, or a gating input [G] that oscillates
    like local phases."""
    x = np.random.default_rng(0).normal(size=sizes.input_size).astype(np.float32)
    phases = [np.float32(2 * math.pi * (frame % CYCLE) / CYCLE) for frame in range(num_frames)]
    if sizes.phase_size:
        return x, [np.sin(phase + np.arange(sizes.phase_size, dtype=np.float32)) for phase in phases]
    return x, phases


def walk(evaluate_frame: Callable, sizes: NetworkConfig, num_frames: int) -> Work:
    """Returns the work of evaluating one character's frames in sequence, (x [Dx], phase) -> y, with NumPy arrays."""
    x, phases = frame_inputs(sizes, num_frames)

    def work():
        for phase in phases:
            np.asarray(evaluate_frame(x, phase))

    return work
