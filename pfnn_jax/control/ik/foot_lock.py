"""Foot locking: heels and toes are held in place during contact and released smoothly.

A foot joint is held on the ground where the corrected body has it when its contact begins. A contact begins while the
foot still comes down: the height of a held joint follows the predicted one down, as far as the joint rests in the data,
and does not follow it up. When a joint is released, its offset from the predicted motion decays like a critically
damped spring that starts with the offset's velocity, so neither position nor velocity jumps. Heel and toe of a foot are
one rigid piece: the one that is not held is drawn to the offset of the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.ik.limb import forward_of
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics
from pfnn_jax.control.vectors import length, smoothstep
from pfnn_jax.errors import check_positive
from pfnn_jax.motion.kinematics import quat_between, quat_conjugate, quat_multiply, quat_rotate
from pfnn_jax.motion.two_bone import bend

PARTNER = (1, 0, 3, 2)
"""The other joint of the same foot, in the order of contacts: left heel, left toe, right heel, right toe."""

DECAYED = 4.74
"""Time constants after which 5 % of a critically damped motion are left: (1 + t) exp(-t) = 0.05."""


@dataclass(frozen=True)
class FootLockConfig:
    """When feet are held and released. Lengths are shares of the leg length, so that one setting fits all skeletons.

    Attributes:
        lock_threshold: contact from which a foot joint is held.
        release_threshold: contact below which it is released.
        lock_time: seconds until a toe that is held decides where its foot is.
        release_time: seconds after which 5 % of a released offset are left.
        heel_limit, toe_limit: a joint further than this from its predicted position is released; one that is predicted
            below the ground is not released for that.
        heel_rise: weight of a heel's height in that distance: heels rise before the contact ends, and must not be kept
            down.
        max_lock_offset: a joint is held again only when its offset is below this.
        floor: metres, lower bound of the height of all foot joints.
        max_drop: how far the hips may be lowered so that the feet reach their targets.
        fps: steps per second.
    """

    lock_threshold: float = 0.6
    release_threshold: float = 0.4
    lock_time: float = 0.05
    release_time: float = 0.4
    heel_limit: float = 0.08
    toe_limit: float = 0.15
    heel_rise: float = 4.0
    max_lock_offset: float = 0.04
    floor: float = 0.0
    max_drop: float = 0.06
    fps: float = 60.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.release_threshold <= self.lock_threshold <= 1.0:
            found = f"{self.release_threshold} and {self.lock_threshold}"
            raise ValueError(f"FootLockConfig needs 0 <= release_threshold <= lock_threshold <= 1, got {found}.")
        check_positive(
            self, "lock_time", "release_time", "heel_rise", "heel_limit", "toe_limit", "max_lock_offset", "fps"
        )


@struct.dataclass(kw_only=True)
class FootLocks:
    """The state of the locks: left heel, left toe, right heel, right toe.

    Attributes:
        positions: [4, 3] metres, where each joint is held, or was held last.
        held: [4] bool.
        settling: [4, 2] metres by which a held joint is above the height that it comes down to, and its velocity in
            metres per second.
        strength: [4] in [0, 1]: rises to 1 while a joint is held, and falls to 0 after its release.
        offsets: [4, 3] metres from the predicted to the corrected joint.
        velocities: [4, 3] metres per second, of the offsets.
        drop: [2] metres by which the hips are lowered, and its velocity in metres per second.
    """

    positions: jax.Array
    held: jax.Array
    settling: jax.Array
    strength: jax.Array
    offsets: jax.Array
    velocities: jax.Array
    drop: jax.Array


def initial_locks(rig: Rig, dtype: Any = jnp.float32) -> FootLocks:
    """Returns locks of a rig that hold nothing."""
    zero, none = jnp.zeros((len(rig.feet), 3), dtype), jnp.zeros(len(rig.feet), dtype)
    return FootLocks(
        positions=zero,
        held=none > 0.0,
        settling=zero[:, :2],
        strength=none,
        offsets=zero,
        velocities=zero,
        drop=zero[0, :2],
    )


def lock_feet(
    rig: Rig, pose: Pose, contacts: jax.Array, locks: FootLocks, config: FootLockConfig | None = None
) -> tuple[Pose, FootLocks]:
    """Holds the feet of one frame in place where they are in contact.

    Args:
        rig: the body.
        pose: as predicted, before any correction of its feet.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
        locks: after the previous frame; `initial_locks` for the first.
        config: thresholds and times.

    Returns:
        The corrected pose, in which only the position of the hips and the hip, knee and heel joints differ; and the
        locks.

    Source: Mason et al. 2022, section 4.4; thresholds after the demo of Holden et al. 2017.
    """
    config = config or FootLockConfig()
    positions, world = forward_kinematics(rig, pose)
    targets, toe_shares, locks = plan_feet(rig, positions, contacts, locks, config)
    lowered = jnp.stack([jnp.zeros_like(locks.drop[0]), -locks.drop[0], jnp.zeros_like(locks.drop[0])])
    pose = replace(pose, hips=pose.hips + lowered)
    return place_feet(rig, pose, positions + lowered[None], world, targets, toe_shares), locks


def plan_feet(
    rig: Rig, positions: jax.Array, contacts: jax.Array, locks: FootLocks, config: FootLockConfig
) -> tuple[jax.Array, jax.Array, FootLocks]:
    """Returns where heels and toes [2, 2, 3] of both feet go, the toes' shares [2] as `place_feet` takes them, and the
    locks, which also hold by how far the hips go down; of predicted joint positions [J, 3]."""
    feet = positions[np.array(rig.feet)]
    locks = _advance(rig, feet, contacts, locks, config)
    targets = feet + locks.offsets
    targets = targets.at[:, 1].max(config.floor)
    needed = needed_drop(rig, positions, targets, config)
    drop, speed = critically_damped_step(locks.drop[0] - needed, locks.drop[1], config)
    locks = replace(locks, drop=jnp.stack([needed + drop, speed]))
    return targets.reshape(2, 2, 3), smoothstep(locks.strength[np.array([1, 3])]), locks


def _advance(rig: Rig, feet: jax.Array, contacts: jax.Array, locks: FootLocks, config: FootLockConfig) -> FootLocks:
    """Returns the locks of this frame: offsets [4, 3] that hold, follow the held partner, or decay."""
    rest = _resting_heights(rig, config)
    places, settling = _held_places(feet[:, 1], rest, locks, config)
    gap = places - feet
    kept = locks.held & (contacts >= config.release_threshold) & _near(rig, gap, config)
    # The offset of a joint that is not held decays towards the offset of its held partner, which moves itself.
    leads = kept[np.array(PARTNER), None]
    goal, before, speed = (
        jnp.where(leads, values[np.array(PARTNER)], 0.0) for values in (gap, locks.offsets, locks.velocities)
    )
    away, away_velocity = critically_damped_step(locks.offsets - before, locks.velocities - speed, config)
    free, near = goal + away, _squared(away) < (config.max_lock_offset * rig.leg_length) ** 2
    moving = away_velocity + jnp.where(leads, (goal - before) * config.fps, 0.0)
    starting = ~locks.held & (contacts >= config.lock_threshold) & near
    begun = jnp.stack([free[:, 1] - jnp.maximum(rest - feet[:, 1], 0.0), moving[:, 1]], axis=1)
    held, offsets = kept | starting, jnp.where(kept[:, None], gap, free)
    rate = jnp.where(held, 1.0 / config.lock_time, -1.0 / config.release_time) / config.fps
    return replace(
        locks,
        positions=jnp.where(starting[:, None], feet + free, places),
        held=held,
        settling=jnp.where(starting[:, None], begun, settling),
        strength=jnp.clip(locks.strength + rate, 0.0, 1.0),
        offsets=offsets,
        velocities=jnp.where(kept[:, None], (offsets - locks.offsets) * config.fps, moving),
    )


def _resting_heights(rig: Rig, config: FootLockConfig) -> np.ndarray:
    """Returns the heights [4] in metres to which held joints come down at the lowest."""
    floor = np.full(len(rig.feet), config.floor)
    return floor if rig.resting_heights is None else np.maximum(np.ravel(rig.resting_heights), floor)


def _held_places(
    heights: jax.Array, rest: np.ndarray, locks: FootLocks, config: FootLockConfig
) -> tuple[jax.Array, jax.Array]:
    """Returns where joints are held in this frame [4, 3], and what is left of `FootLocks.settling` [4, 2].

    Args:
        heights: [4] metres, predicted.
        rest: [4] metres at which the joints rest.
        locks: of the previous frame.
        config: constants.
    """
    before = locks.positions[:, 1]
    lowest = jnp.maximum(jnp.minimum(before - locks.settling[:, 0], heights), rest)
    left, speed = critically_damped_step(locks.settling[:, 0], locks.settling[:, 1], config)
    # Not below the rest, but where the contact began there.
    left = jnp.maximum(left, jnp.minimum(before, rest) - lowest)
    return locks.positions.at[:, 1].set(lowest + left), jnp.stack([left, speed], axis=1)


def _near(rig: Rig, gap: jax.Array, config: FootLockConfig) -> jax.Array:
    """Returns which joints [4] may be held, by the gaps [4, 3] from the predicted joints to where they are held."""
    limits = np.array([config.heel_limit, config.toe_limit] * 2) * rig.leg_length
    rise = jnp.maximum(-gap[:, 1], 0.0) * np.array([config.heel_rise, 1.0] * 2)  # heels leave the ground before toes
    return _squared(gap.at[:, 1].set(rise)) < limits**2


def critically_damped_step(
    offset: jax.Array, velocity: jax.Array, config: FootLockConfig
) -> tuple[jax.Array, jax.Array]:
    """Advances a critically damped spring with rest position 0 by one frame; exact for any frame rate."""
    dt, rate = 1.0 / config.fps, DECAYED / config.release_time
    push, fade = velocity + rate * offset, math.exp(-rate * dt)
    return (offset + push * dt) * fade, (velocity - push * (rate * dt)) * fade


def needed_drop(rig: Rig, positions: jax.Array, targets: jax.Array, config: FootLockConfig) -> jax.Array:
    """Returns the distance [] in metres by which the hips must sink for both heels to be within reach."""
    drops = []
    for side, (hip, knee, heel, _) in enumerate(rig.legs):
        reach = 0.995 * (length(positions[knee] - positions[hip]) + length(positions[heel] - positions[knee]))
        # At least as far as the predicted leg is stretched: the hips sink for a target, not for a straight leg.
        reach = jnp.maximum(reach, length(positions[heel] - positions[hip]))
        to = targets[2 * side] - positions[hip]
        level = to[0] * to[0] + to[2] * to[2]
        drops.append(-to[1] - jnp.sqrt(jnp.maximum(reach * reach - level, 1e-6)))
    return jnp.clip(jnp.maximum(*drops), 0.0, config.max_drop * rig.leg_length)


def place_feet(
    rig: Rig, pose: Pose, positions: jax.Array, world: jax.Array, targets: jax.Array, toe_shares: jax.Array
) -> Pose:
    """Places heels and toes at targets [2, 2, 3], both legs at once."""
    hips, knees, heels, toes = (np.array(joints) for joints in zip(*rig.legs, strict=True))
    points = positions[hips], positions[knees], positions[heels], positions[toes]
    over, under, turn = jax.vmap(_solve_leg, in_axes=(0, 0, 0, 0, 0, 0, None))(
        *points, targets, toe_shares, forward_of(rig, positions)
    )
    feet = quat_multiply(quat_conjugate(quat_multiply(over, under)), turn)
    joints = np.concatenate([hips, knees, heels])
    above = world[np.array(rig.parents)[joints]]
    delta = quat_multiply(quat_conjugate(above), quat_multiply(jnp.concatenate([over, under, feet]), above))
    turned = quat_multiply(delta, pose.rotations[joints])
    return replace(pose, rotations=pose.rotations.at[joints].set(turned))


def _solve_leg(
    hip: jax.Array,
    knee: jax.Array,
    heel: jax.Array,
    toe: jax.Array,
    targets: jax.Array,
    toe_share: jax.Array,
    pole: jax.Array,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Returns the rotations [4] of hip, knee and foot that bring heel and toe to targets [2, 3].

    The foot is rigid. If the distance of the targets differs from its length, the toe decides by `toe_share` [], the
    heel by the rest.
    """
    along = targets[1] - targets[0]
    turn = quat_between(toe - heel, along)
    place = targets[0] + toe_share * (along - quat_rotate(turn, toe - heel))
    over, under, _ = bend(hip, knee, heel, place, pole)
    return over, under, turn


def _squared(v: jax.Array) -> jax.Array:
    """Returns the squared lengths [4] of v [4, 3]."""
    return jnp.sum(v * v, axis=-1)
