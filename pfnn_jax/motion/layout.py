"""Frame layouts: which numbers a network reads and writes, where they stand and in which units.

Both layouts follow one frame rule, that of Holden et al. 2017. For frame i,

- x_i holds the trajectory around frame i relative to root i, and the joints of frame i-1 relative to root i-1;
- y_i holds the joints of frame i relative to root i; root velocity, yaw rate and phase change from frame i to i+1;
  and the trajectory from now on around frame i+1 relative to root i+1.

So the joint blocks of x_{i+1} equal those of y_i. No index arithmetic happens outside this file: blocks have names.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

TRAJECTORY_OFFSETS = tuple(range(-60, 60, 10))
"""Frames at 60 fps, relative to now, at which the trajectory is sampled (paper: one second each way)."""

NUM_SAMPLES = len(TRAJECTORY_OFFSETS)
"""12 trajectory samples in every input."""

NOW = TRAJECTORY_OFFSETS.index(0)
"""Index of the present among the samples."""

NUM_FUTURE = NUM_SAMPLES - NOW
"""6 trajectory samples, now to +50 frames, in every output."""

GAITS = ("stand", "walk", "jog", "crouch", "jump", "bump")
"""The gait labels of `pfnn2017`, in the order of its blocks of 12."""

Block = tuple[str, int]


def _slices(blocks: tuple[Block, ...]) -> dict[str, slice]:
    found, start = {}, 0
    for name, size in blocks:
        found[name] = slice(start, start + size)
        start += size
    return found


@dataclass(frozen=True)
class FrameLayout:
    """Named blocks of a network's input and output vectors, and their units.

    A rate per second is `value * unit / time_unit`, so that for an output vector y

    - metres = `y[joint_position] * length_unit`,
    - metres per second = `y[root_velocity] * length_unit / time_unit`,
    - radians per second about +Y = `y[root_yaw_rate] * yaw_unit / time_unit`,
    - radians of phase per second = `y[phase_change] * phase_unit / time_unit`.

    Attributes:
        name: key of `LAYOUTS`.
        num_joints: J.
        fps: frames per second of the motion it describes.
        length_unit: metres per unit of length.
        time_unit: seconds per unit of time.
        phase_unit: radians per unit of `phase_change`.
        yaw_unit: radians about +Y per unit of `root_yaw_rate`, sign included.
        inputs: (block, size) in order.
        outputs: (block, size) in order.
    """

    name: str
    num_joints: int
    fps: float
    length_unit: float
    time_unit: float
    phase_unit: float
    yaw_unit: float
    inputs: tuple[Block, ...]
    outputs: tuple[Block, ...]

    def __post_init__(self) -> None:
        if self.num_joints < 1:
            raise ValueError(f"FrameLayout.num_joints must be at least 1, got {self.num_joints}.")
        if min(self.fps, self.length_unit, self.time_unit, self.phase_unit) <= 0 or self.yaw_unit == 0:
            raise ValueError(f"FrameLayout units must be positive, got {self}.")

    @property
    def input_size(self) -> int:
        """Numbers in x."""
        return sum(size for _, size in self.inputs)

    @property
    def output_size(self) -> int:
        """Numbers in y."""
        return sum(size for _, size in self.outputs)

    def input_slice(self, name: str) -> slice:
        """Where a block stands in x.

        Raises:
            KeyError: for an unknown block, listing those there are.
        """
        return self._find(name, self.inputs, "input")

    def output_slice(self, name: str) -> slice:
        """Where a block stands in y.

        Raises:
            KeyError: for an unknown block, listing those there are.
        """
        return self._find(name, self.outputs, "output")

    def has_input(self, name: str) -> bool:
        """Whether x has a block of this name."""
        return any(block == name for block, _ in self.inputs)

    def has_output(self, name: str) -> bool:
        """Whether y has a block of this name."""
        return any(block == name for block, _ in self.outputs)

    def _find(self, name: str, blocks: tuple[Block, ...], side: str) -> slice:
        slices = _slices(blocks)
        if name not in slices:
            raise KeyError(f"No {side} block {name!r} in layout {self.name}; it has {list(slices)}.")
        return slices[name]


def _trajectory(samples: int) -> tuple[Block, ...]:
    return tuple((f"trajectory_{kind}_{axis}", samples) for kind in ("position", "direction") for axis in "xz")


def mason2018(num_joints: int = 31) -> FrameLayout:
    """Layout of Mason et al. 2018 (section 4): 48 + 6J inputs and 28 + 12J outputs, 234 and 400 for 31 joints.

    Metres, seconds and radians; outputs in the order in which the paper lists them.

    Args:
        num_joints: J.
    """
    joints = 3 * num_joints
    return FrameLayout(
        name="mason2018",
        num_joints=num_joints,
        fps=60.0,
        length_unit=1.0,
        time_unit=1.0,
        phase_unit=1.0,
        yaw_unit=1.0,
        inputs=(*_trajectory(NUM_SAMPLES), ("joint_position", joints), ("joint_velocity", joints)),
        outputs=(
            *_trajectory(NUM_FUTURE),
            ("joint_position", joints),
            ("joint_velocity", joints),
            ("joint_forward", joints),
            ("joint_up", joints),
            ("phase_change", 1),
            ("root_velocity", 2),
            ("root_yaw_rate", 1),
        ),
    )


def pfnn2017(num_joints: int = 31) -> FrameLayout:
    """Layout of Holden et al. 2017 (section 5): 156 + 6J inputs and 32 + 9J outputs, 342 and 311 for 31 joints.

    Centimetres per frame at 60 fps, phase change in cycles per frame, yaw rate in radians per frame about -Y, as in
    the published weights. `gait` is six blocks of 12 samples in the order of `GAITS`; `terrain_height` three blocks
    of 12: 25 cm to the left (+X), at the centre, 25 cm to the right. `joint_rotation` is the logarithm (half the
    angle times the axis) of each joint's rotation relative to the root.

    Args:
        num_joints: J.
    """
    joints = 3 * num_joints
    return FrameLayout(
        name="pfnn2017",
        num_joints=num_joints,
        fps=60.0,
        length_unit=0.01,
        time_unit=1.0 / 60.0,
        phase_unit=2.0 * math.pi,
        yaw_unit=-1.0,
        inputs=(
            *_trajectory(NUM_SAMPLES),
            ("gait", len(GAITS) * NUM_SAMPLES),
            ("joint_position", joints),
            ("joint_velocity", joints),
            ("terrain_height", 3 * NUM_SAMPLES),
        ),
        outputs=(
            ("root_velocity", 2),
            ("root_yaw_rate", 1),
            ("phase_change", 1),
            ("contacts", 4),
            *_trajectory(NUM_FUTURE),
            ("joint_position", joints),
            ("joint_velocity", joints),
            ("joint_rotation", joints),
        ),
    )


LAYOUTS: dict[str, Callable[[int], FrameLayout]] = {"mason2018": mason2018, "pfnn2017": pfnn2017}
"""Layouts by name; each takes the number of joints."""
