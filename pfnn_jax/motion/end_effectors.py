"""Where hands and toes are: in the world, for contacts, and seen from the hips, for cycles of movement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_rotate
from pfnn_jax.motion.skeleton import Skeleton, need_roles
from pfnn_jax.motion.trajectory import to_local

END_EFFECTORS = ("left hand", "right hand", "left toe", "right toe")
"""Order of the four bones in every array of local phases."""


@dataclass(frozen=True, eq=False)
class EndEffectors:
    """Tips of hands and feet, in the order of `END_EFFECTORS`.

    Attributes:
        world: [T, 4, 3] metres.
        local: [T, 4, 3] metres from the hips, in axes that turn with the heading of the hips: x to the left, y up, z
            forward.
        fps: frames per second.
    """

    world: np.ndarray
    local: np.ndarray
    fps: float


def end_effectors(clip: MotionClip) -> EndEffectors:
    """Tips of a clip's hands and feet: the End Site beyond the joint where it has one, else the joint.

    The local frame stands at the hips and turns about the vertical with the line between the hip joints. The rig's own
    hip frame would do for one skeleton, but its axes mean something else in every rig (in the Bandai-Namco files z is
    not forward), and the axes of movement are directed by what is forward.

    Raises:
        InputError: if the skeleton's roles are not known.
    """
    roles = need_roles(clip.skeleton, clip.source or "clip")
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    joints = (roles.left_hand, roles.right_hand, roles.left_foot[1], roles.right_foot[1])
    world = np.stack([_tip(clip.skeleton, joint, positions, rotations) for joint in joints], axis=1)
    across = positions[:, roles.left_hip] - positions[:, roles.right_hip]
    yaw = np.arctan2(-across[:, 2], across[:, 0])  # across × up
    return EndEffectors(world, to_local(yaw, world - positions[:, None, roles.hips]), clip.fps)


def _tip(skeleton: Skeleton, joint: int, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    offsets = [offset for parent, offset in skeleton.end_sites if parent == joint]
    if not offsets:
        return positions[:, joint]
    return positions[:, joint] + quat_rotate(rotations[:, joint], max(offsets, key=lambda o: float(np.linalg.norm(o))))
