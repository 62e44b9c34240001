"""Inverse kinematics of limbs in a pose: two bones to a target, and arms to predicted positions, bone by bone.

Bones keep their lengths because only rotations change. `pfnn_jax.motion.two_bone` holds the closed form.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp

from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, turn_joint
from pfnn_jax.motion.kinematics import quat_between, quat_conjugate, quat_multiply, quat_rotate
from pfnn_jax.motion.two_bone import bend

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

    Targets within `two_bone.SOFT` of its length (or within its present stretch) are reached; beyond, the limb stretches
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


def reach_arms(rig: Rig, pose: Pose, predicted: jax.Array, placed: tuple[jax.Array, jax.Array] | None = None) -> Pose:
    """Lays the arms along predicted positions, bone by bone from the shoulders.

    Each bone is turned by the shortest arc towards the predicted position of its far end; its length stays. Mixed
    styles can predict rotations that do not fit the positions; positions mix well.

    Args:
        rig, pose: the body.
        predicted: [J, 3] metres in the world; only the joints of the arms below the shoulders are read.
        placed: positions and rotations of the pose in the world, if they are known.

    Source: Mason et al. 2022, section 4.4.
    """
    positions, world = placed or forward_kinematics(rig, pose)
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
