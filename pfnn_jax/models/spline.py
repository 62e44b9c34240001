"""The phase function of Holden 2017 and Mason 2018: a cyclic Catmull-Rom spline through K control points."""

from __future__ import annotations

import math

import chex
import jax
import jax.numpy as jnp


def catmull_rom_basis(phase: jax.Array, num_control_points: int = 4) -> jax.Array:
    """Returns the coefficients c by which control points are blended at a phase (Mason 2018 Eq. 1).

    The spline passes through control point k at phase 2πk/K; a value is `tensordot(c, points, 1)`. The
    coefficients sum to one and are cyclic and once continuously differentiable in the phase.

    Args:
        phase: [] radians, any real number.
        num_control_points: K, at least 4: with fewer, one point would have two places in a segment.

    Returns:
        [K] coefficients of the phase's dtype (float for an integer phase).

    Raises:
        ValueError: if there are fewer than 4 control points.
    """
    if num_control_points < 4:
        raise ValueError(f"`num_control_points` must be at least 4, got {num_control_points}.")
    phase = jnp.asarray(phase)
    chex.assert_rank(phase, 0)
    count = float(num_control_points)
    turns = phase * (count / (2 * math.pi))  # control points passed, counted from point 0
    # Reduced to [0, K) first, which is exact: the distances below then have the same rounding for every point.
    offset = turns - count * jnp.floor(turns / count) - jnp.arange(num_control_points, dtype=turns.dtype)
    # A point's weight depends only on its cyclic distance d from the phase, as a piecewise cubic. This form needs no
    # gather or scatter, which not every exchange format has.
    d = jnp.abs(offset - count * jnp.floor(offset / count + 0.5))
    near, far = (1.0 - d) * (1.0 + d - 1.5 * d * d), -0.5 * (d - 1.0) * (d - 2.0) ** 2
    # Masks, because the ONNX exporter cannot batch `jnp.where`.
    inner, both = (d < 1.0).astype(d.dtype), (d < 2.0).astype(d.dtype)
    return inner * near + (both - inner) * far


def evaluate_spline(points: jax.Array, phase: jax.Array) -> jax.Array:
    """Evaluates the cyclic spline through `points` [K, ...] at `phase` [] radians (Mason 2018 Eq. 1)."""
    return jnp.tensordot(catmull_rom_basis(phase, points.shape[0]), points, axes=1)
