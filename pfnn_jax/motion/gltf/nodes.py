"""The tree of nodes of a glTF file: parents, transforms, and matrices in the world.

Source: glTF 2.0 specification, section 3.5 (nodes, transformations).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.container import Document, shown
from pfnn_jax.motion.kinematics import quat_from_matrix, quat_to_matrix

LARGEST = 1e6
"""Largest number in a transform, in the file's units."""

LARGEST_PLACE = 1e12
"""Largest number in a world matrix: scales multiply down the tree."""

MAX_LEVELS = 256
"""Most nodes above each other; spines, tails and hair have a few dozen."""


@dataclass(frozen=True, eq=False)
class NodeTree:
    """The nodes of a file in the pose that it was saved in.

    Attributes:
        names: N names; empty where a node has none.
        parents: [N] parent node, -1 at the top.
        order: [N] nodes with parents before their children.
        translations: [N, 3] in the file's units.
        rotations: [N, 4] unit quaternions wxyz.
        scales: [N, 3].
        matrices: [N, 4, 4] local transforms; those of nodes with a `matrix` may shear.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    order: np.ndarray
    translations: np.ndarray
    rotations: np.ndarray
    scales: np.ndarray
    matrices: np.ndarray

    def above(self, node: int) -> list[int]:
        """Returns the node and all its ancestors, up to the top."""
        found = [node]
        while self.parents[found[-1]] >= 0:
            found.append(int(self.parents[found[-1]]))
        return found

    def world(self) -> np.ndarray:
        """Returns the world matrices [N, 4, 4] in the pose of the file."""
        world = self.matrices.copy()
        for node in self.order:
            if self.parents[node] >= 0:
                world[node] = world[self.parents[node]] @ world[node]
        return world


def read_nodes(document: Document) -> NodeTree:
    """Reads the nodes of a file.

    Raises:
        InputError: if a node has two parents, is its own ancestor or is nested too deeply, or if a transform is
            malformed, not finite or too large, or a `matrix` singular. Scales may be zero: exporters hide nodes so.
    """
    nodes = document.items("nodes")
    parents, order = _parents(document, nodes)
    poses = [_transform(document, node, f"nodes[{number}]") for number, node in enumerate(nodes)]
    translations, rotations, scales, matrices = (
        np.array([pose[part] for pose in poses], float).reshape(len(nodes), *shape)
        for part, shape in enumerate(((3,), (4,), (3,), (4, 4)))
    )
    names = tuple(name if isinstance(name := node.get("name"), str) else "" for node in nodes)
    tree = NodeTree(names, parents, order, translations, rotations, scales, matrices)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite then is refused
        far = ~(np.abs(tree.world()) <= LARGEST_PLACE).all(axis=(1, 2))
    if far.any():
        rule = f"scales and translations must leave nodes within {LARGEST_PLACE:g}"
        raise InputError(document.path, f"nodes[{int(np.argmax(far))}]", "too large", rule)
    return tree


def decompose(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns translation [3], rotation [4] wxyz and scale [3] of an affine matrix [4, 4] without shear.

    Of a matrix that shears, this is the nearest rotation, with the lengths of its columns. A reflection is a negative
    scale of x, y and z.
    """
    part = matrix[:3, :3]
    sign = -1.0 if np.linalg.det(part) < 0 else 1.0
    scale = sign * np.linalg.norm(part, axis=0)
    return matrix[:3, 3].copy(), nearest_rotation(part), scale


def nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """Returns the rotation [4] wxyz nearest to the directions of a matrix's columns [3, 3]; reflections are undone."""
    columns = matrix / np.linalg.norm(matrix, axis=0)
    left, _, right = np.linalg.svd(-columns if np.linalg.det(columns) < 0 else columns)
    return quat_from_matrix(left @ right)


def _parents(document: Document, nodes: list[dict[str, Any]]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the parents [N] and an order [N] with parents before children."""
    parents = np.full(len(nodes), -1)
    children: list[list[int]] = []
    for number, node in enumerate(nodes):
        below = node.get("children", [])
        if not isinstance(below, list):
            raise InputError(document.path, f"nodes[{number}].children", shown(below), "must be a list of nodes")
        for child in below:
            document.item("nodes", child, f"nodes[{number}].children")
            if parents[child] >= 0:
                found = f"node {child} is under {parents[child]} and {number}"
                raise InputError(document.path, f"nodes[{number}].children", found, "a node has one parent")
            parents[child] = number
        children.append(below)
    order: list[int] = np.flatnonzero(parents < 0).tolist()
    levels = np.ones(len(nodes), int)
    for node in order:  # grows while it is walked
        order.extend(children[node])
        levels[children[node]] = levels[node] + 1
    if len(order) < len(nodes):
        looped = int(np.setdiff1d(np.arange(len(nodes)), order)[0])
        raise InputError(document.path, f"nodes[{looped}]", "is its own ancestor", "nodes must form a tree")
    if len(nodes) and levels.max() > MAX_LEVELS:
        found = f"{levels.max()} nodes above each other"
        raise InputError(document.path, f"nodes[{int(np.argmax(levels))}]", found, f"must be at most {MAX_LEVELS}")
    return parents, np.array(order, int)


def _transform(
    document: Document, node: dict[str, Any], place: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns translation [3], rotation [4] wxyz, scale [3] and matrix [4, 4] of a node."""
    if node.get("matrix") is not None:
        matrix = _numbers(document, node, "matrix", 16, place).reshape(4, 4).T
        if not np.allclose(matrix[3], [0.0, 0.0, 0.0, 1.0], atol=1e-6):
            raise InputError(document.path, f"{place}.matrix", shown(matrix[3].tolist()), "must be affine")
        _require_regular(document, matrix[:3, :3], f"{place}.matrix")
        return *decompose(matrix), matrix
    translation = _numbers(document, node, "translation", 3, place, np.zeros(3))
    rotation = _numbers(document, node, "rotation", 4, place, np.array([0.0, 0.0, 0.0, 1.0]))[[3, 0, 1, 2]]
    scale = _numbers(document, node, "scale", 3, place, np.ones(3))
    length = float(np.linalg.norm(rotation))
    if length < 1e-6:
        raise InputError(document.path, f"{place}.rotation", "zero", "must be a unit quaternion")
    rotation = rotation / length
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = quat_to_matrix(rotation) * scale, translation
    return translation, rotation, scale, matrix


def _numbers(
    document: Document, node: dict[str, Any], name: str, size: int, place: str, default: np.ndarray | None = None
) -> np.ndarray:
    found = node.get(name)
    if found is None and default is not None:
        return default
    values = found if isinstance(found, list) else []
    if len(values) != size or not all(type(value) in (int, float) and abs(value) <= LARGEST for value in values):
        rule = f"must be {size} finite numbers up to {LARGEST:g}"
        raise InputError(document.path, f"{place}.{name}", shown(found), rule)
    return np.array(values, float)


def _require_regular(document: Document, part: np.ndarray, place: str) -> None:
    if not is_regular(part):
        raise InputError(document.path, place, "singular", "must not flatten space")


def is_regular(part: np.ndarray) -> bool:
    """Returns whether a matrix [3, 3] is finite and does not flatten space, whatever its scale."""
    if not np.isfinite(part).all():
        return False
    lengths = np.linalg.norm(part, axis=0)
    return bool(lengths.min() > 1e-9 and abs(np.linalg.det(part / lengths)) > 1e-6)
