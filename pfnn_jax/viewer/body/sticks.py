"""A simple body for skeletons without a humanoid map: tapered sticks along the bones, or a dot for a single joint."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.motion.kinematics import quat_rotate
from pfnn_jax.motion.skeleton import Skeleton, rest_pose
from pfnn_jax.viewer.body.part import Part, ball, tube
from pfnn_jax.viewer.draw.palette import SIDES, rgb

THICK, THIN, LONGEST, DOT = 0.03, 0.35, 0.12, 0.06
"""Radius at the thick end, as a share of the reach; the thin end's share of it; its limit as a share of the bone's
length; radius of a dot in metres."""
SHORTEST = 0.012
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def grow_sticks(skeleton: Skeleton) -> tuple[list[Part], np.ndarray, np.ndarray]:
    """Returns the sticks of a skeleton at rest, with the positions [J, 3] and rotations [J, 4] of that pose."""
    rest, turns = rest_pose(skeleton), np.tile(_IDENTITY, (skeleton.num_joints, 1))
    colour = np.array(rgb(SIDES["middle"]), float)
    bones = [(int(skeleton.parents[j]), rest[j]) for j in range(skeleton.num_joints) if skeleton.parents[j] >= 0]
    bones += [(joint, rest[joint] + quat_rotate(turns[joint], offset)) for joint, offset in skeleton.end_sites]
    ends = np.array([end for _, end in bones]).reshape(-1, 3)
    reach = float(np.linalg.norm(np.concatenate([ends, rest]) - rest[0], axis=-1).max())
    parts = []
    for joint, end in bones:
        length = float(np.linalg.norm(end - rest[joint]))
        if length > SHORTEST * reach:
            parts.append(_stick(rest[joint], end, min(THICK * reach, LONGEST * length), joint, colour))
    return parts or [ball(rest[0], DOT, 0, colour, 14, 9)], rest, turns


def _stick(start: np.ndarray, end: np.ndarray, radius: float, joint: int, colour: np.ndarray) -> Part:
    """Returns a stick with a round thick end at its start and a thin one at its end."""
    along = unit(end - start)
    across = unit(np.cross(along, np.eye(3)[np.argmin(np.abs(along))]))
    axes = np.stack([across, np.cross(along, across)])
    thin, length = THIN * radius, float(np.linalg.norm(end - start))
    rows = [(-0.7 * radius, 0.7 * radius), (0.0, radius), (0.5 * length, (radius + thin) / 2)]
    rows += [(length, thin), (length + 0.7 * thin, 0.7 * thin)]
    places = [(-radius, 0.0), *rows, (length + thin, 0.0)]
    angles = 2 * np.pi * np.arange(8) / 8
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=-1) @ axes
    rings = np.array([start + d * along + r * circle for d, r in places])
    return tube(rings, [{joint: 1.0}] * len(rings), colour)
