"""Feet that stay where they stand: contacts hold heels and toes in place, release lets them go without a jerk.

A foot joint is held where the corrected body has it when its contact begins. While it is held, its offset from the
unheld motion is whatever keeps it there; when it is let go, the offset dies away like a critically damped spring that
starts with the offset's own speed, so that neither place nor speed jumps. Heel and toe of a foot are one rigid piece:
the one that is not held is drawn to the offset of the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.ground import length
from pfnn_jax.control.ik.limb import bend, forward_of
from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics
from pfnn_jax.motion.kinematics import quat_between, quat_conjugate, quat_multiply, quat_rotate

PARTNER = (1, 0, 3, 2)
"""The other joint of the same foot, in the order of contacts: left heel, left toe, right heel, right toe."""

SETTLED = 4.74
"""Time constants after which a twentieth of a critically damped motion is left: (1 + t) exp(-t) = 0.05."""


@dataclass(frozen=True)
class FootLockConfig:
    """When feet are held and let go. Lengths are shares of the leg's, so that one setting fits all skeletons.

    Attributes:
        lock_threshold: contact from which a foot joint is held.
        release_threshold: contact below which it is let go.
        hold: seconds in which a toe that is held takes the lead of its foot.
        release: seconds after which a twentieth of a released offset is left.
        heel_limit, toe_limit: a joint further than this from where the unheld motion has it is let go.
        heel_rise: how much more a heel's height counts than its place: it rises early, and is not to be kept down.
        hold_within: a joint is held anew only when its offset is below this.
        floor: metres, the height below which no foot joint sinks.
        max_drop: how far the hips may be lowered so that the feet reach their places.
        fps: steps per second.
    """

    lock_threshold: float = 0.6
    release_threshold: float = 0.4
    hold: float = 0.05
    release: float = 0.4
    heel_limit: float = 0.08
    toe_limit: float = 0.15
    heel_rise: float = 4.0
    hold_within: float = 0.04
    floor: float = 0.0
    max_drop: float = 0.06
    fps: float = 60.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.release_threshold <= self.lock_threshold <= 1.0:
            found = f"{self.release_threshold} and {self.lock_threshold}"
            raise ValueError(f"FootLockConfig needs 0 <= release_threshold <= lock_threshold <= 1, got {found}.")
        for name in ("hold", "release", "heel_rise", "heel_limit", "toe_limit", "hold_within", "fps"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"FootLockConfig.{name} must be above 0, got {getattr(self, name)}.")


@struct.dataclass(kw_only=True)
class FootLocks:
    """What is held between steps: left heel, left toe, right heel, right toe.

    Attributes:
        positions: [4, 3] metres, where each joint is held, or was last.
        held: [4] bool.
        strength: [4] in [0, 1]: rises to 1 when a joint is held, and dies away when it is let go.
        offsets: [4, 3] metres from the unheld to the corrected joint.
        velocities: [4, 3] metres per second, of the offsets.
        drop: [2] metres by which the hips are lowered, and its speed in metres per second.
    """

    positions: jax.Array
    held: jax.Array
    strength: jax.Array
    offsets: jax.Array
    velocities: jax.Array
    drop: jax.Array


def initial_locks(rig: Rig, dtype: Any = jnp.float32) -> FootLocks:
    """Nothing held; the rig is that of the body whose feet it is for."""
    zero, none = jnp.zeros((len(rig.feet), 3), dtype), jnp.zeros(len(rig.feet), dtype)
    return FootLocks(
        positions=zero, held=none > 0.0, strength=none, offsets=zero, velocities=zero, drop=jnp.zeros(2, dtype)
    )


def lock_feet(
    rig: Rig, pose: Pose, contacts: jax.Array, locks: FootLocks, config: FootLockConfig | None = None
) -> tuple[Pose, FootLocks]:
    """One frame: the pose with its feet held where they are in contact.

    Args:
        rig: the body.
        pose: as the network predicts it, before any correction of its feet.
        contacts: [4] in [0, 1]: left heel, left toe, right heel, right toe.
        locks: after the frame before; `initial_locks` at first.
        config: thresholds and times.

    Returns:
        The corrected pose: of its joints only hips' place, hip, knee and heel joints differ; and the locks.

    Source: Mason et al. 2022, section 4.4; thresholds after the demo of Holden et al. 2017.
    """
    config = config or FootLockConfig()
    positions, world = forward_kinematics(rig, pose)
    feet = positions[np.array(rig.feet)]
    locks = _advance(rig, feet, contacts, locks, config)
    targets = feet + locks.offsets
    targets = targets.at[:, 1].max(config.floor)
    needed = _needed_drop(rig, positions, targets, config)
    drop, speed = critically_damped_step(locks.drop[0] - needed, locks.drop[1], config)
    locks = replace(locks, drop=jnp.stack([needed + drop, speed]))
    lowered = jnp.stack([jnp.zeros_like(needed), -locks.drop[0], jnp.zeros_like(needed)])
    pose = replace(pose, hips=pose.hips + lowered)
    positions = positions + lowered[None]
    shares = _smooth(locks.strength[np.array([1, 3])])
    return _place_feet(rig, pose, positions, world, targets.reshape(2, 2, 3), shares), locks


def _advance(rig: Rig, feet: jax.Array, contacts: jax.Array, locks: FootLocks, config: FootLockConfig) -> FootLocks:
    """The locks of this frame: offsets [4, 3] that hold, follow the held partner, or die away."""
    limits = np.array([config.heel_limit, config.toe_limit] * 2) * rig.leg_length
    gap = locks.positions - feet
    rise = np.array([[1.0, config.heel_rise, 1.0], [1.0, 1.0, 1.0]] * 2)  # as heels leave the ground before toes do
    kept = locks.held & (contacts >= config.release_threshold) & (_squared(gap * rise) < limits**2)
    # What is not held dies away towards the offset of its partner, which moves: towards, and beside, it.
    leads = kept[np.array(PARTNER), None]
    goal, before, speed = (
        jnp.where(leads, values[np.array(PARTNER)], 0.0) for values in (gap, locks.offsets, locks.velocities)
    )
    away, away_velocity = critically_damped_step(locks.offsets - before, locks.velocities - speed, config)
    free, near = goal + away, _squared(away) < (config.hold_within * rig.leg_length) ** 2
    starting = ~locks.held & (contacts >= config.lock_threshold) & near
    held = kept | starting
    offsets = jnp.where(kept[:, None], gap, free)
    moving = away_velocity + jnp.where(leads, (goal - before) * config.fps, 0.0)
    return replace(
        locks,
        positions=jnp.where(starting[:, None], feet + free, locks.positions),
        held=held,
        strength=jnp.clip(
            locks.strength + jnp.where(held, 1.0 / config.hold, -1.0 / config.release) / config.fps, 0.0, 1.0
        ),
        offsets=offsets,
        velocities=jnp.where(kept[:, None], (offsets - locks.offsets) * config.fps, moving),
    )


def critically_damped_step(
    offset: jax.Array, velocity: jax.Array, config: FootLockConfig
) -> tuple[jax.Array, jax.Array]:
    """A critically damped spring at rest at 0, one frame later: exact for any step."""
    dt, rate = 1.0 / config.fps, SETTLED / config.release
    push, fade = velocity + rate * offset, math.exp(-rate * dt)
    return (offset + push * dt) * fade, (velocity - push * (rate * dt)) * fade


def _needed_drop(rig: Rig, positions: jax.Array, targets: jax.Array, config: FootLockConfig) -> jax.Array:
    """[] metres by which the hips must sink for both heels to be within reach."""
    drops = []
    for side, (hip, knee, heel, _) in enumerate(rig.legs):
        reach = 0.995 * (length(positions[knee] - positions[hip]) + length(positions[heel] - positions[knee]))
        # No further than the unheld leg is stretched: the hips sink for a target, not for a straight leg.
        reach = jnp.maximum(reach, length(positions[heel] - positions[hip]))
        to = targets[2 * side] - positions[hip]
        level = to[0] * to[0] + to[2] * to[2]
        drops.append(-to[1] - jnp.sqrt(jnp.maximum(reach * reach - level, 1e-6)))
    return jnp.clip(jnp.maximum(*drops), 0.0, config.max_drop * rig.leg_length)


def _place_feet(
    rig: Rig, pose: Pose, positions: jax.Array, world: jax.Array, targets: jax.Array, toe_shares: jax.Array
) -> Pose:
    """The pose with heels and toes at targets [2, 2, 3], both legs at once."""
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
    """Turns [4] of hip, knee and foot for heel and toe at targets [2, 3], made as far apart as they are.

    Where the two do not fit, the toe's decides as far as its share goes, and the heel's otherwise.
    """
    along = targets[1] - targets[0]
    turn = quat_between(toe - heel, along)
    place = targets[0] + toe_share * (along - quat_rotate(turn, toe - heel))
    over, under, _ = bend(hip, knee, heel, place, pole)
    return over, under, turn


def _squared(v: jax.Array) -> jax.Array:
    """[4] squared lengths of v [4, 3]."""
    return jnp.sum(v * v, axis=-1)


def _smooth(share: jax.Array) -> jax.Array:
    """A share in [0, 1] that begins and ends level."""
    return share * share * (3.0 - 2.0 * share)
