"""Style-cycled minibatches: every batch holds frames of one style, and the styles take turns (Mason 2018 Eq. 5)."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct


@struct.dataclass
class Batch:
    """Frames in normalised units; any leading axes."""

    x: jax.Array | np.ndarray  # [..., Dx]
    y: jax.Array | np.ndarray  # [..., Dy]
    phase: jax.Array | np.ndarray  # [...] radians


def steps_per_epoch(num_styles: int, num_frames: int, batch_size: int) -> int:
    """Steps in which every style's frames are seen once; a last incomplete batch is dropped.

    Raises:
        ValueError: if a style has fewer frames than a batch.
    """
    if num_frames < batch_size:
        raise ValueError(f"`batch_size` must be at most the {num_frames} frames of a style, got {batch_size}.")
    return num_styles * (num_frames // batch_size)


@partial(jax.jit, static_argnames=("num_styles", "num_frames", "batch_size"))
def epoch_order(key: jax.Array, epoch: jax.Array, num_styles: int, num_frames: int, batch_size: int) -> jax.Array:
    """The frames of every step of one epoch: each style shuffled anew, the styles in fixed turn.

    Step i of the epoch belongs to style i mod S.

    Args:
        key: the run's key; the epoch's key is folded from it, so that a resumed run repeats itself.
        epoch: [] epoch number.
        num_styles: S.
        num_frames: N frames of each style.
        batch_size: B.

    Returns:
        [steps, B] int32 frame indices.
    """
    keys = jax.random.split(jax.random.fold_in(key, epoch), num_styles)
    rounds = num_frames // batch_size
    order = jax.vmap(lambda k: jax.random.permutation(k, num_frames))(keys)[:, : rounds * batch_size]
    return order.reshape(num_styles, rounds, batch_size).swapaxes(0, 1).reshape(-1, batch_size).astype(jnp.int32)


def gather(data: Batch, style, frames) -> Batch:
    """Frames [..., B] of style [...] out of data [S, N, ...]; on the device or in host memory, as `data` is."""
    return Batch(x=data.x[style, frames], y=data.y[style, frames], phase=data.phase[style, frames])
