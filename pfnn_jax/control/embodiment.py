"""From a network's output to a body: rotations in the world, and which parts of the feet are on the ground."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.ground import root_yaw
from pfnn_jax.control.ik.pose import Rig
from pfnn_jax.control.loop.blocks import read_block
from pfnn_jax.control.loop.state import CharacterState
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.kinematics import quat_exp, quat_from_forward_up, quat_from_yaw, quat_multiply
from pfnn_jax.motion.labels.contacts import MAX_HEIGHT, MAX_SPEED


def predicted_rotations(layout: FrameLayout, y: jax.Array, facing: jax.Array) -> jax.Array:
    """Rotations [J, 4] in the world that y [Dy] gives the joints, seen from a root facing [2]."""
    if layout.has_output("joint_rotation"):
        local = quat_exp(read_block(layout, y, "joint_rotation", 3))
    else:
        local = quat_from_forward_up(*(read_block(layout, y, name, 3) for name in ("joint_forward", "joint_up")))
    return turn_rotations(local, root_yaw(facing))


def turn_rotations(rotations: jax.Array, angle: jax.Array) -> jax.Array:
    """Rotations [J, 4] in the world, turned by an angle [] radians about +Y."""
    return quat_multiply(quat_from_yaw(angle)[None], rotations)


def mix_rotations(old: jax.Array, new: jax.Array, share: jax.Array) -> jax.Array:
    """Rotations [J, 4] a share [] of the way from old to new, which lie near each other; beyond 1 also past it."""
    same = jnp.sum(old * new, axis=-1, keepdims=True) >= 0.0
    mixed = old + share * (jnp.where(same, new, -new) - old)
    return mixed * jax.lax.rsqrt(jnp.maximum(jnp.sum(mixed * mixed, axis=-1, keepdims=True), 1e-12))


def feet_clearance(motion: CharacterState, rig: Rig, rest: jax.Array) -> jax.Array:
    """[] metres: how high the higher foot is, by the lower of its heel and toe, above where they stand (`rest` [4])."""
    heights = motion.joint_positions[np.array(rig.feet), 1] - rest
    return jnp.max(jnp.min(heights.reshape(2, 2), axis=1))


def predicted_contacts(
    layout: FrameLayout, y: jax.Array, motion: CharacterState, rig: Rig, rest: jax.Array
) -> jax.Array:
    """[4] in [0, 1], how surely left heel, left toe, right heel and right toe stand on the ground.

    As y [Dy] tells; with two contacts, heel and toe share one. A layout without contacts has them from the feet of
    the state before the next frame, by the rule that labels clips (`motion.contacts`): slow, and not far above `rest`
    [4] metres.
    """
    if layout.has_output("contacts"):
        return jnp.clip(y[layout.output_slice("contacts")], 0.0, 1.0)
    if layout.has_output("foot_contacts"):
        right, left = jnp.clip(y[layout.output_slice("foot_contacts")], 0.0, 1.0)
        return jnp.stack([left, left, right, right])
    feet = np.array(rig.feet)
    velocity = motion.joint_velocities[feet]
    speed = jnp.sqrt(jnp.sum(velocity * velocity, axis=-1) + 1e-12) / (MAX_SPEED * rig.leg_length)
    height = (motion.joint_positions[feet, 1] - rest) / (MAX_HEIGHT * rig.leg_length)
    # One half on the rule's limit; sure at half of it, and gone at half as much again.
    return jnp.clip(1.5 - jnp.maximum(speed, height), 0.0, 1.0)
