"""Inverse kinematics of limbs: two bones to a target in closed form, and arms to predicted positions, bone by bone.

A limb keeps the plane in which it bends. Near full stretch it has none, and bends as knees and elbows do; there its
reach grows ever more slowly, so that it never snaps straight. Bones keep their lengths because only rotations change.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.ground import length
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, turn_joint
from pfnn_jax.motion.kinematics import (
    quat_between,
    quat_conjugate,
    quat_from_axis_angle,
    quat_multiply,
    quat_rotate,
)

SOFT = 0.97
"""Share of a limb's full length up to which targets are reached exactly; beyond, it approaches its full length."""

STRAIGHT = 1e-5  # of the cosine: a limb bends by at least a quarter of a degree, so that slopes stay finite
LEAN = 0.17  # sine of 10 degrees: a limb bent by less than that bends as its pole says
BENT = 0.5  # sine of 30 degrees: one bent by more keeps its own plane

Limb = tuple[int, int, int]
"""Upper, middle and end joint, as hip, knee and ankle."""


def two_bone(rig: Rig, pose: Pose, limb: Limb, target: jax.Array, pole: jax.Array | None = None) -> Pose:
    """The pose with the end joint of a limb at the target, or as near as it reaches.

    Only the upper and the middle joint turn; what hangs from the end joint keeps its local rotation.

    Args:
        rig, pose: the body.
        limb: its joints.
        target: [3] metres in the world.
        pole: [3] where the middle joint points when the limb is straight; by default forward, seen from the hips, which
            is right for legs.

    Targets nearer than `SOFT` of the limb's length (or than it is stretched already) are reached; from there on the
    limb stretches towards its full length, and so points at what it cannot reach.
    """
    positions, world = forward_kinematics(rig, pose)
    pole = forward_of(rig, positions) if pole is None else pole
    upper, middle, end = limb
    over, under, _ = bend(positions[upper], positions[middle], positions[end], target, pole)
    return turn_joint(rig, turn_joint(rig, pose, world, middle, under), world, upper, over)


def forward_of(rig: Rig, positions: jax.Array) -> jax.Array:
    """[3] where the hips face: across the line between the hip joints, level; of any length."""
    across = positions[rig.legs[0][0]] - positions[rig.legs[1][0]]
    return jnp.stack([-across[2], jnp.zeros_like(across[0]), across[0]])


def bend(
    upper: jax.Array, middle: jax.Array, end: jax.Array, target: jax.Array, pole: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """How the two joints of a limb must turn in the world to bring its end to a target.

    With u and v the vectors of the two bones and n the axis of bending across u, the turned lower bone makes
    u·R(n, δ)v = B cos δ + C sin δ; the law of cosines gives δ exactly even where v leans out of the plane. Then the
    shortest arc takes the end onto the ray to the target.

    Args:
        upper, middle, end: [3] where the joints are.
        target: [3].
        pole: [3] where the middle joint points when the limb is straight.

    Returns:
        Turn [4] of the upper joint, turn [4] of the middle joint (before that of the upper one, which carries it), and
        where the end comes to be, [3].
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
    # A limb bent the wrong way, by the little that noise bends one, stays so until more bending is asked for, and then
    # goes through straight. The rule is continuous, and the identity where the target is the end itself.
    back = jnp.maximum(-bent, 0.0)
    wanted = jnp.minimum(wanted, jnp.maximum(-wanted, 3.0 * wanted - 4.0 * back))
    under = quat_from_axis_angle(axis, wanted - bent)
    reached = u + quat_rotate(under, v)
    over = quat_between(reached, target - upper)
    return over, under, upper + quat_rotate(over, reached)


def reach_arms(rig: Rig, pose: Pose, predicted: jax.Array) -> Pose:
    """The pose with its arms laid along predicted positions, bone by bone from the shoulders.

    Every bone is turned by the shortest arc towards the place predicted for its far end; its length stays. Mixed styles
    can predict rotations that do not fit the positions; positions mix well.

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
    """Turns a joint that those above it have `carried` along already; gives the pose and the turn of both."""
    if carried is None:
        return turn_joint(rig, pose, world, joint, turn), turn
    both = quat_multiply(turn, carried)
    return turn_joint(rig, pose, world, joint, quat_multiply(quat_conjugate(carried), both)), both


def _hinge(u: jax.Array, v: jax.Array, pole: jax.Array) -> jax.Array:
    """Unit axis [3] across u about which the limb bends: of its own plane, near straight that of the pole."""
    natural = _unit(jnp.cross(pole, u), _across(u))
    own = jnp.cross(u, v) / jnp.maximum(length(u) * length(v), 1e-9)
    share = jnp.clip(jnp.sum(own * own) / BENT**2, 0.0, 1.0)
    lean = LEAN * (1.0 - share * (2.0 - share))
    return _unit(own + lean * natural, natural)


def _soft(wanted: jax.Array, now: jax.Array, longest: jax.Array) -> jax.Array:
    """A distance that grows towards the longest ever more slowly, once beyond both `SOFT` of it and the present."""
    start = jnp.maximum(SOFT * longest, jnp.minimum(now, longest))
    room = jnp.maximum(longest - start, 1e-6)
    beyond = jnp.clip((wanted - start) / room, 0.0, 50.0)
    return jnp.minimum(wanted, start) + room * (1.0 - jnp.exp(-beyond))


def _angle(y: jax.Array, x: jax.Array) -> jax.Array:
    """arctan2, with slope 0 at the origin."""
    found = (jnp.abs(x) > 0.0) | (jnp.abs(y) > 0.0)
    return jnp.arctan2(y, jnp.where(found, x, 1.0))


def _unit(v: jax.Array, otherwise: jax.Array) -> jax.Array:
    """v at length 1, or `otherwise` where it has none."""
    squared = jnp.sum(v * v)
    found = squared > 1e-10
    return jnp.where(found, v / jnp.sqrt(jnp.where(found, squared, 1.0)), otherwise)


def _across(u: jax.Array) -> jax.Array:
    """Some unit vector across u: the one of X and Z that is less along it, made perpendicular."""
    x, z = np.eye(3, dtype=u.dtype)[[0, 2]]
    other = jnp.where(jnp.abs(u[0]) < jnp.abs(u[2]), x, z)
    other = other - jnp.sum(other * u) / jnp.maximum(jnp.sum(u * u), 1e-12) * u
    return _unit(other, jnp.asarray(x))
