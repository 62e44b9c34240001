"""A rigged character of a glTF file as a skeleton of this package, whose zero pose is the character's bind pose.

With Q the world rotation of a joint's node and B that in the bind pose, the joint's rotation is G = Q B⁻¹: how far it
has turned from the bind pose. All else (humanoid map, reference pose, retargeting) is as for any other skeleton.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.bind_pose import MAX_JOINTS, bind_matrices, mesh_nodes, read_skins
from pfnn_jax.motion.gltf.container import Document, read_document
from pfnn_jax.motion.gltf.geometry import Part, read_parts
from pfnn_jax.motion.gltf.ground import with_ground
from pfnn_jax.motion.gltf.nodes import NodeTree, is_regular, nearest_rotation, read_nodes
from pfnn_jax.motion.gltf.vrm import humanoid_nodes
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import find_humanoid
from pfnn_jax.motion.humanoid.map import LEG, SIDES, HumanoidMap
from pfnn_jax.motion.humanoid.overrides import read_overrides_file
from pfnn_jax.motion.humanoid.pairs import find_mirror
from pfnn_jax.motion.humanoid.tree import joint_tree
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.length_unit import POSSIBLE_LEG
from pfnn_jax.motion.roles import missing_roles, roles_of
from pfnn_jax.motion.skeleton import Skeleton

USUAL_LEG = 0.85
"""Metres from hip to ankle that a character is given whose own size no person has."""

STRAIGHT_AHEAD = np.deg2rad(3.0)
"""A character that faces an axis to this angle faces along it."""


@dataclass(frozen=True, eq=False)
class Placement:
    """From the scene of a file to our space: ours = scale * rotate(rotation, scene) + translation.

    Attributes:
        scale: metres per unit of the file.
        rotation: [4] wxyz, to Y up and facing +Z.
        translation: [3] metres, which puts the feet onto y = 0 and the hips above the origin.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray

    def to_ours(self, points: np.ndarray) -> np.ndarray:
        """Returns points [..., 3] of the scene in our space."""
        return self.scale * quat_rotate(self.rotation, points) + self.translation

    def to_scene(self, points: np.ndarray) -> np.ndarray:
        """Returns points [..., 3] of our space in the scene."""
        return quat_rotate(quat_conjugate(self.rotation), (points - self.translation) / self.scale)


@dataclass(frozen=True, eq=False)
class Character:
    """A rigged character.

    Attributes:
        document: its file.
        skeleton: J joints in metres, Y up, facing +Z. Zero rotations are the bind pose. A foot that is a child of the
            root in the file is under its leg here.
        nodes: [J] node of each joint.
        bind_positions: [J, 3] metres, joints in the bind pose, in our space.
        bind_rotations: [J, 4] world rotations of the nodes in the bind pose, in our space.
        placement: from the scene of the file to our space.
        notes: one line for each assumption that may be wrong.
    """

    document: Document
    skeleton: Skeleton
    nodes: np.ndarray
    bind_positions: np.ndarray
    bind_rotations: np.ndarray
    placement: Placement
    notes: tuple[str, ...]


def read_character(path: str | Path, *, unit: float | None = None, roles_file: str | Path | None = None) -> Character:
    """Reads the rig of a `.glb`, `.gltf` or `.vrm` file.

    Args:
        path: file to read.
        unit: metres per unit of the file; None takes metres, as glTF says, unless no person has such legs.
        roles_file: JSON object from bone or role to joint name, for joints that are found wrongly.

    Raises:
        InputError: for a malformed file, one without a skin, or one whose joints are no humanoid.
    """
    document = read_document(path)
    if not document.items("skins"):
        rule = "must be a rigged character: export it with its skeleton and skin"
        raise InputError(document.path, "skins", "none", rule)
    return character_of(document, unit=unit, roles_file=roles_file)


def character_of(
    document: Document, *, unit: float | None = None, roles_file: str | Path | None = None, joints: Collection[int] = ()
) -> Character:
    """Returns the rig of a file that was read.

    Args:
        document: the file.
        unit, roles_file: as in `read_character`.
        joints: nodes that are joints in a file without a skin, whose pose is then taken as the bind pose.

    Raises:
        InputError: as `read_character`.
    """
    tree, skins = read_nodes(document), read_skins(document)
    bind = bind_matrices(tree, skins, mesh_nodes(document, len(skins)))
    nodes = _joint_nodes(tree, {joint for skin in skins for joint in skin.joints} or set(joints))
    if len(nodes) > MAX_JOINTS:
        raise InputError(document.path, "skins", f"{len(nodes)} joints", f"must be at most {MAX_JOINTS}")
    for node in nodes:
        if not is_regular(bind[node][:3, :3]):
            rule = "must not flatten space in the bind pose: its scales must not be 0"
            raise InputError(document.path, f"nodes[{node}]", "singular", rule)
    humanoid = _find_body(document, tree, nodes, bind, roles_file)
    nodes, parents, humanoid = _order_below_legs(document, tree, nodes, humanoid)
    parts = read_parts(document, tree, skins, bind, nodes)
    return _placed(document, tree, bind, nodes, parents, humanoid, parts, unit)


def _joint_nodes(tree: NodeTree, joints: set[int]) -> list[int]:
    """Returns the nodes of joints and all between them, parents first, up to one that is above all."""
    chains = [tree.above(joint)[::-1] for joint in sorted(joints)]
    shared = 0
    while all(len(chain) > shared + 1 for chain in chains) and len({chain[shared + 1] for chain in chains}) == 1:
        shared += 1
    if len({chain[0] for chain in chains}) > 1:
        return _without_common_root(tree, joints)
    kept = {node for chain in chains for node in chain[shared:]}
    return [int(node) for node in tree.order if node in kept]


def _without_common_root(tree: NodeTree, joints: set[int]) -> list[int]:
    """Returns the joints under that top node which has the most of them: others stand in the scene without a body."""
    tops = {joint: tree.above(joint)[-1] for joint in joints}
    counts = Counter(tops.values())
    most = max(sorted(counts), key=counts.__getitem__)
    return _joint_nodes(tree, {joint for joint, top in tops.items() if top == most})


def _skeleton(tree: NodeTree, nodes: list[int], places: np.ndarray, parents: dict[int, int]) -> Skeleton:
    """Returns joints with given parents and places [J, 3], under their names in the file, without a map."""
    rows = {node: row for row, node in enumerate(nodes)}
    above = np.array([rows.get(parents[node], -1) for node in nodes])
    offsets = np.where((above >= 0)[:, None], places - places[above], 0.0)
    names = tuple(tree.names[node] for node in nodes)
    return Skeleton(names, above, offsets, (), np.arange(len(nodes)))


def _find_body(
    document: Document, tree: NodeTree, nodes: list[int], bind: np.ndarray, roles_file: str | Path | None
) -> HumanoidMap:
    """Returns the humanoid map of the joints, from the user's file, the map of a VRM file, or names and places.

    Raises:
        InputError: if the joints are no humanoid.
    """
    places = bind[nodes][:, :3, 3]
    skeleton = _skeleton(tree, nodes, places, {node: int(tree.parents[node]) for node in nodes})
    if roles_file is not None:
        skeleton = replace(skeleton, names=_unique(skeleton.names, nodes))
        overrides = read_overrides_file(Path(roles_file))
        return find_humanoid(skeleton, poses=places[None], overrides=overrides, source=roles_file)
    rows = {node: row for row, node in enumerate(nodes)}
    bones = {bone: node for bone, node in humanoid_nodes(document).items() if node in rows}
    if bones:
        skeleton = replace(skeleton, names=_unique(skeleton.names, nodes))
        overrides = {bone: skeleton.names[rows[node]] for bone, node in bones.items()}
        return find_humanoid(skeleton, poses=places[None], overrides=overrides, source=document.path)
    return find_humanoid(skeleton, poses=places[None], source=document.path)


def _order_below_legs(
    document: Document, tree: NodeTree, nodes: list[int], body: HumanoidMap
) -> tuple[list[int], dict[int, int], HumanoidMap]:
    """Returns joints with feet under their legs, parents first; the parent of each; and the map of the new order.

    Raises:
        InputError: if each leg is below the other leg's foot.
    """
    parents = {node: int(tree.parents[node]) for node in nodes}
    for side in SIDES:
        _, shin, foot, _ = body.limb(side, LEG)
        if shin is not None and foot is not None and not _is_below(parents, nodes[foot], nodes[shin]):
            parents[nodes[foot]] = nodes[shin]
    order: list[int] = []
    waiting = list(nodes)
    while waiting:
        left = set(waiting)
        ready = [node for node in waiting if parents[node] not in left]
        if not ready:
            rule = "must not have legs below each other's feet: name the joints in a roles file"
            raise InputError(document.path, "skeleton", "feet above legs", rule)
        order += ready
        waiting = [node for node in waiting if parents[node] in left]
    rows = {node: row for row, node in enumerate(order)}
    return order, parents, body.move(lambda joint: rows[nodes[joint]])


def _is_below(parents: dict[int, int], node: int, other: int) -> bool:
    while node in parents:
        if node == other:
            return True
        node = parents[node]
    return False


def _placed(
    document: Document,
    tree: NodeTree,
    bind: np.ndarray,
    nodes: list[int],
    parents: dict[int, int],
    body: HumanoidMap,
    parts: list[Part],
    unit: float | None,
) -> Character:
    """Returns the character, turned and scaled to our space."""
    places = bind[nodes][:, :3, 3]
    bare = _skeleton(tree, nodes, places, parents)
    ground = _ground(bare, body, places, parts)
    scale, notes = _metres(document, _leg(bare, body, places, ground), unit)
    rotation = quat_from_yaw(-_yaw(places, body))
    hips = scale * quat_rotate(rotation, places[body.hips])
    shift = -np.array([hips[0], scale * ground, hips[2]])
    placement = Placement(scale, rotation, shift)
    ours = placement.to_ours(places)
    skeleton = replace(_skeleton(tree, nodes, ours, parents), names=_unique(bare.names, nodes), humanoid=body)
    roles = None if missing_roles(body) else roles_of(body, skeleton.names, document.path)
    skeleton = with_ground(replace(skeleton, mirror=find_mirror(skeleton, body), roles=roles), ours)
    turns = np.stack([quat_multiply(rotation, nearest_rotation(matrix[:3, :3])) for matrix in bind[nodes]])
    return Character(document, skeleton, np.array(nodes), ours, turns, placement, notes)


def _ground(skeleton: Skeleton, body: HumanoidMap, places: np.ndarray, parts: list[Part]) -> float:
    """Returns the height [scene] on which the body stands: that of the lowest vertex below the knees, or joint of legs.

    A cloak or a tail may hang lower than the feet.
    """
    tree = joint_tree(tuple(skeleton.parents.tolist()))
    shins = [body.left_shin, body.right_shin]
    lower = np.zeros(skeleton.num_joints, bool)
    lower[[joint for shin in shins for joint in tree.below(shin)]] = True
    heights = [part.vertices[lower[part.joints[:, 0]], 1] for part in parts]
    lowest = [float(each.min()) for each in heights if len(each)]
    feet = [joint for side in SIDES for joint in body.limb(side, LEG) if joint is not None]
    return min(lowest) if lowest else float(places[feet, 1].min())


def _leg(skeleton: Skeleton, body: HumanoidMap, places: np.ndarray, ground: float) -> float:
    """Returns the length of a leg in the scene: to the ankle or, where it has no foot, to the ground."""
    if body.left_foot is not None and body.right_foot is not None:
        return leg_length_of(skeleton, body)
    return float(places[[body.left_thigh, body.right_thigh], 1].mean()) - ground


def _metres(document: Document, leg: float, unit: float | None) -> tuple[float, tuple[str, ...]]:
    """Returns metres per unit, and notes. glTF says metres; a leg that no person has is given a person's length."""
    if not leg > 1e-9:
        raise InputError(document.path, "skeleton", "a leg of no length", "hips, knees and ankles must be apart")
    shortest, longest = POSSIBLE_LEG
    if unit is not None and not shortest <= leg * unit <= longest:
        rule = f"legs must be {shortest:g} to {longest:g} m long: leave out `--unit`"
        raise InputError(document.path, "unit", f"{unit:g} m, legs of {leg * unit:.3g} m", rule)
    if unit is not None or shortest <= leg <= longest:
        return unit or 1.0, ()
    scale = USUAL_LEG / leg
    note = f"legs of {leg:.3g} units: one unit of the file is taken as {scale:.3g} m; pass `--unit` if that is wrong"
    return scale, (note,)


def _yaw(places: np.ndarray, body: HumanoidMap) -> float:
    """Returns the direction that a body faces in radians about +Y; one near an axis is that axis."""
    across = places[body.left_thigh] - places[body.right_thigh]
    if body.left_upper_arm is not None and body.right_upper_arm is not None:
        across = across + places[body.left_upper_arm] - places[body.right_upper_arm]
    yaw = float(np.arctan2(-across[2], across[0]))
    axis = np.round(yaw / (np.pi / 2)) * (np.pi / 2)
    return float(axis) if abs(yaw - axis) < STRAIGHT_AHEAD else yaw


def _unique(names: tuple[str, ...], nodes: list[int]) -> tuple[str, ...]:
    """Returns names of which no two are alike: a joint without a name, or with that of another, is given its number."""
    found: list[str] = []
    for name, node in zip(names, nodes, strict=True):
        base = (name if name.isprintable() else ascii(name)) or "joint"
        unique = base if name else f"{base}_{node}"
        while unique in found:
            unique = f"{unique}_{node}"
        found.append(unique)
    return tuple(found)
