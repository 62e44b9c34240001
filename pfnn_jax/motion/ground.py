"""Directions and vectors on the ground, in NumPy or JAX: rotation between a root and the world, and angles.

A facing is a unit vector [..., 2] (x, z). Its yaw is a rotation about +Y in radians: +Z is yaw 0, and +X, to the left
of a character that faces +Z, is yaw π/2. NumPy arrays give NumPy arrays, JAX arrays give JAX arrays.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pfnn_jax.motion.arrays import array_namespace, join_components


def facing_of(yaw: Any) -> Any:
    """Returns the facings [..., 2] of yaws [...]."""
    xp = array_namespace(yaw)
    return xp.stack((xp.sin(yaw), xp.cos(yaw)), axis=-1)


def yaw_of(facing: Any) -> Any:
    """Returns the yaws [...], in [-π, π], of facings [..., 2]."""
    return array_namespace(facing).arctan2(facing[..., 0], facing[..., 1])


def to_world(v: Any, facing: Any) -> Any:
    """Rotates vectors from the frame of a root into the world.

    Args:
        v: [..., 2] as (x, z) or [..., 3] as (x, y, z); heights do not change.
        facing: [..., 2] of the roots. Its leading axes are the first of `v`: one facing [T, 2] for each frame of
            joints [T, J, 3], or a single facing [2] for all of `v`.
    """
    return _rotate(v, facing[..., 0], facing[..., 1])


def to_local(v: Any, facing: Any) -> Any:
    """Rotates vectors from the world into the frame of a root: the inverse of `to_world`, with the same arguments."""
    return _rotate(v, -facing[..., 0], facing[..., 1])


def turn(v: Any, angle: Any) -> Any:
    """Rotates vectors [..., 2] or [..., 3] by angles in radians about +Y; axes are matched as in `to_world`."""
    return to_world(v, facing_of(angle))


def angle_between(a: Any, b: Any) -> Any:
    """Returns the angle [...] in radians about +Y from direction a [..., 2] to direction b [..., 2], in [-π, π]."""
    across = a[..., 1] * b[..., 0] - a[..., 0] * b[..., 1]
    along = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return array_namespace(a, b).arctan2(across, along)


def turn_towards(facing: Any, target: Any, share: Any) -> Any:
    """Rotates facings [..., 2] by a share [...] of their angle to a target [..., 2], the shorter way round."""
    return turn(facing, share * angle_between(facing, target))


def wrap_angle(angle: Any) -> Any:
    """Returns the same angles [...] in [-π, π)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


def _rotate(v: Any, sin: Any, cos: Any) -> Any:
    xp = array_namespace(v, sin)
    v = xp.asarray(v)
    shape = sin.shape + (1,) * (v.ndim - 1 - sin.ndim)
    sin, cos = sin.reshape(shape), cos.reshape(shape)
    x, z = v[..., 0], v[..., -1]
    height = [v[..., 1]] if v.shape[-1] == 3 else []
    parts = (x * cos + z * sin, *height, z * cos - x * sin)
    return join_components(parts, xp, np.result_type(v, sin) if xp is np else None)
