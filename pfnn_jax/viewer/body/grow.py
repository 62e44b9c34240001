"""Grows a mannequin around the bones of any skeleton."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pfnn_jax.motion.retargeting.body import SIDES
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.skinned_mesh import SkinnedMesh, vertex_normals
from pfnn_jax.viewer.body.anatomy import Anatomy, anatomy_of
from pfnn_jax.viewer.body.feet import grow_foot
from pfnn_jax.viewer.body.hands import grow_hand
from pfnn_jax.viewer.body.head import grow_head
from pfnn_jax.viewer.body.limbs import ARM_FORM, LEG_FORM, grow_limb
from pfnn_jax.viewer.body.part import Part
from pfnn_jax.viewer.body.sticks import grow_sticks
from pfnn_jax.viewer.body.trunk import grow_trunk
from pfnn_jax.viewer.draw.palette import BODY, INK, rgb


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
    trunk, visor = (np.array(rgb(colour), float) for colour in (BODY["trunk"], INK))
    parts = [grow_trunk(anatomy, trunk), *grow_head(anatomy, trunk, visor)]
    for side in SIDES:
        colour, dark = (np.array(rgb(BODY[f"{side} {part}"]), float) for part in ("limb", "end"))
        thigh, shin, upper, lower = anatomy.limb(side, "thigh", "shin", "upper_arm", "lower_arm")
        leg, arm = anatomy.leg(side), anatomy.arm(side)
        parts += grow_limb(LEG_FORM, leg, (thigh, shin), anatomy.size, colour)
        parts += grow_foot(anatomy, side, dark)
        if arm is not None:
            parts += grow_limb(ARM_FORM, arm, (upper, lower), anatomy.size, colour)
            parts += grow_hand(anatomy, side, dark)
    return parts


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
