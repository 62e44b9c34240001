"""Inverse kinematics of limbs: two bones to a target in closed form, and arms to predicted positions, bone by bone.

A limb keeps the plane in which it bends. A stretched limb has none and bends as knees and elbows do. Close to full
length its reach grows more and more slowly, so that it never snaps straight. Bones keep their lengths because only
rotations change.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, turn_joint
from pfnn_jax.control.vectors import length
from pfnn_jax.motion.kinematics import (
    quat_between,
    quat_conjugate,
    quat_from_axis_angle,
    quat_multiply,
    quat_rotate,
)

SOFT = 0.97
"""Share of a limb's full length up to which targets are reached exactly; beyond it the limb approaches full length."""

STRAIGHT = 1e-5  # of the cosine: a limb bends by at least a quarter of a degree, so that gradients stay finite
LEAN = 0.17  # sine of 10 degrees: a limb bent by less bends towards its pole
BENT = 0.5  # sine of 30 degrees: one bent by more keeps its own plane

Limb = tuple[int, int, int]
"""Upper, middle and end joint, as hip, knee and ankle."""


def two_bone(rig: Rig, pose: Pose, limb: Limb, target: jax.Array, pole: jax.Array | None = None) -> Pose:
    """Moves the end joint of a limb to the target, or as near as it reaches.

    Only the upper and the middle joint turn; the end joint and its descendants keep their local rotations.

    Args:
        rig, pose: the body.
        limb: its joints.
        target: [3] metres in the world.
        pole: [3] where the middle joint points when the limb is straight; by default in front of the hips, which is
            right for legs.

    Targets within `SOFT` of the limb's length (or within its present stretch) are reached; beyond, the limb stretches
    towards its full length and points at the target.
    """
    positions, world = forward_kinematics(rig, pose)
    pole = forward_of(rig, positions) if pole is None else pole
    upper, middle, end = limb
    over, under, _ = bend(positions[upper], positions[middle], positions[end], target, pole)
    return turn_joint(rig, turn_joint(rig, pose, world, middle, under), world, upper, over)


def forward_of(rig: Rig, positions: jax.Array) -> jax.Array:
    """Returns the horizontal direction [3], not unit, that the hips face: perpendicular to the line between them."""
    across = positions[rig.legs[0][0]] - positions[rig.legs[1][0]]
    return jnp.stack([-across[2], jnp.zeros_like(across[0]), across[0]])


def bend(
    upper: jax.Array, middle: jax.Array, end: jax.Array, target: jax.Array, pole: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Returns the rotations in the world of a limb's two joints that bring its end to a target.

    With u and v the vectors of the two bones and n the axis of bending across u, the turned lower bone makes
    u·R(n, δ)v = B cos δ + C sin δ; the law of cosines gives δ exactly even where v leans out of the plane. Then the
    shortest arc takes the end onto the ray to the target.

    Args:
        upper, middle, end: [3] positions of the joints.
        target: [3].
        pole: [3] where the middle joint points when the limb is straight.

    Returns:
        Rotation [4] of the upper joint, rotation [4] of the middle joint (applied before that of the upper one), and
        the new position [3] of the end.
    """
    u, v = middle - upper, end - middle
    axis = _hinge(u, v, pole)
    along, aside = jnp.sum(u * v), jnp.sum(jnp.cross(axis, v) * u)
    both = length(jnp.stack([along, aside]))
    squares = jnp.sum(u * u) + jnp.sum(v * v)
    bent = -_angle(aside, along)
    distance = _soft(length(target - upper), length(end - upper), jnp.sqrt(jnp.maximum(squares + 2.0 * both, 1e-12)))
    cosine = (distance * distance - squares) / (2.0 * jnp.maximum(both, 1e-9))
    wanted = jnp.arccos(jnp.clip(cosine, STRAIGHT - 1.0, 1.0 - STRAIGHT))
    # A limb that is slightly bent the wrong way, as by noise, stays so until more bending is needed, and then passes
    # through straight. The rule is continuous, and the identity if the target is the end itself.
    back = jnp.maximum(-bent, 0.0)
    wanted = jnp.minimum(wanted, jnp.maximum(-wanted, 3.0 * wanted - 4.0 * back))
    under = quat_from_axis_angle(axis, wanted - bent)
    reached = u + quat_rotate(under, v)
    over = quat_between(reached, target - upper)
    return over, under, upper + quat_rotate(over, reached)


def reach_arms(rig: Rig, pose: Pose, predicted: jax.Array) -> Pose:
    """Lays the arms along predicted positions, bone by bone from the shoulders.

    Each bone is turned by the shortest arc towards the predicted position of its far end; its length stays. Mixed
    styles can predict rotations that do not fit the positions; positions mix well.

    Args:
        rig, pose: the body.
        predicted: [J, 3] metres in the world; only the joints of the arms below the shoulders are read.

    Source: Mason et al. 2022, section 4.4.
    """
    positions, world = forward_kinematics(rig, pose)
    for arm in rig.arms:
        at, turned = positions[arm[0]], None
        for joint, below in zip(arm[:-1], arm[1:], strict=True):
            bone = positions[below] - positions[joint]
            bone = bone if turned is None else quat_rotate(turned, bone)
            turn = quat_between(bone, predicted[below] - at)
            at = at + quat_rotate(turn, bone)
            pose, turned = _turn_carried(rig, pose, world, joint, turned, turn)
    return pose


def _turn_carried(
    rig: Rig, pose: Pose, world: jax.Array, joint: int, carried: jax.Array | None, turn: jax.Array
) -> tuple[Pose, jax.Array]:
    """Turns a joint whose ancestors have turned it by `carried`; returns the pose and the composed rotation."""
    if carried is None:
        return turn_joint(rig, pose, world, joint, turn), turn
    both = quat_multiply(turn, carried)
    return turn_joint(rig, pose, world, joint, quat_multiply(quat_conjugate(carried), both)), both


def _hinge(u: jax.Array, v: jax.Array, pole: jax.Array) -> jax.Array:
    """Returns the unit axis [3] perpendicular to u about which the limb bends: of its own plane, or of the pole's if
    it is nearly straight."""
    natural = _unit(jnp.cross(pole, u), _across(u))
    own = jnp.cross(u, v) / jnp.maximum(length(u) * length(v), 1e-9)
    share = jnp.clip(jnp.sum(own * own) / BENT**2, 0.0, 1.0)
    lean = LEAN * (1.0 - share * (2.0 - share))
    return _unit(own + lean * natural, natural)


def _soft(wanted: jax.Array, now: jax.Array, longest: jax.Array) -> jax.Array:
    """Returns a distance that approaches the longest beyond both `SOFT` of it and the present distance."""
    start = jnp.maximum(SOFT * longest, jnp.minimum(now, longest))
    room = jnp.maximum(longest - start, 1e-6)
    beyond = jnp.clip((wanted - start) / room, 0.0, 50.0)
    return jnp.minimum(wanted, start) + room * (1.0 - jnp.exp(-beyond))


def _angle(y: jax.Array, x: jax.Array) -> jax.Array:
    """Returns arctan2, with gradient 0 at the origin."""
    found = (jnp.abs(x) > 0.0) | (jnp.abs(y) > 0.0)
    return jnp.arctan2(y, jnp.where(found, x, 1.0))


def _unit(v: jax.Array, otherwise: jax.Array) -> jax.Array:
    """Returns v at length 1, or `otherwise` if it has no direction."""
    squared = jnp.sum(v * v)
    found = squared > 1e-10
    return jnp.where(found, v / jnp.sqrt(jnp.where(found, squared, 1.0)), otherwise)


def _across(u: jax.Array) -> jax.Array:
    """Returns a unit vector perpendicular to u: X or Z, whichever is less along u, made perpendicular."""
    x, z = np.eye(3, dtype=u.dtype)[[0, 2]]
    other = jnp.where(jnp.abs(u[0]) < jnp.abs(u[2]), x, z)
    other = other - jnp.sum(other * u) / jnp.maximum(jnp.sum(u * u), 1e-12) * u
    return _unit(other, jnp.asarray(x))
