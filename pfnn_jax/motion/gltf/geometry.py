"""Reads the triangles of a glTF character in its bind pose, with the joints that move each vertex.

Meshes with a skin follow its joints; a mesh without one follows the joint that its node hangs on, as the parts of a
robot or of some VRM files do. A mesh that hangs on no joint belongs to the scene and is left out.

Source: glTF 2.0 specification, section 3.7 (meshes, skins).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.accessors import read_accessor
from pfnn_jax.motion.gltf.bind_pose import Skin
from pfnn_jax.motion.gltf.container import Document, is_index, shown
from pfnn_jax.motion.gltf.nodes import NodeTree
from pfnn_jax.motion.skinned_mesh import strongest_weights, unit_normals, vertex_normals

TRIANGLES, STRIP, FAN = 4, 5, 6
"""Modes of primitives that have faces; points and lines are left out."""

MAX_VERTICES = 2_000_000
"""Most vertices of a character, counted once for every four joints that move them, and most faces; detailed
characters have a hundred thousand."""

MAX_PARTS = 2_000
"""Most primitives of a character, counted again for each node that shows them; detailed ones have a hundred."""

MAX_SETS = 8
"""Most sets of four joints that move a vertex; exporters write one or two."""


@dataclass(frozen=True, eq=False)
class Part:
    """Triangles of one material.

    Attributes:
        vertices: [V, 3] in the scene, in the bind pose.
        normals: [V, 3] unit vectors.
        faces: [F, 3].
        joints: [V, 4] rows of the joints that move each vertex.
        weights: [V, 4], summing to one.
        primitive: the part's JSON, for its material and texture coordinates.
        place: where that stands, for messages.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    primitive: dict[str, Any]
    place: str


def read_parts(
    document: Document, tree: NodeTree, skins: Sequence[Skin], bind: np.ndarray, nodes: Sequence[int]
) -> list[Part]:
    """Returns the parts of a character's meshes.

    Args:
        document: the file.
        tree: its nodes.
        skins: of the file.
        bind: [N, 4, 4] matrices of all nodes in the bind pose.
        nodes: J nodes of the character's joints.

    Raises:
        InputError: for accessors out of range, vertices or joints that are not there, or too large meshes.
    """
    rows = {int(node): row for row, node in enumerate(nodes)}
    carriers = [-1] * len(tree.parents)
    for node in map(int, tree.order):
        parent = int(tree.parents[node])
        carriers[node] = rows.get(node, carriers[parent] if parent >= 0 else -1)
    parts = [
        _part(document, primitive, place, skin, bind, node, carriers)
        for node, skin, primitive, place in _shown_parts(document, skins, carriers)
    ]
    return [part for part in parts if part is not None]


def _shown_parts(
    document: Document, skins: Sequence[Skin], carriers: Sequence[int]
) -> list[tuple[int, Skin | None, dict[str, Any], str]]:
    """Returns node, skin, JSON and place of the primitives that hang on joints, none of which is read yet.

    Raises:
        InputError: if they are too many or too large together.
    """
    found: list[tuple[int, Skin | None, dict[str, Any], str]] = []
    total = 0
    for number, node in enumerate(document.items("nodes")):
        if node.get("mesh") is None:
            continue
        mesh = document.item("meshes", node["mesh"], f"nodes[{number}].mesh")
        skin = skins[node["skin"]] if node.get("skin") is not None else None
        if skin is None and carriers[number] < 0:
            continue
        for at, primitive in enumerate(_primitives(document, mesh, node["mesh"])):
            place = f"meshes[{node['mesh']}].primitives[{at}]"
            found.append((number, skin, primitive, place))
            total += _size(document, primitive)
            if len(found) > MAX_PARTS:
                rule = f"must be at most {MAX_PARTS} in all"
                raise InputError(document.path, place, f"{len(found)} primitives", rule)
            if total > MAX_VERTICES:
                raise InputError(document.path, place, f"{total} vertices", f"must be at most {MAX_VERTICES} in all")
    return found


def _size(document: Document, primitive: dict[str, Any]) -> int:
    """Returns the vertices or faces of a primitive, whichever are more, as its accessors state them."""
    attributes, mode = primitive.get("attributes"), primitive.get("mode", TRIANGLES)
    if not isinstance(attributes, dict) or mode not in (TRIANGLES, STRIP, FAN):
        return 0
    vertices, corners = (
        0 if index is None else document.item("accessors", index, name).get("count")
        for name, index in (("POSITION", attributes.get("POSITION")), ("indices", primitive.get("indices")))
    )
    sets = sum(f"JOINTS_{number}" in attributes for number in range(MAX_SETS))
    vertices, corners = (each if is_index(each, 2**62) else 0 for each in (vertices, corners))  # others are refused
    return max(max(sets, 1) * vertices, corners // 3 if mode == TRIANGLES else corners)


def _primitives(document: Document, mesh: dict[str, Any], number: int) -> list[dict[str, Any]]:
    found = mesh.get("primitives")
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InputError(document.path, f"meshes[{number}].primitives", shown(found), "must be a list of objects")
    return found


def _part(
    document: Document,
    primitive: dict[str, Any],
    place: str,
    skin: Skin | None,
    bind: np.ndarray,
    node: int,
    carriers: list[int],
) -> Part | None:
    """Returns a primitive in the bind pose; None without faces, or if it belongs to another body."""
    attributes = primitive.get("attributes")
    if primitive.get("mode", TRIANGLES) not in (TRIANGLES, STRIP, FAN) or not isinstance(attributes, dict):
        return None
    if "POSITION" not in attributes:
        return None
    points = read_accessor(document, attributes["POSITION"], "VEC3", f"{place}.POSITION").astype(float)
    if not len(points):
        return None
    faces = _faces(document, primitive, len(points), place)
    if skin is None:
        joints, weights = np.full((len(points), 1), carriers[node]), np.ones((len(points), 1))
        matrices, used = bind[node][None], np.zeros((len(points), 1), int)
    else:
        used, weights = _weights(document, attributes, len(points), len(skin.joints), place)
        joints = np.array([carriers[each] for each in skin.joints])[used]
        if (weights * (joints < 0)).sum() > 0.5 * weights.sum():
            return None
        matrices = bind[list(skin.joints)] @ skin.inverse_bind
    normals = _normals(document, attributes, points, faces, place)
    vertices, normals = _posed(points, normals, matrices, used, weights)
    joints, weights = strongest_weights(np.maximum(joints, 0), weights)
    return Part(vertices, normals, faces, joints, weights, primitive, place)


def _posed(
    points: np.ndarray, normals: np.ndarray, matrices: np.ndarray, joints: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns vertices and normals [V, 3] moved by matrices [N, 4, 4] blended by weights [V, M]."""
    share = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-12)
    moved, turned = np.zeros_like(points), np.zeros_like(normals)
    for column in range(joints.shape[1]):
        used = np.flatnonzero(share[:, column])
        matrix, weight = matrices[joints[used, column]], share[used, column, None]
        moved[used] += weight * (np.einsum("vab,vb->va", matrix[:, :3, :3], points[used]) + matrix[:, :3, 3])
        turned[used] += weight * np.einsum("vab,vb->va", matrix[:, :3, :3], normals[used])
    return moved, unit_normals(turned)


def _weights(
    document: Document, attributes: dict[str, Any], count: int, num_joints: int, place: str
) -> tuple[np.ndarray, np.ndarray]:
    """Returns joints of the skin [V, 4n] and weights [V, 4n]; a vertex without weights follows its first joint."""
    joints, weights = [], []
    for number in range(MAX_SETS):
        names = [f"{name}_{number}" for name in ("JOINTS", "WEIGHTS")]
        if any(name not in attributes for name in names):
            break
        for name, found in zip(names, (joints, weights), strict=True):
            values = read_accessor(document, attributes[name], "VEC4", f"{place}.{name}")
            if len(values) != count:
                raise InputError(document.path, f"{place}.{name}", f"{len(values)} values", f"must be {count}")
            found.append(values)
    if not joints:
        return np.zeros((count, 1), int), np.ones((count, 1))
    found = np.concatenate(joints, axis=1).astype(np.int64)
    shares = np.maximum(np.concatenate(weights, axis=1).astype(float), 0.0)
    shares[shares.sum(axis=1) <= 0, 0] = 1.0
    bad = (shares > 0) & ((found < 0) | (found >= num_joints))
    if bad.any():
        worst = int(found[bad][0])
        raise InputError(document.path, f"{place}.JOINTS_0", worst, f"must be one of the skin's {num_joints} joints")
    return np.where(shares > 0, found, 0), shares


def _faces(document: Document, primitive: dict[str, Any], count: int, place: str) -> np.ndarray:
    """Returns the triangles [F, 3] of a primitive."""
    if primitive.get("indices") is None:
        corners = np.arange(count)
    else:
        corners = read_accessor(document, primitive["indices"], "SCALAR", f"{place}.indices").astype(np.int64)
    if len(corners) and (corners.max() >= count or corners.min() < 0):
        raise InputError(document.path, f"{place}.indices", int(corners.max()), f"must be below {count} vertices")
    mode = primitive.get("mode", TRIANGLES)
    if mode == TRIANGLES:
        return corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(corners) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == FAN:
        return np.stack((np.broadcast_to(corners[0], len(corners) - 2), corners[1:-1], corners[2:]), axis=1)
    strip = np.stack((corners[:-2], corners[1:-1], corners[2:]), axis=1)
    strip[1::2] = strip[1::2, [1, 0, 2]]
    return strip


def _normals(
    document: Document, attributes: dict[str, Any], points: np.ndarray, faces: np.ndarray, place: str
) -> np.ndarray:
    """Returns the normals [V, 3] of the file, or those of the faces where it has none."""
    if "NORMAL" in attributes:
        normals = read_accessor(document, attributes["NORMAL"], "VEC3", f"{place}.NORMAL").astype(float)
        if len(normals) == len(points):
            return normals
    return vertex_normals(points, faces)
