"""Speed at run time: one character beside plain NumPy, and preparation of motion capture."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

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
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.datasets.labelled import load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.synthetic.walks import PRETRAINING_STYLES, synthetic_clips

CYCLE = 60
"""Frames of one gait cycle: consecutive frames read neighbouring slices, as in a walk."""

LOOKUP_AIM = 2.0
"""Times of plain NumPy that the lookup may take."""

PREPARATION_AIM = 20_000.0
"""Frames per second from BVH to features."""


def random_predictor(sizes: NetworkConfig, adapter: AdapterConfig | None = None) -> Predictor:
    """A fresh network with unit statistics, and a fresh adapter where one is described."""
    key = jax.random.key(0)
    style = None if adapter is None else init_style(adapter, sizes.hidden, sizes.num_control_points, key=key)
    widths = [width for width in (sizes.input_size, sizes.output_size, sizes.phase_size) if width]
    statistics = [values for width in widths for values in (jnp.zeros(width), jnp.ones(width))]
    return Predictor(init_network(sizes, key=key), style, *statistics)


class NumpyTable:
    """The lookup as one writes it without a library: 50 blended networks, three products a frame."""

    def __init__(self, lookup: Lookup):
        layers = [[layer for layer in s.network.layers if isinstance(layer, BlendedLayer)] for s in lookup.slices]
        # Stored [O, I], as the released controllers' files are.
        self.weights = [[np.array(layer.weights[0].T) for layer in network] for network in layers]
        self.biases = [[np.array(layer.biases[0]) for layer in network] for network in layers]
        p = lookup.predictor
        self.statistics = [np.array(v) for v in (p.input_mean, p.input_std, p.output_mean, p.output_std)]

    def __call__(self, x: np.ndarray, phase: float) -> np.ndarray:
        """x [Dx] at a phase in radians -> y [Dy], both in layout units."""
        slices = len(self.weights)
        index = math.floor(phase * slices / (2 * math.pi) + 0.5) % slices
        (w0, w1, w2), (b0, b1, b2) = self.weights[index], self.biases[index]
        input_mean, input_std, output_mean, output_std = self.statistics
        h = _elu(w0 @ ((x - input_mean) / input_std) + b0)
        h = _elu(w1 @ h + b1)
        return (w2 @ h + b2) * output_std + output_mean


def _elu(x: np.ndarray) -> np.ndarray:
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


def character_figures(sizes: NetworkConfig, rank: int, repetitions: int, num_frames: int) -> list[Figure]:
    """One frame of one character: exact spline and lookup, beside the lookup's three products in NumPy.

    Inputs and outputs are NumPy arrays, as an application holds them.
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
    """Work of one character's frames, one after another: (x [Dx] NumPy, phase) -> y, fetched as a NumPy array.

    Args:
        evaluate_frame: of one frame.
        input_size: Dx.
        num_frames: of the walk.
        phase_size: G numbers that go round together, as local phases do; 0 for a scalar phase in radians.
    """
    x = np.random.default_rng(0).normal(size=input_size).astype(np.float32)
    phases = [np.float32(2 * math.pi * (frame % CYCLE) / CYCLE) for frame in range(num_frames)]
    if phase_size:
        phases = [np.sin(phase + np.arange(phase_size, dtype=np.float32)) for phase in phases]

    def work():
        for phase in phases:
            np.asarray(evaluate_frame(x, phase))

    return work


def preparation_figures(mocap: Path | None, seconds_per_style: float, repetitions: int) -> list[Figure]:
    """Frames per second from BVH files to features: reading, 60 fps, phase labels, kinematics, windows.

    Counted are frames at 60 fps, mirrored ones included.
    """
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        figures.append(
            _prepare_figure("synthetic clips", write_synthetic(Path(folder), seconds_per_style), repetitions)
        )
    for name in ("bandai-namco-2", "pfnn") if mocap is not None else ():
        if mocap is not None and (mocap / name).is_dir():
            figures.append(_prepare_figure(name, list_clips(mocap / name)[:24], repetitions))
    return figures


def write_synthetic(folder: Path, seconds_per_style: float) -> list[ClipFile]:
    """One procedural walk of each pretraining style as a BVH file, without labels beside it."""
    files = []
    for style in PRETRAINING_STYLES:
        clip = synthetic_clips(style, seconds_per_style, clip_seconds=seconds_per_style)[0].clip
        write_bvh(folder / f"{style}.bvh", clip)
        files.append(ClipFile(folder / f"{style}.bvh", style))
    return files


def prepare_clips(files: list[ClipFile]) -> int:
    """Features of every clip and its mirror image, not kept: the number of rows."""
    rows = 0
    for file in files:
        try:
            labelled = load_labelled(file)
        except NoGaitError:
            continue
        clip = labelled.clip
        layout = LAYOUTS["mason2018"](clip.skeleton.num_joints)
        rows += len(clip_features(clip, layout, labelled.labels).frames)
        if labelled.symmetric:
            rows += len(clip_features(mirror_clip(clip), layout, mirror_phase(labelled.labels)).frames)
    return rows


def _prepare_figure(name: str, files: list[ClipFile], repetitions: int) -> Figure:
    rows = prepare_clips(files)
    seconds = interleave({name: lambda: prepare_clips(files)}, repetitions, warm_up=False)[name]
    section = "preparation, BVH to features"
    return figure(section, f"{name}: {len(files)} clips", rows / seconds, "frames/s", at_least=PREPARATION_AIM)
