"""A learnable toy problem: a few styles whose outputs depend on the phase, the input and the style."""

from __future__ import annotations

import jax
import numpy as np

from pfnn_jax.models.network import Network, NetworkConfig, init_network
from pfnn_jax.training.batches import Batch

INPUTS, OUTPUTS, HIDDEN = 5, 4, 16
STYLES = ("angry", "old", "proud")


def toy_data(num_styles: int = len(STYLES), num_frames: int = 24, seed: int = 0) -> Batch:
    """[S, N, ...] NumPy frames: one linear map for all styles, turned by the phase, and a posture of each style."""
    rng = np.random.default_rng(seed)
    mapping = rng.normal(size=(INPUTS, OUTPUTS)) / INPUTS**0.5
    posture = rng.normal(size=(num_styles, 1, OUTPUTS))
    x = rng.normal(size=(num_styles, num_frames, INPUTS))
    phase = rng.uniform(0, 2 * np.pi, (num_styles, num_frames))
    y = np.sin(phase)[..., None] * (x @ mapping) + np.cos(phase)[..., None] * posture
    return Batch(x.astype(np.float32), y.astype(np.float32), phase.astype(np.float32))


def toy_style(style: int = 0, num_frames: int = 24, seed: int = 0) -> Batch:
    """[N, ...] frames of one style."""
    return jax.tree.map(lambda leaf: leaf[style], toy_data(num_frames=num_frames, seed=seed))


def toy_network(seed: int = 0) -> Network:
    """A small fresh network for the toy frames."""
    return init_network(NetworkConfig(INPUTS, OUTPUTS, HIDDEN), jax.random.key(seed))


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
