"""The pose of one character on rigid bones, in JAX: local joint rotations and forward kinematics.

`Rig` and `forward_kinematics` are for one frame what `motion.skeleton.Skeleton` and `motion.kinematics` are for a clip:
a rig is static and hashable, a pose holds arrays, and everything is differentiable and works under `vmap`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.errors import InputError
from pfnn_jax.motion.kinematics import joint_levels, quat_conjugate, quat_multiply, quat_rotate
from pfnn_jax.motion.roles import chain_up
from pfnn_jax.motion.skeleton import Skeleton, need_roles

MIN_BONE_LENGTH = 1e-4  # metres; a shorter bone has no direction


@dataclass(frozen=True)
class Rig:
    """The static part of a body. Hashable: a static argument of compiled functions.

    Attributes:
        parents: J parent indices, -1 for the root.
        offsets: J offsets in metres from the parent, in the parent's frame.
        legs: (hip, knee, heel, toe) of the left and of the right leg; the heel is the ankle joint. In a skeleton
            without toes, toe and heel are one joint.
        arms: joints from shoulder to hand of the left and of the right arm, without those of zero length; empty if
            there are none.
        leg_length: metres from hip to ankle along the bones, the mean of both legs.
        resting_heights: metres of heel and toe of the left and of the right foot above the floor while it stands flat,
            if the skeleton knows them.
    """

    parents: tuple[int, ...]
    offsets: tuple[tuple[float, float, float], ...]
    legs: tuple[tuple[int, int, int, int], ...]
    arms: tuple[tuple[int, ...], ...]
    leg_length: float
    resting_heights: tuple[tuple[float, float], tuple[float, float]] | None = None

    @property
    def num_joints(self) -> int:
        """Returns J."""
        return len(self.parents)

    @property
    def chest(self) -> int | None:
        """Returns the last joint above both arms, or None without arms or if that is the root."""
        if not self.arms:
            return None
        left, right = (chain_up(np.array(self.parents), arm[0])[1:] for arm in self.arms)
        shared = next((joint for joint in left if joint in right), 0)
        return int(shared) or None

    @property
    def feet(self) -> tuple[int, int, int, int]:
        """Returns the joints in the order of contacts: left heel, left toe, right heel, right toe."""
        (_, _, *left), (_, _, *right) = self.legs
        return (left[0], left[1], right[0], right[1])


@struct.dataclass(kw_only=True)
class Pose:
    """A pose of a body with rigid bones.

    Attributes:
        hips: [3] metres, position of joint 0 in the world.
        rotations: [J, 4] wxyz, each joint's rotation in its parent's frame (joint 0: in the world).
    """

    hips: jax.Array
    rotations: jax.Array


def make_rig(skeleton: Skeleton, source: str | Path = "skeleton") -> Rig:
    """Returns the rig of a skeleton with roles.

    The knee is the joint between hip and ankle nearest to the middle of the leg; other joints between them, such as
    twist joints and joints without length, are not bent.

    Args:
        skeleton: J joints.
        source: file of the skeleton, for messages.

    Raises:
        InputError: if roles are missing, or a leg has no knee.
    """
    roles = need_roles(skeleton, source)
    legs = tuple(
        (hip, _middle(skeleton, hip, foot[0], source), foot[0], foot[1])
        for hip, foot in ((roles.left_hip, roles.left_foot), (roles.right_hip, roles.right_foot))
    )
    arms = tuple(
        _arm(skeleton, *pair)
        for pair in ((roles.left_shoulder, roles.left_hand), (roles.right_shoulder, roles.right_hand))
    )
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    resting = None if skeleton.resting_heights is None else np.asarray(skeleton.resting_heights, float).tolist()
    legs_length = np.mean([lengths[_between(skeleton, hip, heel)].sum() for hip, _, heel, _ in legs])
    return Rig(
        parents=tuple(int(parent) for parent in skeleton.parents),
        offsets=tuple((float(x), float(y), float(z)) for x, y, z in skeleton.offsets),
        legs=legs,
        arms=arms if all(len(arm) > 1 for arm in arms) else (),
        leg_length=float(legs_length),
        resting_heights=None if resting is None else ((resting[0][0], resting[0][1]), (resting[1][0], resting[1][1])),
    )


def forward_kinematics(rig: Rig, pose: Pose) -> tuple[jax.Array, jax.Array]:
    """Returns world positions [J, 3] in metres and world rotations [J, 4] of all joints.

    One step for each level of the tree, over the joints of that level.
    """
    offsets, before = np.array(rig.offsets), np.zeros(1, int)
    shift, turn, order = [pose.hips[None]], [pose.rotations[:1]], [before]
    for joints, above in joint_levels(rig.parents):
        parents = np.searchsorted(before, above)  # a joint's parent is in the level before, in ascending order
        over, at = turn[-1][parents], jnp.asarray(offsets[joints], pose.rotations.dtype)
        shift.append(shift[-1][parents] + quat_rotate(over, at))
        turn.append(quat_multiply(over, pose.rotations[joints]))
        order.append(before := joints)
    places = np.argsort(np.concatenate(order))
    return jnp.concatenate(shift)[places], jnp.concatenate(turn)[places]


def pose_from_world(rig: Rig, hips: jax.Array, world_rotations: jax.Array) -> Pose:
    """Returns the pose with these world rotations [J, 4] of the joints and joint 0 at `hips` [3]."""
    above = world_rotations[np.maximum(rig.parents, 0)]
    local = quat_multiply(quat_conjugate(above), world_rotations)
    return Pose(hips=hips, rotations=jnp.concatenate([world_rotations[:1], local[1:]]))


def turn_joint(rig: Rig, pose: Pose, world: jax.Array, joint: int, delta: jax.Array) -> Pose:
    """Turns a joint and its descendants by `delta` [4] in the world.

    Args:
        rig, pose: the body.
        world: [J, 4] world rotations of `pose`; only that of the joint's parent is read.
        joint: index.
        delta: unit quaternion.
    """
    parent = rig.parents[joint]
    local = delta
    if parent >= 0:
        local = quat_multiply(quat_conjugate(world[parent]), quat_multiply(delta, world[parent]))
    return replace(pose, rotations=pose.rotations.at[joint].set(quat_multiply(local, pose.rotations[joint])))


def _between(skeleton: Skeleton, top: int, end: int) -> list[int]:
    """Returns the joints below `top` down to `end`, in order."""
    chain = chain_up(skeleton.parents, end)
    return chain[: chain.index(top)][::-1] if top in chain else []


def _middle(skeleton: Skeleton, hip: int, heel: int, source: str | Path) -> int:
    chain = _between(skeleton, hip, heel)
    lengths = np.cumsum(np.linalg.norm(skeleton.offsets[chain], axis=-1))
    shorter = np.minimum(lengths[:-1], lengths[-1] - lengths[:-1]) if len(chain) > 1 else np.zeros(0)
    if not len(shorter) or shorter.max() < MIN_BONE_LENGTH:
        found = f"{skeleton.names[hip]} to {skeleton.names[heel]}"
        raise InputError(source, "skeleton", found, "a leg needs a knee between hip and ankle")
    return chain[int(np.argmax(shorter))]


def _arm(skeleton: Skeleton, shoulder: int, hand: int) -> tuple[int, ...]:
    below = [j for j in _between(skeleton, shoulder, hand) if np.linalg.norm(skeleton.offsets[j]) > MIN_BONE_LENGTH]
    return (shoulder, *below)
