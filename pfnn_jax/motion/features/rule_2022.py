"""Rows by the frame rule of Mason et al. 2022, for layouts `mason2022`, `mason2022_mann` and `mason2022_pfnn`.

`layout` states the rule. y_i describes frame i+1 by the same quantities as x_{i+1}, transformed from root i+1 to
root i.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.features.layout import NOW, FrameLayout, end_joints
from pfnn_jax.motion.features.local_motion import LocalMotion, trajectory_block
from pfnn_jax.motion.ground import facing_of, to_local, to_world, wrap_angle
from pfnn_jax.motion.labels.local_phase import toe_contacts


@dataclass(frozen=True, eq=False)
class NextFrameRows:
    """Blocks of the rows of some frames: x_i describes frame i, y_i the next frame, both relative to root i.

    Attributes:
        layout: with `next_frame` true, in metres and seconds.
        local: T frames relative to their roots.
        phases: gating input [T, G]; [T] for a scalar phase.
        frames: [N] indices, none of them the first or last frame.
        turn: [N] radians, yaw of root i+1 relative to root i.
        step: [N, 2] metres, position of root i+1 relative to root i.
    """

    layout: FrameLayout
    local: LocalMotion
    phases: np.ndarray
    frames: np.ndarray
    turn: np.ndarray
    step: np.ndarray

    def input(self, block: str) -> np.ndarray:
        """Returns one block [N, ...] of x."""
        if block.startswith("trajectory"):
            return trajectory_block((self.local.windows[0][self.frames], self.local.windows[1][self.frames]), block)
        return self._joints(block, self.frames)

    def output(self, block: str) -> np.ndarray:
        """Returns one block [N, ...] of y."""
        after = self.frames + 1
        if block.startswith("trajectory"):
            return self._trajectory_after(block)
        if block.startswith("joint"):
            return self._joints_after(block)
        if block == "local_phase":
            return self.phases[after]
        if block == "local_phase_change":
            return self.phases[after] - self.phases[self.frames]
        if block == "foot_contacts":
            return toe_contacts(self.local.world)[after]
        rate = self.layout.time_unit * self.local.world.fps / self.layout.phase_unit
        return wrap_angle(self.phases[after] - self.phases[self.frames]) * rate

    def _joints(self, block: str, frames: np.ndarray) -> np.ndarray:
        if block == "joint_position":
            return self.local.positions[frames]
        if block == "joint_velocity":
            return self.local.velocities[frames]
        return self.local.axes[block][frames]

    def _joints_after(self, block: str) -> np.ndarray:
        joints = to_world(self._joints(block, self.frames + 1), facing_of(self.turn))
        if block == "joint_position":
            joints[..., [0, 2]] += self.step[:, None]
        return joints

    def _trajectory_after(self, block: str) -> np.ndarray:
        positions, directions = (to_world(w[self.frames + 1, NOW:], facing_of(self.turn)) for w in self.local.windows)
        return trajectory_block((positions + self.step[:, None], directions), block)


def next_frame_rows(layout: FrameLayout, local: LocalMotion, phases: np.ndarray, frames: np.ndarray) -> NextFrameRows:
    """Returns the blocks of a clip's rows; arguments are the first attributes of `NextFrameRows`."""
    yaw, path = local.root.yaw, local.root.positions
    turn = yaw[frames + 1] - yaw[frames]
    step = to_local(path[frames + 1] - path[frames], local.root.facing[frames])
    return NextFrameRows(layout, local, phases, frames, turn, step)


def end_velocities(layout: FrameLayout, local: LocalMotion) -> np.ndarray:
    """Returns velocities [T, 12] of left hand, right hand, left toe and right toe in metres per second, root-relative.

    Args:
        layout: its `ends` must be the clip's end effectors.
        local: T frames relative to their roots.

    Raises:
        InputError: if the layout's end effectors are not the clip's.
    """
    ends = end_joints(local.world.skeleton)
    if layout.ends != ends:
        rule = f"must be joints {ends}, the clip's; make the layout with layout_for"
        raise InputError(local.world.clip.source, f"layout {layout.name}", f"end effectors {layout.ends}", rule)
    return local.velocities[:, list(ends)].reshape(local.world.num_frames, -1)
