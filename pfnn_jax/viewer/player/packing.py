"""Bodies and motion as short text for a page: whole numbers, as differences, compressed."""

from __future__ import annotations

import base64
import gzip
from typing import Any

import numpy as np

from pfnn_jax.motion.kinematics import quat_align, quat_conjugate, quat_multiply, quat_rotate
from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.viewer.draw.scene import Scene

POSITION = 1e-4  # metres: resolution of root, camera target and the vertices of a person
ROTATION = 1 / 8191  # resolution of a quaternion's parts: 0.1 mm at the end of a leg
NORMAL = 1 / 127
WEIGHTS = 255  # sum of a vertex's four weights


def pack(values: np.ndarray, unit: float = 1.0) -> str:
    """Packs a table of numbers into text, which `unpack` in `player_load.js` reads.

    Smooth columns become short: each is written as its differences from row to row, sign in the lowest bit, the four
    bytes of all numbers apart, then compressed by gzip.

    Args:
        values: [N, C] finite numbers.
        unit: resolution; values up to 2³⁰ units are kept.
    """
    whole = np.round(np.asarray(values, float) / unit).astype(np.int64)
    steps = np.diff(whole, axis=0, prepend=0).T
    coded = np.where(steps < 0, -2 * steps - 1, 2 * steps).astype("<u4")
    planes = np.ascontiguousarray(coded).view(np.uint8).reshape(-1, 4).T
    return base64.b64encode(gzip.compress(planes.tobytes(), 6, mtime=0)).decode("ascii")


def mesh_data(mesh: SkinnedMesh) -> dict[str, Any]:
    """Returns a mesh with at most four joints a vertex as JSON data; units scale with the mesh."""
    unit = POSITION * max(1.0, float(np.ptp(mesh.vertices, axis=0).max(initial=0.0)) / 3)
    return {
        "joints": len(mesh.bind_positions),
        "unit": unit,
        "vertices": pack(mesh.vertices, unit),
        "normals": pack(mesh.normals, NORMAL),
        "faces": pack(mesh.faces),
        "bones": pack(mesh.joints),
        "weights": pack(_whole_weights(mesh.weights)),
        "colours": pack(mesh.colours),
        "bind": pack(np.concatenate([mesh.bind_positions / unit, mesh.bind_rotations / ROTATION], axis=1)),
    }


def _whole_weights(weights: np.ndarray) -> np.ndarray:
    """Rounds weights [V, 4] to whole parts of `WEIGHTS`; the greatest takes what is lost, so that the sum is exact."""
    parts = np.round(weights * WEIGHTS)
    greatest = parts.argmax(axis=1)
    parts[np.arange(len(parts)), greatest] += WEIGHTS - parts.sum(axis=1)
    return parts


def motion_data(scene: Scene, parents: np.ndarray, frames: np.ndarray) -> dict[str, Any]:
    """Returns the motion of a scene's joints as JSON data: bones at rest and in frames, and the camera's target.

    Args:
        scene: the clip, above its ground.
        parents: [J] parent of each joint, parents before children, -1 for the root.
        frames: the frames to write.
    """
    positions, rotations = scene.positions[frames], scene.rotations[frames]
    local = rotations.copy()
    local[:, 1:] = quat_multiply(quat_conjugate(rotations[:, parents[1:]]), rotations[:, 1:])
    return {
        "parents": parents.tolist(),
        "unit": POSITION,
        "offsets": pack(_offsets(scene, parents), POSITION),
        "root": pack(positions[:, 0], POSITION),
        "rotations": pack(quat_align(local).reshape(len(frames), -1), ROTATION),
        "focus": pack(scene.focus[frames], POSITION),
    }


def _offsets(scene: Scene, parents: np.ndarray) -> np.ndarray:
    """Returns each joint's place [J, 3] in its parent, which is the same in all frames; zeros for the root."""
    first, turned = scene.positions[0], scene.rotations[0]
    offsets = np.zeros_like(first)
    offsets[1:] = quat_rotate(quat_conjugate(turned[parents[1:]]), first[1:] - first[parents[1:]])
    return offsets
