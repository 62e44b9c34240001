"""Joints, velocities and trajectory of every frame relative to the root: what rows are made of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import to_local
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.trajectory import Root, layout_root, relative_to_root, trajectory_windows
from pfnn_jax.motion.world_motion import WorldMotion

AXES = {"joint_forward": np.array([0.0, 0.0, 1.0]), "joint_up": np.array([0.0, 1.0, 0.0])}
"""The axis of a joint's own frame that each block of directions holds."""


@dataclass(frozen=True, eq=False)
class LocalMotion:
    """T frames of a clip, each relative to its own root.

    Attributes:
        world: the same frames in the world.
        root: position and facing of every frame.
        windows: trajectory around every frame, positions [T, 12, 2] metres and directions [T, 12, 2].
        positions: [T, J, 3] metres.
        velocities: metres per second: [T - 1, J, 3] from each frame to the next or, for `next_frame` layouts,
            [T, J, 3] from the previous frame (the first repeats the second).
        rotations: [T, J, 4] wxyz.
    """

    world: WorldMotion
    root: Root
    windows: tuple[np.ndarray, np.ndarray]
    positions: np.ndarray
    velocities: np.ndarray
    rotations: np.ndarray

    @cached_property
    def axes(self) -> dict[str, np.ndarray]:
        """[T, J, 3] directions of the joints' own +Z (`joint_forward`) and +Y (`joint_up`), relative to the root."""
        return {block: quat_rotate(self.rotations, axis) for block, axis in AXES.items()}


def localise(motion: WorldMotion, layout: FrameLayout) -> LocalMotion:
    """Returns a motion relative to the roots that a layout defines.

    Args:
        motion: T frames at the layout's frame rate, of a skeleton with roles.
        layout: defines the facing of the root, and whether velocities are forward or backward differences.

    Raises:
        InputError: if the skeleton has no roles.
    """
    positions = motion.positions
    root = layout_root(positions, motion.roles, layout)
    steps = np.diff(positions, axis=0) * motion.fps
    if layout.next_frame:
        steps = np.concatenate([steps[:1], steps])
    return LocalMotion(
        world=motion,
        root=root,
        windows=trajectory_windows(root, motion.fps),
        positions=relative_to_root(positions, root),
        velocities=to_local(steps, root.facing[: len(steps)]),
        rotations=quat_multiply(quat_from_yaw(-root.yaw)[:, None], motion.rotations),
    )


def trajectory_block(windows: tuple[np.ndarray, np.ndarray], block: str) -> np.ndarray:
    """Returns one trajectory block [N, samples], such as `trajectory_position_x`, in metres.

    Args:
        windows: positions and directions, each [N, samples, 2] as (x, z).
        block: name of the block.
    """
    _, kind, axis = block.split("_")
    return windows[0 if kind == "position" else 1][..., "xz".index(axis)]
