"""Rows by the frame rule of Holden et al. 2017, for layouts `pfnn2017` and `mason2018`; `layout` states the rule."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.features.layout import NOW, FrameLayout
from pfnn_jax.motion.features.local_motion import LocalMotion, trajectory_block
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.kinematics import quat_log
from pfnn_jax.motion.labels.contacts import estimate_gait, foot_joints, measured_leg_length, slow_feet
from pfnn_jax.motion.trajectory import sample_offsets
from pfnn_jax.motion.world_motion import WorldMotion

CONTACT_SPEED = 0.01 * np.sqrt(0.02) * 60
"""Metres per second: a squared displacement of 0.02 cm² in a frame (Holden's `contacts`; no height test)."""

STANDING_HEIGHTS = (0.05, 0.04, 0.05, 0.04)
"""Metres from the ground to left heel, left toe, right heel and right toe of a standing foot, from Holden's terrain
fitting. The ground under a flat clip is the mean, over contacts, of a foot joint's height minus this."""


@dataclass(frozen=True, eq=False)
class CurrentFrameRows:
    """Blocks of the rows of some frames: y_i describes frame i, and x_i the joints of the previous frame.

    Attributes:
        layout: with `next_frame` false.
        local: T frames relative to their roots.
        phases: [T] radians.
        gait: [T, 6], or None to estimate it from speed.
        frames: [N] indices, none of them the first or last frame.
        ground: height of the ground in metres, subtracted from the joints' heights.
    """

    layout: FrameLayout
    local: LocalMotion
    phases: np.ndarray
    gait: np.ndarray | None
    frames: np.ndarray
    ground: float

    def input(self, block: str) -> np.ndarray:
        """Returns one block [N, ...] of x in layout units."""
        if block.startswith("trajectory"):
            return self._trajectory(block, self.frames, 0)
        if block.startswith("joint"):
            return self._joints(block, self.frames - 1)
        if block == "gait":
            return self._gait_windows()
        # terrain heights: clips are taken to be on flat ground
        return np.zeros((len(self.frames), self.layout.input_width(block)))

    def output(self, block: str) -> np.ndarray:
        """Returns one block [N, ...] of y in layout units."""
        layout, frames, local = self.layout, self.frames, self.local
        rate = layout.time_unit * local.world.fps
        if block.startswith("trajectory"):
            return self._trajectory(block, frames + 1, NOW)
        if block.startswith("joint"):
            return self._joints(block, frames)
        if block == "contacts":
            return _contacts(local.world)[frames]
        if block == "root_velocity":
            return local.velocities[frames][:, 0, [0, 2]] * (layout.time_unit / layout.length_unit)
        if block == "root_yaw_rate":
            yaw = local.root.yaw
            return wrap_angle(yaw[frames + 1] - yaw[frames]) * (rate / layout.yaw_unit)
        return wrap_angle(self.phases[frames + 1] - self.phases[frames]) * (rate / layout.phase_unit)

    def _trajectory(self, block: str, frames: np.ndarray, first: int) -> np.ndarray:
        windows = self.local.windows[0][frames, first:], self.local.windows[1][frames, first:]
        return trajectory_block(windows, block) / (self.layout.length_unit if "position" in block else 1.0)

    def _joints(self, block: str, frames: np.ndarray) -> np.ndarray:
        layout, local = self.layout, self.local
        if block == "joint_position":
            return (local.positions[frames] - np.array([0.0, self.ground, 0.0])) / layout.length_unit
        if block == "joint_velocity":
            return local.velocities[frames] * (layout.time_unit / layout.length_unit)
        if block == "joint_rotation":
            return quat_log(local.rotations[frames])
        return local.axes[block][frames]

    def _gait_windows(self) -> np.ndarray:
        """Returns gait windows [N, 6, 12]; beyond the clip's ends the first and the last label are repeated."""
        world, gait = self.local.world, self.gait
        if gait is None:
            leg = measured_leg_length(world.positions, world.roles)
            gait = estimate_gait(self.local.root.positions, leg, world.fps)
        if len(gait) != world.num_frames:
            raise InputError(
                world.clip.source, "gait", f"{len(gait)} frames", f"must have {world.num_frames} like the clip"
            )
        index = np.clip(self.frames[:, None] + sample_offsets(world.fps), 0, world.num_frames - 1)
        return np.moveaxis(gait[index], 2, 1)


def current_frame_rows(
    layout: FrameLayout,
    local: LocalMotion,
    phases: np.ndarray,
    gait: np.ndarray | None,
    frames: np.ndarray,
) -> CurrentFrameRows:
    """Returns the blocks of a clip's rows; arguments are the attributes of `CurrentFrameRows`."""
    ground = _ground(local.world) if layout.has_input("terrain_height") else 0.0
    return CurrentFrameRows(layout, local, phases, gait, frames, ground)


def _contacts(motion: WorldMotion) -> np.ndarray:
    """Returns the contacts [T, 4] of heels and toes by the authors' rule of speed alone."""
    return slow_feet(motion.positions, motion.roles, motion.fps, CONTACT_SPEED)


def _ground(motion: WorldMotion) -> float:
    """Returns the height of the ground of a flat clip in metres; 0 where no foot is ever in contact."""
    contact = _contacts(motion)[:-1]
    heights = motion.positions[:-1, foot_joints(motion.roles), 1] - np.array(STANDING_HEIGHTS)
    return float(heights[contact].mean()) if contact.any() else 0.0
