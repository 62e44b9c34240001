"""The phase function of Holden 2017 and Mason 2018: a cyclic Catmull-Rom spline through K control points."""

from __future__ import annotations

import chex
import jax
import jax.numpy as jnp

# Rows: the points k-1, k, k+1, k+2 around a segment; columns: powers 0..3 of the position d in it (Eq. 1a).
_CATMULL_ROM = (
    (0.0, -0.5, 1.0, -0.5),
    (1.0, 0.0, -2.5, 1.5),
    (0.0, 0.5, 2.0, -1.5),
    (0.0, 0.0, -0.5, 0.5),
)


def catmull_rom_basis(phase: jax.Array, num_control_points: int = 4) -> jax.Array:
    """Coefficients c with which control points are blended at a phase (Mason 2018 Eq. 1).

    The spline passes through control point k at phase 2πk/K; a value is `tensordot(c, points, 1)`. The
    coefficients sum to one and are cyclic and once continuously differentiable in the phase.

    Args:
        phase: [] radians, any real number.
        num_control_points: K, at least 4: with fewer, a point would stand twice in one segment.

    Returns:
        [K] coefficients of the phase's dtype (a whole number counts as a float).

    Raises:
        ValueError: if there are fewer than 4 control points.
    """
    if num_control_points < 4:
        raise ValueError(f"`num_control_points` must be at least 4, got {num_control_points}.")
    phase = jnp.asarray(phase)
    chex.assert_rank(phase, 0)
    turns = phase * (num_control_points / (2 * jnp.pi))
    segment = jnp.floor(turns)
    d = turns - segment
    powers = jnp.stack([jnp.ones_like(d), d, d**2, d**3])
    local = jnp.asarray(_CATMULL_ROM, turns.dtype) @ powers
    indices = (segment.astype(jnp.int32) + jnp.arange(-1, 3)) % num_control_points
    return jnp.zeros(num_control_points, turns.dtype).at[indices].add(local)


def evaluate_spline(points: jax.Array, phase: jax.Array) -> jax.Array:
    """Value of the cyclic spline through `points` [K, ...] at `phase` [] radians (Mason 2018 Eq. 1)."""
    return jnp.tensordot(catmull_rom_basis(phase, points.shape[0]), points, axes=1)
