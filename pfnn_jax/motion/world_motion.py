"""World positions and rotations of all joints of a clip: computed once, then handed to labels and features."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.clip import MotionClip, mirror_clip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_conjugate, quat_rotate
from pfnn_jax.motion.reflection import WORLD_REFLECTION, WORLD_TURN, frame_reflections, reflect_rotations
from pfnn_jax.motion.skeleton import Roles, Skeleton, need_roles

ROUNDING = 1e-13  # relative: bones that differ by less are equal


@dataclass(frozen=True, eq=False)
class WorldMotion:
    """A clip with its joints in the world; `world_motion` makes it.

    Attributes:
        clip: T frames on a skeleton of J joints.
        positions: [T, J, 3] metres.
        rotations: [T, J, 4] wxyz.
    """

    clip: MotionClip
    positions: np.ndarray
    rotations: np.ndarray

    @property
    def skeleton(self) -> Skeleton:
        """The clip's skeleton."""
        return self.clip.skeleton

    @property
    def fps(self) -> float:
        """Frames per second."""
        return self.clip.fps

    @property
    def num_frames(self) -> int:
        """T."""
        return self.clip.num_frames

    @property
    def roles(self) -> Roles:
        """The skeleton's roles.

        Raises:
            InputError: if the skeleton has none.
        """
        return need_roles(self.skeleton, self.clip.source or "clip")

    def mirror(self) -> WorldMotion:
        """Returns the motion of the mirrored clip without forward kinematics.

        The world rotation of a joint is its partner's, reflected. So is its position, apart from what left and right
        bones of a real skeleton differ by: the mirrored clip keeps the skeleton's bones.
        """
        clip, skeleton = self.clip, self.skeleton
        turns = frame_reflections(skeleton, clip.rotations)
        mirrored = mirror_clip(clip, turns)
        if not _partners_share_parents(skeleton):
            return world_motion(mirrored)
        rotations = reflect_rotations(self.rotations[:, skeleton.mirror], WORLD_TURN, turns)
        positions = self.positions[:, skeleton.mirror] * WORLD_REFLECTION
        _correct_bones(positions, rotations, skeleton, turns)
        return WorldMotion(mirrored, positions, rotations)


def world_motion(motion: MotionClip | WorldMotion) -> WorldMotion:
    """Returns the world positions and rotations of a clip; what has them already is returned unchanged."""
    if isinstance(motion, WorldMotion):
        return motion
    return WorldMotion(motion, *forward_kinematics(motion.skeleton, motion.root_positions, motion.rotations))


def _partners_share_parents(skeleton: Skeleton) -> bool:
    """Whether the parent of each joint's partner is the partner of its parent, so that world rotations mirror too."""
    mirror, parents = skeleton.mirror, skeleton.parents
    return mirror[0] == 0 and bool((parents[mirror[1:]] == mirror[parents[1:]]).all())


def _correct_bones(positions: np.ndarray, rotations: np.ndarray, skeleton: Skeleton, turns: np.ndarray) -> None:
    """Moves reflected positions [T, J, 3] in place to where the skeleton's own bones put them."""
    parents = skeleton.parents
    # a parent's reflection is -turn, and its inverse maps the partner's bone to this one
    partners = -quat_rotate(quat_conjugate(turns[parents]), skeleton.offsets[skeleton.mirror])
    excess = skeleton.offsets - partners
    excess[np.abs(excess).max(axis=1) <= ROUNDING * np.abs(skeleton.offsets).max()] = 0.0
    excess[0] = 0.0
    shifts: dict[int, np.ndarray] = {}  # only of joints that move
    for joint in range(1, skeleton.num_joints):
        parent = int(parents[joint])
        shift = shifts.get(parent)
        if excess[joint].any():
            own = quat_rotate(rotations[:, parent], excess[joint])
            shift = own if shift is None else shift + own
        if shift is not None:
            shifts[joint] = shift
            positions[:, joint] += shift
