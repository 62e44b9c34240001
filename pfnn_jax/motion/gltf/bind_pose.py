"""The bind pose of a glTF character: where its joints were when its mesh was bound to them.

A file may be saved in the middle of a clip; the pose that belongs to the mesh is the inverse of the inverse bind
matrices. They are given in the space of the mesh, which is not always that of the scene, and only for joints.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.accessors import read_accessor
from pfnn_jax.motion.gltf.container import Document, shown
from pfnn_jax.motion.gltf.nodes import LARGEST_PLACE, NodeTree, is_regular

MAX_JOINTS = 2_000
"""Most joints of a character and of each of its skins; elaborate rigs have 300."""

MAX_SKINS = 200
"""Most skins; files with a skin for each piece of clothing have a few dozen."""

MAX_SKIN_JOINTS = 40_000
"""Most joints of all skins together: skins of one body repeat its joints."""

SAME_PLACE = 0.02
"""Of the size of the body: joints whose places differ by less are where they were bound."""

CONTROL_REACH = 0.2
"""Of the size of the body: how far a control may be from the joint that it goes with."""

AFFINE = 1e-4
"""Difference of the last row of a matrix from 0, 0, 0, 1 that is rounding."""

SAME_SCALE = 0.1
"""Relative difference of the summed lengths of bones that count as equal; files saved within a clip stretch some."""

MIN_PLACED_SHARE = 0.5
"""Share of the joints that must be at their places for that to count: those near the top are by construction."""


@dataclass(frozen=True, eq=False)
class Skin:
    """The joints of a skin.

    Attributes:
        joints: nodes.
        inverse_bind: [N, 4, 4] from the space of the mesh to that of each joint.
    """

    joints: tuple[int, ...]
    inverse_bind: np.ndarray


def read_skins(document: Document) -> list[Skin]:
    """Returns the skins of a file.

    Raises:
        InputError: if a joint is not a node, an inverse bind matrix is missing, singular or not finite, or for too many
            skins or joints.
    """
    found: list[Skin] = []
    skins, total = document.items("skins"), 0
    if len(skins) > MAX_SKINS:
        raise InputError(document.path, "skins", f"{len(skins)} skins", f"must be at most {MAX_SKINS}")
    for number, skin in enumerate(skins):
        place = f"skins[{number}]"
        joints = skin.get("joints")
        if not isinstance(joints, list) or not joints:
            raise InputError(document.path, f"{place}.joints", "none", "must be a list of nodes")
        total += len(joints)
        if len(joints) > MAX_JOINTS or total > MAX_SKIN_JOINTS:
            rule = f"must be at most {MAX_JOINTS} in a skin, and {MAX_SKIN_JOINTS} in all of them"
            raise InputError(document.path, f"{place}.joints", f"{len(joints)} joints", rule)
        for joint in joints:
            document.item("nodes", joint, f"{place}.joints")
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        if skin.get("inverseBindMatrices") is not None:
            at = f"{place}.inverseBindMatrices"
            values = read_accessor(document, skin["inverseBindMatrices"], "MAT4", at).astype(float)
            if len(values) < len(joints):
                raise InputError(document.path, at, f"{len(values)}", f"must have one for each of {len(joints)} joints")
            inverse = values[: len(joints)].reshape(-1, 4, 4).swapaxes(1, 2)
            for joint, matrix in enumerate(inverse):
                _check_inverse(document, matrix, joint, at)
        found.append(Skin(tuple(joints), inverse))
    return found


def _check_inverse(document: Document, matrix: np.ndarray, joint: int, place: str) -> None:
    if not is_regular(matrix[:3, :3]):
        raise InputError(document.path, place, f"matrix {joint} is singular", "must not flatten space")
    if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], atol=AFFINE):
        raise InputError(document.path, place, f"matrix {joint} ends in {shown(matrix[3].tolist())}", "must be affine")
    if np.abs(matrix).max() > LARGEST_PLACE:
        raise InputError(document.path, place, f"matrix {joint} is too large", f"must be within {LARGEST_PLACE:g}")


def mesh_nodes(document: Document, num_skins: int) -> list[int | None]:
    """Returns a node that shows a mesh with each skin, or None.

    Raises:
        InputError: for a node with a skin that is not there.
    """
    found: list[int | None] = [None] * num_skins
    for number, node in enumerate(document.items("nodes")):
        if node.get("skin") is not None:
            document.item("skins", node["skin"], f"nodes[{number}].skin")
            found[node["skin"]] = number
    return found


def bind_matrices(tree: NodeTree, skins: list[Skin], mesh_nodes: list[int | None]) -> np.ndarray:
    """Returns the world matrices [N, 4, 4] of all nodes in the bind pose, in the space of the scene.

    Joints whose matrices say nothing, as those of controls, go with a joint close below them. Other nodes keep their
    transform relative to their parent.

    Args:
        tree: the nodes in the pose of the file.
        skins: of the file.
        mesh_nodes: a node that shows a mesh with each skin, or None.
    """
    world = tree.world()
    known: dict[int, np.ndarray] = {}
    for skin, mesh_node in sorted(zip(skins, mesh_nodes, strict=True), key=lambda pair: -len(pair[0].joints)):
        useful = _useful(skin)
        bound = np.linalg.inv(skin.inverse_bind)
        space = _mesh_space(tree, skin, useful, bound, world, mesh_node)
        for place in np.flatnonzero(useful):
            known.setdefault(skin.joints[place], space @ bound[place])
    known |= _carried(tree, known, {joint for skin in skins for joint in skin.joints}, world)
    bind = np.empty_like(world)
    for node in tree.order:
        parent = tree.parents[node]
        above = bind[parent] if parent >= 0 else np.eye(4)
        bind[node] = known.get(int(node), above @ tree.matrices[node])
    return bind


def _carried(
    tree: NodeTree, known: dict[int, np.ndarray], joints: set[int], world: np.ndarray
) -> dict[int, np.ndarray]:
    """Returns the bind matrices of joints that have none of their own, where a joint that has one is close below them.

    Args:
        tree: the nodes.
        known: node -> matrix [4, 4] in the bind pose.
        joints: nodes of all joints.
        world: [N, 4, 4] in the pose of the file.
    """
    places = world[sorted(known), :3, 3] if known else np.zeros((1, 3))
    reach = CONTROL_REACH * float(np.ptp(places, axis=0).max())
    nearest = {node: node for node in known}  # the joint at or below each node that is nearest to it
    found: dict[int, np.ndarray] = {}

    def gap(node: int, other: int) -> float:
        return float(np.linalg.norm(world[node, :3, 3] - world[other, :3, 3]))

    for node in (int(each) for each in tree.order[::-1]):
        below, parent = nearest.get(node), int(tree.parents[node])
        if below is None:
            continue
        carried = below != node and node in joints and gap(node, below) < reach
        if carried and is_regular(world[below][:3, :3]):
            found[node] = known[below] @ np.linalg.inv(world[below]) @ world[node]
        if parent >= 0 and parent not in known and gap(parent, below) < gap(parent, nearest.get(parent, below)) + 1e-9:
            nearest[parent] = below
    return found


def _useful(skin: Skin) -> np.ndarray:
    """Returns [N] whether each matrix is one of its own: exporters give joints that move nothing one and the same."""
    if len(skin.joints) == 1:
        return np.array([True])
    _, which, counts = np.unique(
        np.round(skin.inverse_bind.reshape(len(skin.joints), 16), 6), axis=0, return_inverse=True, return_counts=True
    )
    return counts[which.reshape(-1)] <= 2  # a joint and a helper may lie at one place


def _mesh_space(
    tree: NodeTree, skin: Skin, useful: np.ndarray, bound: np.ndarray, world: np.ndarray, mesh_node: int | None
) -> np.ndarray:
    """Returns the matrix [4, 4] from the space of the mesh to that of the scene.

    The file does not state it. It is usually the identity, else that of the mesh's node or of an ancestor of the
    joints, or what takes the joint nearest to the top from its bind pose to its pose in the file. The first that gives
    bones their lengths in the scene, and the most joints their places, is taken.
    """
    if not useful.any():
        return np.eye(4)
    joints = np.array(skin.joints)[useful]
    places, rest = bound[useful], world[joints]
    depth = [len(tree.above(int(joint))) for joint in joints]
    top = int(np.argmin(depth))
    candidates = [np.eye(4)] + ([] if mesh_node is None else [world[mesh_node]])
    candidates += [world[node] for node in tree.above(int(joints[top]))[1:]]
    candidates += [rest[top] @ np.linalg.inv(places[top])]
    candidates = [space for space in candidates if is_regular(space[:3, :3])]  # others put all joints at one place
    rows = {int(joint): row for row, joint in enumerate(joints)}
    above = np.array([rows[_nearest_above(tree, int(joint), rows)] for joint in joints])
    spaces = np.stack(candidates)
    moved = np.swapaxes(spaces[:, :3] @ places[:, :, 3].T, 1, 2)
    return spaces[int(np.argmax(_agreement(moved, rest[:, :3, 3], above)))]


def _nearest_above(tree: NodeTree, joint: int, joints: Collection[int]) -> int:
    """Returns the nearest ancestor of a joint that is one of some joints, or the joint itself."""
    return next((node for node in tree.above(joint)[1:] if node in joints), joint)


def _agreement(bind: np.ndarray, rest: np.ndarray, above: np.ndarray) -> np.ndarray:
    """Returns scores [C]: higher where bones have their lengths, then where more joints have their places, if enough.

    Args:
        bind: [C, N, 3] places in the bind pose, for each candidate.
        rest: [N, 3] places in the pose of the file.
        above: [N] rows of the joints above them; of a joint at the top, its own.
    """
    lengths = np.linalg.norm(bind - bind[:, above], axis=-1).sum(axis=-1)
    length = np.linalg.norm(rest - rest[above], axis=-1).sum()
    same = np.abs(lengths - length) <= SAME_SCALE * max(length, 1e-9)
    near = SAME_PLACE * max(float(np.ptp(rest, axis=0).max()), 1e-9)
    placed = (np.linalg.norm(bind - rest, axis=-1) < near).sum(axis=-1)
    return same * (len(rest) + 1) + np.where(placed > MIN_PLACED_SHARE * len(rest), placed, 0)
