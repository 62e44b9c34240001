"""Grows a mannequin around the bones of any skeleton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pfnn_jax.motion.retargeting.body import SIDES
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.viewer.body.anatomy import ARM, LEG, Anatomy, anatomy_of
from pfnn_jax.viewer.body.feet import grow_foot
from pfnn_jax.viewer.body.hands import grow_hand
from pfnn_jax.viewer.body.head import grow_head
from pfnn_jax.viewer.body.limbs import ARM_PROFILE, ARM_STATIONS, LEG_PROFILE, LEG_STATIONS, grow_limb
from pfnn_jax.viewer.body.part import Part
from pfnn_jax.viewer.body.sticks import grow_sticks
from pfnn_jax.viewer.body.trunk import grow_trunk
from pfnn_jax.viewer.draw.palette import INK, SIDES as COLOURS, rgb

DARKER = 0.28  # share of ink in the colour of hands and feet


def grow_body(skeleton: Skeleton) -> SkinnedMesh:
    """Returns a body for a skeleton: a mannequin, or sticks along its bones where it has no humanoid map.

    Left limbs are blue, right ones orange, trunk and head grey. The mesh is made in the skeleton's reference pose.

    Args:
        skeleton: J joints.
    """
    if skeleton.humanoid is None:
        parts, positions, rotations = grow_sticks(skeleton)
        return _mesh(parts, positions, rotations)
    anatomy = anatomy_of(skeleton, skeleton.humanoid)
    return _mesh(_mannequin(anatomy), anatomy.positions, anatomy.rotations)


def _mannequin(anatomy: Anatomy) -> list[Part]:
    middle, ink = (np.array(rgb(colour), float) for colour in (COLOURS["middle"], INK))
    parts = [grow_trunk(anatomy, middle), *grow_head(anatomy, middle, ink)]
    for side in SIDES:
        colour = np.array(rgb(COLOURS[side]), float)
        dark = colour + DARKER * (ink - colour)
        thigh, shin, upper, lower = anatomy.limb(side, "thigh", "shin", "upper_arm", "lower_arm")
        leg, arm = anatomy.leg(side), anatomy.arm(side)
        parts += grow_limb(leg, (thigh, shin), LEG_PROFILE, _thick(anatomy, leg, LEG), colour, LEG_STATIONS, 14)
        parts += grow_foot(anatomy, side, dark)
        if arm is not None:
            parts += grow_limb(arm, (upper, lower), ARM_PROFILE, _thick(anatomy, arm, ARM), colour, ARM_STATIONS, 12)
            parts += grow_hand(anatomy, side, dark)
    return parts


def _thick(anatomy: Anatomy, points: np.ndarray, usual: float) -> float:
    """Returns the thickness of a limb relative to a person's: short limbs are thinner, but less than in proportion."""
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=-1).sum())
    return float(np.sqrt(anatomy.size * max(length / usual, 0.25 * anatomy.size)))


def _mesh(parts: Sequence[Part], positions: np.ndarray, rotations: np.ndarray) -> SkinnedMesh:
    counts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([part.faces + first for part, first in zip(parts, counts[:-1], strict=True)])
    vertices = np.concatenate([part.vertices for part in parts])
    return SkinnedMesh(
        vertices=vertices,
        normals=vertex_normals(vertices, faces),
        faces=faces,
        joints=np.concatenate([part.joints for part in parts]),
        weights=np.concatenate([part.weights for part in parts]),
        colours=np.concatenate([part.colours for part in parts]),
        bind_positions=positions,
        bind_rotations=rotations,
    )


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns the normals [V, 3] of vertices: the mean of those of their faces, weighted by area."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    face = np.cross(b - a, c - a)
    total = np.zeros_like(vertices)
    for axis in range(3):
        total[:, axis] = np.bincount(faces.ravel(), np.repeat(face[:, axis], 3), len(vertices))
    return total / np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-12)
