"""A mesh that bends with the joints of a skeleton."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.kinematics import quat_conjugate, quat_multiply, quat_to_matrix

MOST_WEIGHTS = 4
"""Joints that move one vertex, as renderers have it."""


@dataclass(frozen=True, eq=False)
class SkinnedMesh:
    """Triangles whose vertices follow the joints by linear blending.

    Attributes:
        vertices: [V, 3] metres in the bind pose.
        normals: [V, 3] unit vectors in the bind pose.
        faces: [F, 3] vertices, anticlockwise as seen from outside.
        joints: [V, 4] the joints that move each vertex.
        weights: [V, 4] at least 0, summing to one for each vertex.
        colours: [V, 3] uint8, sRGB.
        bind_positions: [J, 3] metres, of the joints in the bind pose.
        bind_rotations: [J, 4] world rotations wxyz of the joints in the bind pose.
    """

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    colours: np.ndarray
    bind_positions: np.ndarray
    bind_rotations: np.ndarray

    def pose(self, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Returns the vertices [..., V, 3] of poses.

        Args:
            positions: [..., J, 3] metres, world positions of the joints.
            rotations: [..., J, 4] their world rotations.
        """
        turns = quat_to_matrix(quat_multiply(rotations, quat_conjugate(self.bind_rotations)))
        shifts = positions - np.einsum("...jab,jb->...ja", turns, self.bind_positions)
        moved = np.zeros((*positions.shape[:-2], len(self.vertices), 3))
        for joints, weights in zip(self.joints.T, self.weights.T, strict=True):
            used = np.flatnonzero(weights)
            of = joints[used]
            placed = np.einsum("...vab,vb->...va", turns[..., of, :, :], self.vertices[used]) + shifts[..., of, :]
            moved[..., used, :] += weights[used, None] * placed
        return moved


def strongest_weights(joints: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the four strongest joints [V, 4] of each vertex and their weights [V, 4], made to sum to one.

    A vertex without weight follows the first joint named for it.

    Args:
        joints, weights: [V, N], N at least 1. A joint named twice counts with the sum of its weights.
    """
    joints, weights = np.asarray(joints), np.maximum(np.nan_to_num(np.asarray(weights, float)), 0.0)
    order = np.argsort(joints, axis=1, kind="stable")
    joints, weights = (np.take_along_axis(each, order, axis=1) for each in (joints, weights))
    for column in range(joints.shape[1] - 1):  # moves the weights of equal neighbours to the last of them
        same = joints[:, column] == joints[:, column + 1]
        weights[:, column + 1] += np.where(same, weights[:, column], 0.0)
        weights[:, column] = np.where(same, 0.0, weights[:, column])
    strongest = np.argsort(-weights, axis=1, kind="stable")[:, :MOST_WEIGHTS]
    joints, weights = (np.take_along_axis(each, strongest, axis=1) for each in (joints, weights))
    missing = MOST_WEIGHTS - joints.shape[1]
    joints, weights = np.pad(joints, ((0, 0), (0, max(missing, 0)))), np.pad(weights, ((0, 0), (0, max(missing, 0))))
    total = weights.sum(axis=1, keepdims=True)
    weights = np.where(total > 0, weights / np.where(total > 0, total, 1.0), np.eye(1, MOST_WEIGHTS))
    return joints, weights


def merge_meshes(meshes: Sequence[SkinnedMesh]) -> SkinnedMesh:
    """Returns one mesh of several on the same skeleton.

    Args:
        meshes: at least one, with equal bind poses.
    """
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    joined = {
        name: np.concatenate([getattr(mesh, name) for mesh in meshes])
        for name in ("vertices", "normals", "joints", "weights", "colours")
    }
    faces = np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)])
    return SkinnedMesh(
        faces=faces, bind_positions=meshes[0].bind_positions, bind_rotations=meshes[0].bind_rotations, **joined
    )


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns unit normals [V, 3]: means of those of the faces around each vertex, weighted by area.

    Args:
        vertices: [V, 3].
        faces: [F, 3].
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices, dtype=float)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], across)
    return unit_normals(normals)


def unit_normals(normals: np.ndarray) -> np.ndarray:
    """Returns normals [V, 3] of unit length; those of length zero, as of faces without area, point upwards."""
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 0, normals / np.where(lengths > 0, lengths, 1.0), [0.0, 1.0, 0.0])
