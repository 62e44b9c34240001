"""Benchmark of the system of Mason 2022: training, one character, FiLM generator, local phases, preparation."""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.benchmarks.other_libraries import check_equal, other_frames
from pfnn_jax.benchmarks.preparation import Prepared, measure_preparation, write_synthetic
from pfnn_jax.benchmarks.runtime import CHECKED, elu, frame_figures, frame_inputs, random_predictor
from pfnn_jax.benchmarks.timing import REST, Figure, figure, interleave
from pfnn_jax.benchmarks.training import compare_steps
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.models.config import AdapterConfig, GeneratorConfig, NetworkConfig
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.labels.local_phase import clip_local_phases
from pfnn_jax.motion.labels.sinusoid import fit_sinusoids
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.training.config import EXPERTS, num_clip_columns

STEP_AIMS = {256: 10.0}
"""Required speed-up over per-sample weights, by batch size."""

CHARACTER_AIM = 1.2
"""Largest allowed time of a frame, relative to plain NumPy with blended experts."""

FIT_AIM = 50_000.0
"""Required windows per second of the sinusoid fit."""

PREPARATION_AIM = 20_000.0
"""Required frames per second from BVH files to a prepared dataset."""

MEMORY_AIM = 4.0
"""Largest allowed memory of preparation, in gigabytes."""

FIT_WINDOW = 31
"""Frames per window of the sinusoid fit, at 60 fps."""

BONES = 4
"""Number of end effectors, each with a local phase."""

LAYOUT = "mason2022"


def lpn_sizes(num_joints: int, hidden: int) -> NetworkConfig:
    """Returns the sizes of an LPN: 348 inputs, 342 outputs and 8 experts at 25 joints."""
    layout = LAYOUTS[LAYOUT](num_joints)
    return NetworkConfig(layout.input_size, layout.output_size, hidden, EXPERTS, phase_size=layout.phase_size)


def lpn_step_figures(sizes: NetworkConfig, batch_size: int, repetitions: int, num_steps: int) -> list[Figure]:
    """Compares a training step of an LPN with a bank of FiLM styles to the per-sample formulation."""
    section, aim = f"LPN training step, batch {batch_size}", STEP_AIMS.get(batch_size)
    return compare_steps(section, sizes, AdapterConfig("film"), 0.0, batch_size, repetitions, num_steps, aim)


class NumpyExperts:
    """An LPN with FiLM written in plain NumPy, the baseline of the benchmark.

    Args:
        predictor: the network and style.
        blended: whether to blend the experts into one network and compute three matrix products. Otherwise the input is
            scaled by every coefficient, and each of the three products covers all experts. Both compute the same
            function.
    """

    def __init__(self, predictor: Predictor, blended: bool = True):
        self.blended = blended
        network, film = predictor.network, predictor.style
        assert network.gating is not None and isinstance(film, FiLMStyle)
        layers = [layer for layer in network.layers if isinstance(layer, BlendedLayer)]
        self.shapes = [layer.weights.shape[1:] for layer in layers]
        self.experts = [np.array(layer.weights).reshape(len(layer.weights), -1) for layer in layers]
        self.biases = [np.array(layer.biases) for layer in layers]
        self.gating = [(np.array(layer.weights), np.array(layer.biases)) for layer in network.gating.layers]
        self.scale, self.shift = np.array(film.scale), np.array(film.shift)
        p = predictor
        values = (p.input_mean, p.input_std, p.output_mean, p.output_std, p.gating_mean, p.gating_std)
        self.statistics = [np.array(value) for value in values]

    def __call__(self, x: np.ndarray, gating_input: np.ndarray) -> np.ndarray:
        """Returns outputs y [Dy] of inputs x [Dx] at the gating input [G], all in layout units."""
        input_mean, input_std, output_mean, output_std, phase_mean, phase_std = self.statistics
        g = self._gate((gating_input - phase_mean) / phase_std)
        h = (x - input_mean) / input_std
        for index in range(2):
            f = self._layer(index, g, h)
            f = f - f.mean()
            h = elu(self.scale[index] * f / np.sqrt((f * f).mean() + 1e-8) + self.shift[index])
        return self._layer(2, g, h) * output_std + output_mean

    def _gate(self, gating_input: np.ndarray) -> np.ndarray:
        h = gating_input
        for index, (weights, biases) in enumerate(self.gating):
            h = h @ weights + biases
            h = elu(h) if index < 2 else np.exp(h - h.max())
        return h / h.sum()

    def _layer(self, index: int, g: np.ndarray, h: np.ndarray) -> np.ndarray:
        inputs, outputs = self.shapes[index]
        if self.blended:
            product = h @ (g @ self.experts[index]).reshape(inputs, outputs)
        else:
            product = (g[:, None] * h).reshape(-1) @ self.experts[index].reshape(-1, outputs)
        return product + g @ self.biases[index]


def lpn_character_figures(sizes: NetworkConfig, repetitions: int, num_frames: int, rest: float = REST) -> list[Figure]:
    """Compares one frame of one character, by an LPN with FiLM, to plain NumPy (two forms), PyTorch and onnxruntime.

    Inputs and outputs are NumPy arrays, as in an application.
    """
    predictor = random_predictor(sizes, AdapterConfig("film"))
    x, phases = frame_inputs(sizes, num_frames)
    ours, others = partial(jax.jit(evaluate), predictor), other_frames(predictor, phases[0])
    frames = {
        "NumPy, experts blended": NumpyExperts(predictor),
        "NumPy, products over all experts": NumpyExperts(predictor, blended=False),
        **others,
    }
    for name, frame in frames.items():
        check_equal(name, frame, ours, x, phases[:CHECKED])
    section = "LPN with FiLM, one character, one frame"
    pairs = {"ours": tuple(frames)}
    return frame_figures(section, {**frames, "ours": ours}, sizes, repetitions, num_frames, rest, pairs, CHARACTER_AIM)


def generator_figures(config: GeneratorConfig, num_clips: int, repetitions: int) -> list[Figure]:
    """Measures clips per second through the FiLM generator, without and with the gradient of its parameters."""
    section = f"FiLM generator, {num_clips} clips at once"
    generator = FiLMGenerator.init(config, key=jax.random.key(0))
    clips = jax.random.normal(jax.random.key(1), (num_clips, config.clip_frames, config.features))

    @jax.jit
    def styles(generator, clips):
        return jax.vmap(generator)(clips)

    def size(generator, clips):
        return sum(jnp.mean(leaf**2) for leaf in jax.tree.leaves(styles(generator, clips)))

    works = {"clips": partial(styles, generator, clips)}
    works["clips, with gradient"] = partial(jax.jit(jax.grad(size)), generator, clips)
    seconds = interleave(works, repetitions)
    return [figure(section, name, num_clips / value, "1/s") for name, value in seconds.items()]


def local_phase_figures(seconds_of_motion: float, repetitions: int) -> list[Figure]:
    """Measures windows per second of the sinusoid fit alone, and from a clip to its phases (four windows per frame)."""
    section = "local phases"
    clip = synthetic_clips("neutral", seconds_of_motion, clip_seconds=seconds_of_motion)[0].clip
    frames = np.arange(clip.num_frames + FIT_WINDOW - 1) / clip.fps
    rng = np.random.default_rng(0)
    waves = [np.sin(2 * np.pi * np.cumsum(rng.uniform(0.8, 1.6, len(frames))) / clip.fps) for _ in range(BONES)]
    sources = [wave + 0.1 * rng.normal(size=len(wave)) for wave in waves]
    windows = np.concatenate([np.lib.stride_tricks.sliding_window_view(source, FIT_WINDOW) for source in sources])
    works = {
        "sinusoid fit": lambda: fit_sinusoids(windows, clip.fps).phase,
        "clip to local phases": lambda: clip_local_phases(clip),
    }
    seconds = interleave(works, repetitions)
    return [
        figure(section, "sinusoid fit", len(windows) / seconds["sinusoid fit"], "windows/s", at_least=FIT_AIM),
        figure(
            section,
            "clip to local phases",
            BONES * clip.num_frames / seconds["clip to local phases"],
            "windows/s",
        ),
    ]


def lpn_preparation_figures(mocap: Path | None, seconds_per_style: float, repetitions: int) -> list[Figure]:
    """Measures frames per second from BVH files to a prepared dataset of layout `mason2022`, and the peak memory.

    Frames are counted at 60 fps with mirror images; memory is the sum over all processes. The data is all of
    `bandai-namco-2` if it is there, and procedural walks otherwise.
    """
    with tempfile.TemporaryDirectory() as folder:
        if mocap is not None and (mocap / "bandai-namco-2").is_dir():
            name, files = "bandai-namco-2", list_clips(mocap / "bandai-namco-2")
        else:
            name, files = "synthetic clips", write_synthetic(Path(folder), seconds_per_style)
        found = [measure_preparation(files, LAYOUT) for _ in range(repetitions)]
    return preparation_rows(f"{name}: {len(files)} clips", found)


def preparation_rows(name: str, found: list[Prepared]) -> list[Figure]:
    """Returns the figures of repeated preparations."""
    section = f"preparation under {LAYOUT}, BVH to disk"
    rates = np.array([one.rows / one.seconds for one in found])
    memory = np.array([one.peak_bytes / 1e9 for one in found])
    return [
        figure(section, name, rates, "frames/s", at_least=PREPARATION_AIM),
        figure(section, "peak memory", memory, "GB", at_most=MEMORY_AIM),
    ]


def generator_config(num_joints: int, hidden: int, filters: int, width: int) -> GeneratorConfig:
    """Returns the generator configuration for a character of J joints and a network of H hidden units."""
    features = num_clip_columns(LAYOUTS[LAYOUT](num_joints))
    return GeneratorConfig(features, filters=filters, hidden=width, film_hidden=hidden)
