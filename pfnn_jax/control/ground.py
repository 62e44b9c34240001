"""Vectors on the ground of one character: turning them between a root and the world, towards a target, to length 1.

A facing is a unit vector [2] (x, z); +Z is yaw 0 and +X, the left of a character facing +Z, is yaw π/2.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

SMALL = 1e-6
"""Below this a length carries no direction."""


def root_yaw(directions: jax.Array) -> jax.Array:
    """Radians about +Y of unit directions [..., 2] -> [...] (0 = +Z, π/2 = +X)."""
    return jnp.arctan2(directions[..., 0], directions[..., 1])


def to_world(v: jax.Array, facing: jax.Array) -> jax.Array:
    """Vectors [..., 2] (x, z) or [..., 3] of a root facing [2], turned into the world."""
    x, z = v[..., 0], v[..., -1]
    turned = (x * facing[1] + z * facing[0], z * facing[1] - x * facing[0])
    return jnp.stack((turned[0], *(v[..., axis] for axis in range(1, v.shape[-1] - 1)), turned[1]), -1)


def to_local(v: jax.Array, facing: jax.Array) -> jax.Array:
    """Vectors [..., 2] (x, z) or [..., 3] of the world, turned into a root facing [2]."""
    return to_world(v, facing * np.array([-1.0, 1.0], np.float32))


def turn_towards(directions: jax.Array, target: jax.Array, share: jax.Array | np.ndarray | float) -> jax.Array:
    """Unit directions [..., 2] turned by a share [...] of their angle to a target [..., 2], the short way round."""
    return turn(directions, share * angle_between(directions, target))


def angle_between(a: jax.Array, b: jax.Array) -> jax.Array:
    """Radians [...] about +Y from a direction [..., 2] to another [..., 2], in (-π, π]."""
    across = a[..., 1] * b[..., 0] - a[..., 0] * b[..., 1]
    along = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return jnp.arctan2(across, along)


def wrapped(angle: jax.Array) -> jax.Array:
    """Radians [...], by whole turns brought to [-π, π)."""
    return jnp.mod(angle + jnp.pi, 2.0 * jnp.pi) - jnp.pi


def turn(directions: jax.Array, angle: jax.Array | np.ndarray) -> jax.Array:
    """Vectors [..., 2] turned by angles [...] radians about +Y."""
    x, z, sin, cos = directions[..., 0], directions[..., 1], jnp.sin(angle), jnp.cos(angle)
    return jnp.stack([x * cos + z * sin, z * cos - x * sin], -1)


def heading(yaw: jax.Array) -> jax.Array:
    """The facing [2] of a yaw [] radians about +Y."""
    return jnp.stack([jnp.sin(yaw), jnp.cos(yaw)])


def lift(ground: jax.Array) -> jax.Array:
    """A ground point [2] (x, z) as [3] at height 0."""
    return jnp.stack([ground[0], jnp.zeros_like(ground[0]), ground[1]])


def mix(old: jax.Array, new: jax.Array, share: jax.Array | np.ndarray | float) -> jax.Array:
    """The value a share of the way from old to new, all of equal rank."""
    return old + share * (new - old)


def orthonormal(forward: jax.Array, up: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Forward [..., 3] scaled to length 1, and up [..., 3] made perpendicular to it, of length 1; zeros where there is
    no such direction, so that one bad row of a network does not stay with its character for ever."""
    forward = forward / jnp.maximum(length(forward)[..., None], SMALL)
    up = up - jnp.sum(up * forward, axis=-1, keepdims=True) * forward
    return forward, up / jnp.maximum(length(up)[..., None], SMALL)


def length(v: jax.Array) -> jax.Array:
    """Lengths [...] of vectors [..., N], with slope 0 where they are 0."""
    squared = jnp.sum(v * v, axis=-1)
    found = squared > 0.0
    return jnp.where(found, jnp.sqrt(jnp.where(found, squared, 1.0)), 0.0)


def unit(v: jax.Array) -> jax.Array:
    """Vectors [..., 2] scaled to length 1; those without length become +Z."""
    squared = jnp.sum(v * v, axis=-1, keepdims=True)
    found = squared > 1e-12
    scaled = v * jax.lax.rsqrt(jnp.where(found, squared, 1.0))
    return jnp.where(found, scaled, jnp.broadcast_to(jnp.asarray([0.0, 1.0], v.dtype), v.shape))
