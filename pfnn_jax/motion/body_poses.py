"""Poses of the body relative to the root: what a character does, apart from where it is and where it faces."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.trajectory import relative_to_root, root_motion
from pfnn_jax.motion.world_motion import WorldMotion


def root_poses(world: WorldMotion) -> np.ndarray:
    """Returns positions [T, J, 3] of all joints in metres, relative to the root on the ground; heights are kept."""
    return relative_to_root(world.positions, root_motion(world.positions, world.roles, world.fps))


def body_joints(skeleton: Skeleton) -> np.ndarray:
    """Returns the joints of the humanoid map, so that fingers do not outweigh the body; all joints without a map."""
    if skeleton.humanoid is None:
        return np.arange(skeleton.num_joints)
    groups = skeleton.humanoid.joints().values()
    return np.unique([j for group in groups if group is not None for j in np.atleast_1d(group)]).astype(int)
