"""A clip seen from its root: the quantities of every frame from which rows are made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import to_local
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.trajectory import Root, layout_root, trajectory_windows
from pfnn_jax.motion.world_motion import WorldMotion

AXES = {"joint_forward": np.array([0.0, 0.0, 1.0]), "joint_up": np.array([0.0, 1.0, 0.0])}
"""The joint's own axis that a block of directions holds."""


@dataclass(frozen=True, eq=False)
class LocalMotion:
    """T frames of a clip, each seen from its own root.

    Attributes:
        world: the same frames in the world.
        root: of every frame.
        windows: trajectory around every frame, positions [T, 12, 2] metres and directions [T, 12, 2].
        positions: [T, J, 3] metres.
        velocities: metres per second: [T - 1, J, 3] from each frame to the next or, for `next_frame` layouts,
            [T, J, 3] from each frame's predecessor to it (the first repeats the second).
        rotations: [T, J, 4] wxyz.
    """

    world: WorldMotion
    root: Root
    windows: tuple[np.ndarray, np.ndarray]
    positions: np.ndarray
    velocities: np.ndarray
    rotations: np.ndarray


def localise(motion: WorldMotion, layout: FrameLayout) -> LocalMotion:
    """A clip seen from the roots that a layout takes.

    Args:
        motion: T frames at the layout's frame rate, of a skeleton with roles.
        layout: decides the heading of the root and which way velocities look.

    Raises:
        InputError: if the skeleton has no roles.
    """
    positions = motion.positions
    root = layout_root(positions, motion.roles, layout)
    offset = positions.copy()
    offset[..., [0, 2]] -= root.positions[:, None]
    steps = np.diff(positions, axis=0) * motion.fps
    if layout.next_frame:
        steps = np.concatenate([steps[:1], steps])
    return LocalMotion(
        world=motion,
        root=root,
        windows=trajectory_windows(root, motion.fps),
        positions=to_local(offset, root.facing),
        velocities=to_local(steps, root.facing[: len(steps)]),
        rotations=quat_multiply(quat_from_yaw(-root.yaw)[:, None], motion.rotations),
    )


def joint_axis(local: LocalMotion, block: str, frames: np.ndarray) -> np.ndarray:
    """[N, J, 3] direction of the joints' own +Z (`joint_forward`) or +Y (`joint_up`), seen from the root.

    Args:
        local: T frames.
        block: key of `AXES`.
        frames: [N] indices.
    """
    return quat_rotate(local.rotations[frames], AXES[block])


def trajectory_block(windows: tuple[np.ndarray, np.ndarray], block: str) -> np.ndarray:
    """[N, samples] of one trajectory block, as `trajectory_position_x`, in metres.

    Args:
        windows: positions and directions, each [N, samples, 2] as (x, z).
        block: name.
    """
    _, kind, axis = block.split("_")
    return windows[0 if kind == "position" else 1][..., "xz".index(axis)]
