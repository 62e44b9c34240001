"""The pose of one character on rigid bones, in JAX: local joint rotations and forward kinematics.

`Rig` and `forward_kinematics` are for one frame what `motion.skeleton.Skeleton` and `motion.kinematics` are for a clip:
a rig is static and hashable, a pose holds arrays, and everything is differentiable and works under `vmap`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.errors import InputError
from pfnn_jax.motion.kinematics import quat_conjugate, quat_multiply, quat_rotate
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
    """

    parents: tuple[int, ...]
    offsets: tuple[tuple[float, float, float], ...]
    legs: tuple[tuple[int, int, int, int], ...]
    arms: tuple[tuple[int, ...], ...]
    leg_length: float

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
    legs_length = np.mean([lengths[_between(skeleton, hip, heel)].sum() for hip, _, heel, _ in legs])
    return Rig(
        parents=tuple(int(parent) for parent in skeleton.parents),
        offsets=tuple((float(x), float(y), float(z)) for x, y, z in skeleton.offsets),
        legs=legs,
        arms=arms if all(len(arm) > 1 for arm in arms) else (),
        leg_length=float(legs_length),
    )


def forward_kinematics(rig: Rig, pose: Pose) -> tuple[jax.Array, jax.Array]:
    """Returns world positions [J, 3] in metres and world rotations [J, 4] of all joints.

    Pointer doubling: each round doubles the number of ancestors that a joint's transform includes, so a body of 25
    joints takes four rounds over all joints instead of one per level of the tree.
    """
    turn, shift = pose.rotations, jnp.asarray(np.array(rig.offsets), pose.rotations.dtype)
    shift = jnp.concatenate([pose.hips[None], shift[1:]])
    for above, rows in _rounds(rig.parents):
        over, behind = turn[above], rows[:, None]
        shift = jnp.where(behind, shift[above] + quat_rotate(over, shift), shift)
        turn = jnp.where(behind, quat_multiply(over, turn), turn)
    return shift, turn


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


def _rounds(parents: Sequence[int]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns for each round the ancestor whose transform is composed, and which joints still have one."""
    above, rounds = np.array(parents), []
    while (above >= 0).any():
        rounds.append((np.maximum(above, 0), above >= 0))
        above = np.where(above >= 0, above[np.maximum(above, 0)], -1)
    return rounds


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
