"""Benchmark of style transfer: the fast network, the optimisation, training of a network, and the parts of a command.

Sizes are those of Holden et al. 2017. Parameters are random and clips procedural, because times depend on neither.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.benchmarks.timing import Figure, Work, figure, interleave
from pfnn_jax.errors import check_at_least
from pfnn_jax.models.convolution import Convolution
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.autoencoder import MotionAutoencoder, config_of, init_autoencoder
from pfnn_jax.transfer.autoencoder_training import fit_statistics
from pfnn_jax.transfer.clip_rows import encode_clip, prepare_clip
from pfnn_jax.transfer.config import (
    AutoencoderConfig,
    OptimisationConfig,
    TransformationConfig,
    TransformationTrainingConfig,
)
from pfnn_jax.transfer.finish import finish_clip, hold_feet
from pfnn_jax.transfer.layout import HOLDEN2017, LAYOUT_FPS, WINDOW_FRAMES
from pfnn_jax.transfer.optimisation import optimise
from pfnn_jax.transfer.pairing import GaitClip, pair_by_gait
from pfnn_jax.transfer.run import TransferRun, TransferRunConfig
from pfnn_jax.transfer.transformation import TransformationNetwork, init_transformation
from pfnn_jax.transfer.transformation_training import apply_network, train_transformation

FAST_AIMS = {240: 12.0, 960: 40.0}
"""Largest allowed milliseconds of the fast network with projection, by number of frames (paper: 12 and 17 on a GPU)."""

OPTIMISATION_AIMS = {240: 1.0}
"""Largest allowed seconds of the optimisation, by number of frames (paper: 15.2 on a GPU)."""

TRAINING_AIM = 20.0
"""Largest allowed minutes of training for one style, as long as in the paper on a GPU."""

EPOCHS = 100
"""Epochs of training in the paper."""


@dataclass(frozen=True)
class TransferSizes:
    """Sizes of the benchmark of style transfer; the defaults are those of the paper.

    Attributes:
        frames: lengths of clips, at 60 frames per second.
        filters: F of the autoencoder.
        hidden: filters of the two hidden layers of the transformation network.
        width: frames in a filter.
        iterations, constraint_iterations: of the optimisation.
        minutes: of motion to train a transformation network on.
    """

    frames: tuple[int, ...] = (240, 480, 960)
    filters: int = 256
    hidden: int = 128
    width: int = 25
    iterations: int = 250
    constraint_iterations: int = 100
    minutes: float = 20.0

    def __post_init__(self):
        check_at_least(self, "filters", "hidden", "width", "iterations", "constraint_iterations")


IN_NUMPY = "NumPy"
"""Name of the form of the fast network that is not compiled."""


class FastTransfer(NamedTuple):
    """Everything that the fast network needs for one style."""

    network: TransformationNetwork
    autoencoder: MotionAutoencoder


def random_transfer(sizes: TransferSizes) -> FastTransfer:
    """Returns random parameters of the layout of the paper."""
    keys, columns = jax.random.split(jax.random.key(0)), HOLDEN2017.size
    network = init_transformation(TransformationConfig(sizes.hidden, sizes.width), columns, key=keys[0])
    return FastTransfer(network, init_autoencoder(AutoencoderConfig(sizes.filters, sizes.width), columns, key=keys[1]))


@jax.jit
def fast_transfer(parameters: FastTransfer, x: jax.Array) -> jax.Array:
    """Returns the result [T, D] of the fast network, projected onto the manifold, for normalised rows x [T, D]."""
    return parameters.autoencoder.project(parameters.network(x))


@jax.jit
def xla_transfer(parameters: FastTransfer, x: jax.Array) -> jax.Array:
    """Returns the same as `fast_transfer` by XLA's own convolutions, and by depooling before the decoder's."""
    encoder, (*layers, last) = parameters.autoencoder.encoder, parameters.network.layers
    for layer in layers:
        x = jax.nn.relu(_xla_convolve(x, layer.filters) + layer.bias[None])
    x = _xla_convolve(x, last.filters) + last.bias[None]
    value = _xla_convolve(x, encoder.filters) + encoder.bias[None]
    hidden = jax.nn.relu(jnp.maximum(value[0::2], value[1::2]))
    depooled = jnp.repeat(hidden / 2, 2, axis=0) - encoder.bias[None]
    return _xla_convolve(depooled, jnp.flip(encoder.filters, axis=0).swapaxes(1, 2))


def _xla_convolve(x: jax.Array, filters: jax.Array) -> jax.Array:
    return jax.lax.conv_general_dilated(x[None], filters, (1,), "SAME", dimension_numbers=("NWC", "WIO", "NWC"))[0]


class NumpyTransfer:
    """The same in plain NumPy, the baseline of the benchmark: each convolution is one product of all windows."""

    def __init__(self, parameters: FastTransfer):
        encoder = parameters.autoencoder.encoder
        self.layers = [_numpy_layer(layer) for layer in parameters.network.layers]
        self.encoder = _numpy_layer(encoder)
        self.decoder = np.array(jnp.flip(encoder.filters, axis=0).swapaxes(1, 2))

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Returns the result [T, D] for normalised rows x [T, D]."""
        for index, (filters, bias) in enumerate(self.layers):
            x = _numpy_convolve(x, filters) + bias
            x = np.maximum(x, 0.0) if index < len(self.layers) - 1 else x
        filters, bias = self.encoder
        value = _numpy_convolve(x, filters) + bias
        hidden = np.maximum(np.maximum(value[0::2], value[1::2]), 0.0)
        return _numpy_convolve(np.repeat(hidden / 2, 2, axis=0) - bias, self.decoder)


def _numpy_layer(layer: Convolution) -> tuple[np.ndarray, np.ndarray]:
    return np.array(layer.filters), np.array(layer.bias)


def _numpy_convolve(x: np.ndarray, filters: np.ndarray) -> np.ndarray:
    width, inputs, outputs = filters.shape
    padded = np.pad(x, ((width // 2, width - 1 - width // 2), (0, 0)))
    windows = np.concatenate([padded[tap : tap + len(x)] for tap in range(width)], axis=1)
    return windows @ filters.reshape(width * inputs, outputs)


def walking_clip(num_frames: int, style: str = "neutral") -> MotionClip:
    """Returns a procedural walk straight ahead of T frames, at 60 frames per second."""
    return synthesise(style, np.zeros(num_frames), np.ones(num_frames))[0]


def random_run(sizes: TransferSizes) -> TransferRun:
    """Returns a run in memory with a random autoencoder, on the skeleton of the procedural walkers."""
    autoencoder = random_transfer(sizes).autoencoder
    statistics = fit_statistics(encode_clip(walking_clip(WINDOW_FRAMES), HOLDEN2017), HOLDEN2017)
    skeleton = synthetic_skeleton()
    config = TransferRunConfig(HOLDEN2017.name, config_of(autoencoder), skeleton_to_json(skeleton))
    return TransferRun(Path("benchmark"), config, HOLDEN2017, skeleton, statistics, autoencoder, "")


def fast_works(sizes: TransferSizes) -> dict[int, dict[str, Work]]:
    """Returns, by number of frames, the fast network with projection in three forms: ours, XLA's, NumPy's."""
    parameters = random_transfer(sizes)
    in_numpy = NumpyTransfer(parameters)
    works: dict[int, dict[str, Work]] = {}
    for num_frames in sizes.frames:
        x = np.random.default_rng(0).normal(size=(num_frames, HOLDEN2017.size)).astype(np.float32)
        works[num_frames] = {
            "ours": partial(fast_transfer, parameters, jnp.asarray(x)),
            "XLA's convolutions": partial(xla_transfer, parameters, jnp.asarray(x)),
            IN_NUMPY: partial(in_numpy, x),
        }
    return works


def time_forms(works: Mapping[str, Work], repetitions: int) -> dict[str, np.ndarray]:
    """Returns the seconds [n] of the forms of a network: the compiled ones interleaved, then NumPy's by itself.

    The threads of NumPy's matrix products wait for the next one without giving up their cores. Interleaved with them,
    compiled forms take twice as long.
    """
    compiled = {name: work for name, work in works.items() if name != IN_NUMPY}
    return {**interleave(compiled, repetitions), **interleave({IN_NUMPY: works[IN_NUMPY]}, repetitions)}


def applied_works(sizes: TransferSizes) -> dict[int, Work]:
    """Returns, by number of frames, what a command does with a network: from rows to rows, with the content projected.

    It costs one projection more than the paper's form, because only the change of the projection is added to the
    content.
    """
    run, network = random_run(sizes), random_transfer(sizes).network
    rows = {num_frames: encode_clip(walking_clip(num_frames), HOLDEN2017) for num_frames in sizes.frames}
    return {num_frames: partial(apply_network, run, network, own) for num_frames, own in rows.items()}


def fast_figures(sizes: TransferSizes, repetitions: int) -> list[Figure]:
    """Measures the fast network with projection, next to XLA's convolutions and NumPy, and as a command applies it."""
    section, figures = "style transfer, fast network with projection", []
    applied = applied_works(sizes)
    for num_frames, works in fast_works(sizes).items():
        seconds = time_forms({**works, "from rows to rows": applied[num_frames]}, repetitions)
        aim = FAST_AIMS.get(num_frames)
        figures += [
            figure(section, f"{num_frames} frames, {name}", 1e3 * value, "ms", at_most=aim if name == "ours" else None)
            for name, value in seconds.items()
        ]
        naive = seconds["XLA's convolutions"] / seconds["ours"]
        figures.append(figure(section, f"{num_frames} frames, times faster than XLA's", naive, "x"))
    return figures


def optimisation_works(sizes: TransferSizes) -> dict[int, Work]:
    """Returns the optimisation of a clip towards the style of a clip of four seconds, by number of frames."""
    run = random_run(sizes)
    settings = OptimisationConfig(iterations=sizes.iterations, constraint_iterations=sizes.constraint_iterations)
    style = [encode_clip(walking_clip(WINDOW_FRAMES, "zombie"), HOLDEN2017)]
    return {
        num_frames: partial(
            optimise, run, encode_clip(walking_clip(num_frames), HOLDEN2017), style, settings, key=jax.random.key(0)
        )
        for num_frames in sizes.frames
    }


def optimisation_figures(sizes: TransferSizes, repetitions: int) -> list[Figure]:
    """Measures the optimisation, after compilation."""
    section = f"style transfer, optimisation, {sizes.iterations} + {sizes.constraint_iterations} iterations"
    works = {str(num_frames): work for num_frames, work in optimisation_works(sizes).items()}
    seconds = interleave(works, repetitions)
    return [
        figure(section, f"{name} frames", value, "s", at_most=OPTIMISATION_AIMS.get(int(name)))
        for name, value in seconds.items()
    ]


def training_figures(sizes: TransferSizes) -> list[Figure]:
    """Measures the steps of one epoch of training for one style, and says what 100 epochs would take.

    The minutes of 100 epochs are extrapolated from the median step of one epoch, without compilation and without the
    loss on held-out clips.
    """
    run, clip_frames = random_run(sizes), 4 * WINDOW_FRAMES
    count = max(1, round(sizes.minutes * 60 * LAYOUT_FPS / clip_frames))
    rows = encode_clip(walking_clip(clip_frames), HOLDEN2017)
    contents = [GaitClip(rows, "walk")] * count
    styles = [GaitClip(encode_clip(walking_clip(WINDOW_FRAMES, "zombie"), HOLDEN2017), "walk")]
    config = TransformationTrainingConfig(
        network=TransformationConfig(sizes.hidden, sizes.width), epochs=1, held_out=0.0, steps_per_dispatch=1
    )
    reports: list[tuple[float, int]] = []
    train_transformation(
        run,
        contents,
        styles,
        pair_by_gait(contents, styles, HOLDEN2017),
        config,
        progress_callback=lambda progress: reports.append((time.perf_counter(), progress.steps)),
    )
    times, steps = np.array([at for at, _ in reports]), reports[-1][1]
    step = np.diff(times) if len(times) > 1 else np.array([np.nan])
    section = f"style transfer, training on {sizes.minutes:g} minutes"
    minutes = EPOCHS * steps * step / 60
    return [
        figure(section, f"step of {config.batch_size} windows", step, "s"),
        figure(section, "one epoch", steps * step, "s"),
        figure(section, f"{EPOCHS} epochs, extrapolated", minutes, "min", at_most=TRAINING_AIM),
    ]


def command_figures(sizes: TransferSizes, repetitions: int) -> list[Figure]:
    """Measures what a command does before and after the network: the clip to rows, rows to the clip, planted feet."""
    num_frames = sizes.frames[0]
    section, skeleton = f"style transfer, clip of {num_frames} frames", synthetic_skeleton()
    clip = walking_clip(num_frames)
    rows = encode_clip(clip, HOLDEN2017)
    works: dict[str, Work] = {
        "retarget and encode": lambda: encode_clip(prepare_clip(clip, skeleton), HOLDEN2017),
        "decode and fit rotations": lambda: finish_clip(rows, clip, skeleton, HOLDEN2017, foot_ik=False).rotations,
        "hold feet": lambda: hold_feet(clip, clip).rotations,
    }
    seconds = interleave(works, repetitions)
    return [figure(section, name, 1e3 * value, "ms") for name, value in seconds.items()]
