"""Bends a limb of two bones to a target, in closed form and on any leading axes.

A limb keeps the plane in which it bends. A stretched limb has none and bends as knees and elbows do. Close to full
length its reach grows more and more slowly, so that it never snaps straight. Bones keep their lengths because only
rotations change.

The same function serves whole clips in NumPy and one frame in JAX, where its gradients are finite everywhere.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pfnn_jax.motion.arrays import as_floats, cross
from pfnn_jax.motion.kinematics import quat_between, quat_from_axis_angle, quat_rotate

SOFT = 0.97
"""Share of a limb's full length up to which targets are reached exactly; beyond it the limb approaches full length."""

STRAIGHT = 1e-5  # of the cosine: a limb bends by at least a quarter of a degree, so that gradients stay finite
LEAN = 0.17  # sine of 10 degrees: a limb bent by less bends towards its pole
BENT = 0.5  # sine of 30 degrees: one bent by more keeps its own plane


def bend(upper: Any, middle: Any, end: Any, target: Any, pole: Any) -> tuple[Any, Any, Any]:
    """Returns the rotations in the world of a limb's two joints that bring its end to a target.

    With u and v the vectors of the two bones and n the axis of bending across u, the turned lower bone makes
    u·R(n, δ)v = B cos δ + C sin δ; the law of cosines gives δ exactly even where v leans out of the plane. Then the
    shortest arc takes the end onto the ray to the target.

    Args:
        upper, middle, end: [..., 3] positions of the joints.
        target: [..., 3].
        pole: [..., 3] where the middle joint points when the limb is straight.

    Returns:
        Rotation [..., 4] of the upper joint, rotation [..., 4] of the middle joint (applied before that of the upper
        one), and the new position [..., 3] of the end.
    """
    xp, upper, middle, end, target, pole = as_floats(upper, middle, end, target, pole)
    u, v = middle - upper, end - middle
    axis = _hinge(u, v, pole, xp)
    along, across = _dot(u, v, xp), _dot(cross(axis, v), u, xp)
    both = _length(xp.concatenate((along, across), axis=-1), xp)
    squares = _dot(u, u, xp) + _dot(v, v, xp)
    bent = -_angle(across, along, xp)
    longest = xp.sqrt(xp.maximum(squares + 2.0 * both, 1e-12))
    distance = _soft(_length(target - upper, xp), _length(end - upper, xp), longest, xp)
    cosine = (distance * distance - squares) / (2.0 * xp.maximum(both, 1e-9))
    wanted = xp.arccos(xp.clip(cosine, STRAIGHT - 1.0, 1.0 - STRAIGHT))
    # A limb that is slightly bent the wrong way, as by noise, stays so until more bending is needed, and then passes
    # through straight. The rule is continuous, and the identity if the target is the end itself.
    back = xp.maximum(-bent, 0.0)
    wanted = xp.minimum(wanted, xp.maximum(-wanted, 3.0 * wanted - 4.0 * back))
    under = quat_from_axis_angle(axis, (wanted - bent)[..., 0])
    reached = u + quat_rotate(under, v)
    over = quat_between(reached, target - upper)
    return over, under, upper + quat_rotate(over, reached)


def _hinge(u: Any, v: Any, pole: Any, xp: Any) -> Any:
    """Returns the unit axis [..., 3] perpendicular to u about which the limb bends: of its own plane, or of the pole's
    if it is nearly straight."""
    natural = _unit(cross(pole, u), _across(u, xp), xp)
    own = cross(u, v) / xp.maximum(_length(u, xp) * _length(v, xp), 1e-9)
    share = xp.clip(_dot(own, own, xp) / BENT**2, 0.0, 1.0)
    lean = LEAN * (1.0 - share * (2.0 - share))
    return _unit(own + lean * natural, natural, xp)


def _soft(wanted: Any, now: Any, longest: Any, xp: Any) -> Any:
    """Returns a distance that approaches the longest beyond both `SOFT` of it and the present distance."""
    start = xp.maximum(SOFT * longest, xp.minimum(now, longest))
    room = xp.maximum(longest - start, 1e-6)
    beyond = xp.clip((wanted - start) / room, 0.0, 50.0)
    return xp.minimum(wanted, start) + room * (1.0 - xp.exp(-beyond))


def _dot(a: Any, b: Any, xp: Any) -> Any:
    return xp.sum(a * b, axis=-1, keepdims=True)


def _length(v: Any, xp: Any) -> Any:
    """Returns the lengths [..., 1] of vectors, with gradient 0 at 0."""
    squared = _dot(v, v, xp)
    found = squared > 0.0
    return xp.where(found, xp.sqrt(xp.where(found, squared, 1.0)), 0.0)


def _angle(y: Any, x: Any, xp: Any) -> Any:
    """Returns arctan2, with gradient 0 at the origin."""
    found = (xp.abs(x) > 0.0) | (xp.abs(y) > 0.0)
    return xp.arctan2(y, xp.where(found, x, 1.0))


def _unit(v: Any, otherwise: Any, xp: Any) -> Any:
    """Returns v at length 1, or `otherwise` where it has no direction."""
    squared = _dot(v, v, xp)
    found = squared > 1e-10
    return xp.where(found, v / xp.sqrt(xp.where(found, squared, 1.0)), otherwise)


def _across(u: Any, xp: Any) -> Any:
    """Returns unit vectors perpendicular to u: X or Z, whichever is less along u, made perpendicular."""
    x, z = (xp.broadcast_to(xp.asarray(axis, dtype=u.dtype), u.shape) for axis in np.eye(3)[[0, 2]])
    other = xp.where(xp.abs(u[..., :1]) < xp.abs(u[..., 2:]), x, z)
    other = other - _dot(other, u, xp) / xp.maximum(_dot(u, u, xp), 1e-12) * u
    return _unit(other, x, xp)
