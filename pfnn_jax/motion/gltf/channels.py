"""Turns a motion of a character into keys of the nodes of its file.

World transforms of the joints become local ones of each node's real parent in the file. Where the file's tree is not
the skeleton's (feet that are children of the root), where a node was left in the middle of another clip, or where
scales stand above the joints, the keys that are needed follow by themselves: a property is keyed if the pose of the
file would put the joint elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.append import Channel, Property
from pfnn_jax.motion.gltf.character import Character
from pfnn_jax.motion.gltf.nodes import NodeTree, is_regular, read_nodes
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.humanoid.tree import joint_tree
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_multiply,
    quat_rotate,
    quat_to_matrix,
)
from pfnn_jax.motion.retargeting.body import body_joints
from pfnn_jax.motion.roles import chain_up
from pfnn_jax.motion.root_motion import RootMotion

SAME_PLACE = 3e-5
"""Leg lengths by which a joint may be off where no translation is keyed."""

SAME_ROTATION = 1e-4
"""Difference of quaternion components up to which no rotation is keyed on a joint that is no part of the body."""


@dataclass(frozen=True, eq=False)
class _Pose:
    """World transforms of one node in the frame of the scene, for T frames or for one that holds for all.

    Attributes:
        positions: [T, 3] in the units of the file.
        rotations: [T, 4], without scales.
        linear: [T, 3, 3] with the scales of the node and of all above it.
    """

    positions: np.ndarray
    rotations: np.ndarray
    linear: np.ndarray


def clip_channels(character: Character, clip: MotionClip, root: RootMotion | None = None) -> list[Channel]:
    """Returns the keys of a character's nodes for a clip on its skeleton.

    Joints of the body have rotation keys. Translations are keyed on the hips, and on joints that their parent in the
    file does not carry to their place. A root joint above the hips stands as in the bind pose, or travels by `root`;
    without such a joint the travel is on the hips. No node is added.

    Args:
        character: the file.
        clip: T frames on `character.skeleton`; in place if `root` is its travel.
        root: travel to add.

    Raises:
        InputError: if a scale of 0 above a joint leaves it no place to be moved to.
    """
    skeleton, tree = character.skeleton, read_nodes(character.document)
    body = need_humanoid(skeleton, character.document.path)
    wanted = _wanted(character, clip, body, root)
    hips, always = int(character.nodes[body.hips]), {int(character.nodes[joint]) for joint in body_joints(body)}
    top = _root_bone(character, tree, hips)
    if top != hips and top not in wanted and root is not None:
        wanted[top] = _moved(character, root, *_file_pose_in_ours(tree, top, character))
    near = SAME_PLACE * leg_length_of(skeleton, body) / character.placement.scale
    poses: dict[int, _Pose] = {}
    channels = []
    for node in _in_order(tree, wanted):
        if not is_regular(_above_node(tree, int(tree.parents[node]), poses).linear[0]):
            rule = "must have a scale: save the file while the character is visible"
            raise InputError(character.document.path, f"nodes[{node}]", "a scale of 0 above it", rule)
        pose, keys = _pose_node(tree, node, poses, wanted.get(node), hips == node, node in always, near)
        poses[node] = pose
        channels += [Channel(node, path, _all_frames(keys[path], clip.num_frames)) for path in keys]
    return channels


def _wanted(
    character: Character, clip: MotionClip, body: HumanoidMap, root: RootMotion | None
) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Returns world positions and rotations in the scene of the hips, all joints below them and those above."""
    skeleton = character.skeleton
    positions, rotations = forward_kinematics(skeleton, clip.root_positions, clip.rotations)
    rotations = quat_multiply(rotations, character.bind_rotations)
    wanted = {}
    below = sorted(joint_tree(tuple(skeleton.parents.tolist())).below(body.hips))
    above = chain_up(skeleton.parents, body.hips)[:0:-1]  # the root first
    for joint in (*above, *below):
        place, turn = positions[:, joint], rotations[:, joint]
        if joint in above:  # they stand as in the bind pose
            place, turn = character.bind_positions[None, joint], character.bind_rotations[None, joint]
        wanted[int(character.nodes[joint])] = _moved(character, root, place, turn)
    return wanted


def _moved(
    character: Character, root: RootMotion | None, positions: np.ndarray, rotations: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions [T, 3] and rotations [T, 4] of our space, carried by a root, in the frame of the scene."""
    if root is not None:
        positions = root.positions + quat_rotate(root.rotations, positions)
        rotations = quat_multiply(root.rotations, rotations)
    place = character.placement
    return place.to_scene(positions), quat_multiply(quat_conjugate(place.rotation), rotations)


def _file_pose_in_ours(tree: NodeTree, node: int, character: Character) -> tuple[np.ndarray, np.ndarray]:
    """Returns position [1, 3] and rotation [1, 4] of a node of the file's pose in our space."""
    pose, place = _file_pose(tree, node), character.placement
    return place.to_ours(pose.positions), quat_multiply(place.rotation, pose.rotations)


def _file_pose(tree: NodeTree, node: int) -> _Pose:
    """Returns the pose of a node in the file, for one frame."""
    above = _above_node(tree, int(tree.parents[node]), {})
    return _below_parent(tree, node, above, tree.translations[None, node], None)


def _pose_node(
    tree: NodeTree,
    node: int,
    poses: dict[int, _Pose],
    wanted: tuple[np.ndarray, np.ndarray] | None,
    moves: bool,
    turns: bool,
    near: float,
) -> tuple[_Pose, dict[Property, np.ndarray]]:
    """Returns the world transforms of a node, and its keys: "rotation" [T, 4] and "translation" [T, 3], as needed.

    Args:
        tree: the file's.
        node: index; the nodes above it that move are in `poses`.
        poses: of the nodes before.
        wanted: world positions and rotations; None leaves the node as it is in the file.
        moves, turns: whether translation and rotation are keyed in any case.
        near: distance up to which no translation is keyed otherwise, in the units of the file.
    """
    above = _above_node(tree, int(tree.parents[node]), poses)
    translation, rotation = tree.translations[None, node], None
    keys: dict[Property, np.ndarray] = {}
    if wanted is not None:
        positions, rotations = wanted
        carried = above.positions + np.einsum("tij,tj->ti", above.linear, translation)
        if moves or np.linalg.norm(carried - positions, axis=-1).max() > near:
            inverse = np.linalg.inv(above.linear)
            translation = keys["translation"] = np.einsum("tij,tj->ti", inverse, positions - above.positions)
        local = quat_multiply(quat_conjugate(above.rotations), rotations)
        apart = 1.0 - np.abs(np.sum(local * tree.rotations[node], axis=-1))
        if turns or np.sqrt(2.0 * np.maximum(apart, 0.0)).max() > SAME_ROTATION:
            rotation = keys["rotation"] = local
    return _below_parent(tree, node, above, translation, rotation), keys


def _below_parent(
    tree: NodeTree, node: int, above: _Pose, translation: np.ndarray, rotation: np.ndarray | None
) -> _Pose:
    """Returns the pose of a node from that of its parent; without keys of rotation its own matrix holds, with shear."""
    positions = above.positions + np.einsum("tij,tj->ti", above.linear, translation)
    if rotation is None:
        local, rotation = tree.matrices[None, node, :3, :3], tree.rotations[None, node]
    else:
        local = quat_to_matrix(rotation) * tree.scales[node]
    return _Pose(positions, quat_multiply(above.rotations, rotation), above.linear @ local)


def _above_node(tree: NodeTree, parent: int, poses: dict[int, _Pose]) -> _Pose:
    """Returns the pose of a parent: one that moves, or that of the file; of the scene itself for -1."""
    if parent in poses:
        return poses[parent]
    if parent < 0:
        return _Pose(np.zeros((1, 3)), np.array([[1.0, 0.0, 0.0, 0.0]]), np.eye(3)[None])
    return _file_pose(tree, parent)


def _in_order(tree: NodeTree, wanted: dict[int, tuple[np.ndarray, np.ndarray]]) -> list[int]:
    """Returns all nodes from the uppermost wanted ones down to the wanted ones, parents before children."""
    order: list[int] = []
    for node in wanted:
        chain = []
        while node >= 0 and node not in order:
            chain.append(node)
            node = int(tree.parents[node])
        order += chain[::-1]
    return order


def _root_bone(character: Character, tree: NodeTree, hips: int) -> int:
    """Returns the uppermost node above the hips that is a joint of a skin; the hips themselves where there is none."""
    joints = {joint for skin in character.document.json.get("skins", []) for joint in skin["joints"]}
    top, node = hips, int(tree.parents[hips])
    while node >= 0:
        top, node = node if node in joints else top, int(tree.parents[node])
    return top


def _all_frames(values: np.ndarray, num_frames: int) -> np.ndarray:
    return np.broadcast_to(values, (num_frames, values.shape[-1]))
