"""Motion as a headset with trackers captures it: rooted at the head, and without arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_conjugate, quat_multiply, quat_rotate
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.roles import assign_roles, chain_up
from pfnn_jax.motion.skeleton import Skeleton

RIGID = 1e-4
"""Metres by which the bones of a new tree may change in length or direction: rounding."""


def rooted_at_head(clip: MotionClip) -> MotionClip:
    """Returns the same motion with the head as root, as capture by a headset and trackers writes it.

    A joint of the spine hangs from the one above it, and takes the rotation of the joint that was its parent, with
    which the bone between them turns. Its other children move to the joint above, which has its rotation now. The
    hips, the last of the spine, keep their rotation and their legs.
    """
    skeleton = clip.skeleton
    body = humanoid_of(skeleton)
    assert body.head is not None
    spine = chain_up(skeleton.parents, body.head)
    above = {joint: spine[number - 1] for number, joint in enumerate(spine) if number}
    parents = {joint: int(parent) for joint, parent in enumerate(skeleton.parents)}
    parents = {joint: parent if parent == spine[-1] else above.get(parent, parent) for joint, parent in parents.items()}
    headset = skeleton.num_joints
    parents |= {joint: headset for joint, parent in parents.items() if parent == body.head} | above
    parents |= {body.head: headset, headset: -1}
    points, turns = forward_kinematics(skeleton, clip.root_positions, clip.rotations)
    moved = turns.copy()
    moved[:, spine[:-1]] = turns[:, skeleton.parents[spine[:-1]]]
    points, moved = (
        np.concatenate([each, old[:, [body.head]]], axis=1) for each, old in ((points, points), (moved, turns))
    )
    return clip_of(clip, (*skeleton.names, "HMD"), parents, points, moved)


def clip_of(
    clip: MotionClip, names: tuple[str, ...], parents: dict[int, int], points: np.ndarray, turns: np.ndarray
) -> MotionClip:
    """Returns a clip of another tree of joints, from their world positions [T, J, 3] and rotations [T, J, 4].

    Args:
        clip: its other fields.
        names: of the joints.
        parents: of the joints, -1 for the root.
        points, turns: of the joints, in the order of `names`.
    """
    order: list[int] = []
    while len(order) < len(parents):
        order += [joint for joint, parent in parents.items() if joint not in order and parent in (-1, *order)]
    offsets, local = [np.zeros(3)], [turns[:, order[0]]]
    for joint in order[1:]:
        parent = parents[joint]
        bone = quat_rotate(quat_conjugate(turns[:, parent]), points[:, joint] - points[:, parent])
        assert np.abs(bone - bone[0]).max() < RIGID, names[joint]
        offsets.append(bone[0])
        local.append(quat_multiply(quat_conjugate(turns[:, parent]), turns[:, joint]))
    places = np.array([order.index(parents[joint]) if parents[joint] >= 0 else -1 for joint in order])
    skeleton = Skeleton(tuple(names[joint] for joint in order), places, np.array(offsets), (), np.arange(len(order)))
    return replace(clip, skeleton=skeleton, root_positions=points[:, order[0]], rotations=np.stack(local, axis=1))


def without_arms(clip: MotionClip) -> MotionClip:
    """Returns the clip of the body without arms, as a headset and trackers at the legs capture it."""
    skeleton = clip.skeleton
    body = humanoid_of(skeleton)
    arms = {body.left_clavicle, body.right_clavicle, body.left_upper_arm, body.right_upper_arm}
    kept = [joint for joint in range(skeleton.num_joints) if not arms & {*chain_up(skeleton.parents, joint)}]
    parents = np.array([kept.index(parent) if (parent := skeleton.parents[joint]) >= 0 else -1 for joint in kept])
    sites = tuple((kept.index(joint), site) for joint, site in skeleton.end_sites if joint in kept)
    names = tuple(skeleton.names[joint] for joint in kept)
    armless = Skeleton(names, parents, skeleton.offsets[kept], sites, np.arange(len(kept)))
    return replace(clip, skeleton=assign_roles(armless), rotations=clip.rotations[:, kept])
