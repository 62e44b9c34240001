"""Vectors in JAX with gradients that stay finite: interpolation, length and direction.

Rotation on the ground is in `pfnn_jax.motion.ground`.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

SMALL = 1e-6
"""A shorter vector has no direction."""


def lerp(old: jax.Array, new: jax.Array, share: jax.Array | np.ndarray | float) -> jax.Array:
    """Interpolates linearly by a share; all arguments have the same rank, or the share is a number."""
    return old + share * (new - old)


def to_3d(ground: jax.Array) -> jax.Array:
    """Returns a point on the ground [2] (x, z) as [3], at height 0."""
    return jnp.stack([ground[0], jnp.zeros_like(ground[0]), ground[1]])


def smoothstep(share: jax.Array) -> jax.Array:
    """Returns the smoothstep of shares [...] in [0, 1]."""
    return share * share * (3.0 - 2.0 * share)


def running_sum(steps: jax.Array) -> jax.Array:
    """Returns the sums [N, D] of the first 1 to N steps [N, D], as one product: for a crowd faster than `cumsum`."""
    return jnp.matmul(np.tri(len(steps), dtype=steps.dtype), steps, precision="highest")


def length(v: jax.Array) -> jax.Array:
    """Returns the lengths [...] of vectors [..., N], with gradient 0 at 0."""
    squared = jnp.sum(v * v, axis=-1)
    nonzero = squared > 0.0
    return jnp.where(nonzero, jnp.sqrt(jnp.where(nonzero, squared, 1.0)), 0.0)


def unit(v: jax.Array) -> jax.Array:
    """Normalises vectors [..., 2] on the ground; those without a direction become +Z."""
    squared = jnp.sum(v * v, axis=-1, keepdims=True)
    nonzero = squared > SMALL**2
    scaled = v * jax.lax.rsqrt(jnp.where(nonzero, squared, 1.0))
    return jnp.where(nonzero, scaled, jnp.broadcast_to(jnp.asarray([0.0, 1.0], v.dtype), v.shape))


def orthonormal(forward: jax.Array, up: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns forward [..., 3] at length 1, and up [..., 3] made perpendicular to it, at length 1.

    Vectors without a direction become zeros: one bad row of a network then does not leave NaN in the character's state.
    """
    forward = forward / jnp.maximum(length(forward)[..., None], SMALL)
    up = up - jnp.sum(up * forward, axis=-1, keepdims=True) * forward
    return forward, up / jnp.maximum(length(up)[..., None], SMALL)
