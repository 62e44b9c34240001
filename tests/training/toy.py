"""A learnable toy problem: a few styles whose outputs depend on the phase, the input and the style."""

from __future__ import annotations

import jax
import numpy as np

from pfnn_jax.models.config import NetworkConfig
from pfnn_jax.models.network import Network, init_network
from pfnn_jax.motion.datasets.splits import row_windows
from pfnn_jax.motion.features.layout import LAYOUTS, FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.training.data import Batch, Draw, Rows

INPUTS, OUTPUTS, HIDDEN = 5, 4, 16
STYLES = ("angry", "old", "proud")
LAYOUT = FrameLayout(
    name="toy",
    num_joints=1,
    fps=60.0,
    length_unit=1.0,
    time_unit=1.0,
    phase_unit=1.0,
    yaw_unit=1.0,
    inputs=(("trajectory", 2), ("joint_position", 3)),
    outputs=(("joint_position", 3), ("phase_change", 1)),
)


def toy_data(num_styles: int = len(STYLES), num_frames: int = 24, seed: int = 0) -> Batch:
    """[S, N, ...] NumPy frames: one linear map for all styles, turned by the phase, and a posture of each style."""
    rng = np.random.default_rng(seed)
    mapping = rng.normal(size=(INPUTS, OUTPUTS)) / INPUTS**0.5
    posture = rng.normal(size=(num_styles, 1, OUTPUTS))
    x = rng.normal(size=(num_styles, num_frames, INPUTS))
    phase = rng.uniform(0, 2 * np.pi, (num_styles, num_frames))
    y = np.sin(phase)[..., None] * (x @ mapping) + np.cos(phase)[..., None] * posture
    return Batch(x.astype(np.float32), y.astype(np.float32), phase.astype(np.float32))


def toy_rows(num_frames: tuple[int, ...] = (24, 24, 24), seed: int = 0) -> Rows:
    """Returns the frames of `toy_data`, one style after another, each style with its own number of frames."""
    data = toy_data(len(num_frames), max(num_frames), seed)
    x, y, phase = (np.concatenate([a[s, :n] for s, n in enumerate(num_frames)]) for a in (data.x, data.y, data.phase))
    return Rows(STYLES[: len(num_frames)], (Batch(x, y, phase),), np.cumsum([0, *num_frames]), LAYOUT)


def body_rows(layout: str = "mason2022", num_frames: tuple[int, ...] = (300, 30, 260), seed: int = 0) -> Rows:
    """Random normalised rows of three joints under a layout of 2022, with windows, parents and statistics."""
    found, rng, total = LAYOUTS[layout](3), np.random.default_rng(seed), sum(num_frames)
    first = np.cumsum([0, *num_frames])
    windows = [row_windows(np.arange(n)) + np.array([row, 0]) for n, row in zip(num_frames, first, strict=False)]
    x, y = (rng.normal(size=(total, n)).astype(np.float32) for n in (found.input_size, found.output_size))
    size = (total, found.phase_size) if found.phase_size else (total,)
    mean = rng.normal(size=found.output_size).astype(np.float32)
    phase = rng.uniform(0, 6, size).astype(np.float32)
    outputs = Statistics(mean, rng.uniform(0.5, 2.0, found.output_size).astype(np.float32))
    inputs = Statistics(np.zeros(found.input_size, np.float32), np.ones(found.input_size, np.float32))
    return Rows(
        styles=STYLES[: len(num_frames)],
        parts=(Batch(x, y, phase),),
        first_row=first,
        layout=found,
        normaliser=Normaliser(inputs, outputs),
        windows=np.concatenate(windows).astype(np.int32),
        first_window=np.cumsum([0, *map(len, windows)]),
        parents=np.array([-1, 0, 1]),
    )


def take(data: Batch, draw: Draw) -> Batch:
    """Rows of a draw, without clips."""
    return jax.tree.map(lambda leaf: leaf[draw.rows], data)


def toy_style(style: int = 0, num_frames: int = 24, seed: int = 0) -> Batch:
    """[N, ...] frames of one style."""
    return jax.tree.map(lambda leaf: leaf[style], toy_data(num_frames=num_frames, seed=seed))


def toy_network(seed: int = 0) -> Network:
    """A small fresh network for the toy frames."""
    return init_network(NetworkConfig(INPUTS, OUTPUTS, HIDDEN), key=jax.random.key(seed))


def assert_bitwise(first: object, second: object) -> None:
    """Two trees of one structure whose arrays agree in every bit."""
    leaves, structure = jax.tree.flatten(first)
    others, other_structure = jax.tree.flatten(second)
    assert structure == other_structure
    for one, other in zip(leaves, others, strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


def on_host(tree):
    """Copies of a tree's arrays, which donation cannot take away."""
    return jax.tree.map(np.array, tree)
