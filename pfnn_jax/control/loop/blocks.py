"""A layout's blocks in JAX: reading them out of y, and writing x from them."""

from __future__ import annotations

from collections.abc import Mapping

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.ground import to_local
from pfnn_jax.control.loop.state import ROOT, STRIDE, CharacterState
from pfnn_jax.motion.features.layout import FrameLayout

TRAJECTORY = tuple(f"trajectory_{kind}_{axis}" for kind in ("position", "direction") for axis in "xz")
"""Names of the trajectory's blocks, one number per sample each."""


def read_block(layout: FrameLayout, y: jax.Array, name: str, width: int) -> jax.Array:
    """A block of y [Dy] as [N, width], in layout units."""
    return y[layout.output_slice(name)].reshape(-1, width)


def read_samples(layout: FrameLayout, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Positions [6, 2] in metres and directions [6, 2], not of length 1, of the trajectory samples of y [Dy]."""
    samples = jnp.stack([y[layout.output_slice(name)] for name in TRAJECTORY], -1)
    return samples[:, :2] * layout.length_unit, samples[:, 2:]


def trajectory_blocks(layout: FrameLayout, state: CharacterState) -> dict[str, jax.Array]:
    """The trajectory's blocks of x, in layout units relative to this root."""
    root, facing = state.positions[ROOT], state.directions[ROOT]
    positions = to_local(state.positions[::STRIDE] - root[None], facing) / layout.length_unit
    directions = to_local(state.directions[::STRIDE], facing)
    return dict(zip(TRAJECTORY, (*positions.T, *directions.T), strict=True))


def write_input(layout: FrameLayout, blocks: Mapping[str, jax.Array]) -> jax.Array:
    """x [Dx] from its blocks, each of any shape, whether they stand one after another or interleaved."""
    columns = np.arange(layout.input_size)
    order = np.concatenate([columns[layout.input_slice(name)] for name in layout.input_blocks])
    return jnp.concatenate([blocks[name].reshape(-1) for name in layout.input_blocks])[np.argsort(order)]
