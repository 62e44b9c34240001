"""The record of a frame layout: named blocks of x and y, their columns and units."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pfnn_jax.motion.blocks import Blocks, Columns, block_columns, column_names

PhaseKind = Literal["global", "local", "velocity"]
PHASE_SIZES: dict[PhaseKind, int] = {"global": 0, "local": 8, "velocity": 12}
"""Numbers that the blending coefficients depend on; 0 is the scalar phase of a gait cycle."""


@dataclass(frozen=True)
class FrameLayout:
    """Named blocks of a network's input and output vectors, and their units.

    A rate per second is `value * unit / time_unit`, so that for an output vector y

    - metres = `y[joint_position] * length_unit`,
    - metres per second = `y[root_velocity] * length_unit / time_unit`,
    - radians per second about +Y = `y[root_yaw_rate] * yaw_unit / time_unit`,
    - radians of phase per second = `y[phase_change] * phase_unit / time_unit`.

    Attributes:
        name: of the layout.
        num_joints: J.
        fps: frames per second of the motion it describes.
        length_unit: metres per unit of length.
        time_unit: seconds per unit of time.
        phase_unit: radians per unit of `phase_change`.
        yaw_unit: radians about +Y per unit of `root_yaw_rate`, sign included.
        inputs: (block, size) or interleaved blocks, in order.
        outputs: likewise.
        phase_kind: what the blending coefficients depend on: `global`, the phase of the gait cycle in radians;
            `local`, (sin, cos) of four end effectors scaled by amplitude and speed; `velocity`, the velocities of
            the four in metres per second, seen from the root.
        next_frame: whether outputs are those of the next frame, seen from the current root.
        hips_heading: whether the root faces where the hips alone do, without smoothing, rather than where hips and
            shoulders do, smoothed.
        ends: joints of left hand, right hand, left toe and right toe, the end effectors of `local` and `velocity`;
            empty where they are not used, or not known yet (`layout.layout_for` finds them).
    """

    name: str
    num_joints: int
    fps: float
    length_unit: float
    time_unit: float
    phase_unit: float
    yaw_unit: float
    inputs: Blocks
    outputs: Blocks
    phase_kind: PhaseKind = "global"
    next_frame: bool = False
    hips_heading: bool = False
    ends: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.num_joints < 1:
            raise ValueError(f"FrameLayout.num_joints must be at least 1, got {self.num_joints}.")
        if min(self.fps, self.length_unit, self.time_unit, self.phase_unit) <= 0 or self.yaw_unit == 0:
            raise ValueError(f"FrameLayout units must be positive, got {self}.")
        if self.ends and (len(self.ends) != 4 or not all(0 <= end < self.num_joints for end in self.ends)):
            raise ValueError(f"FrameLayout.ends must be 4 of {self.num_joints} joints, got {self.ends}.")

    @property
    def input_size(self) -> int:
        """Numbers in x."""
        return len(self.input_names)

    @property
    def output_size(self) -> int:
        """Numbers in y."""
        return len(self.output_names)

    @property
    def phase_size(self) -> int:
        """Numbers that the blending coefficients depend on: 0 for a scalar phase, else the width of `phase`."""
        return PHASE_SIZES[self.phase_kind]

    @property
    def input_names(self) -> tuple[str, ...]:
        """[Dx] block of every column of x."""
        return column_names(self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """[Dy] block of every column of y."""
        return column_names(self.outputs)

    @property
    def input_blocks(self) -> tuple[str, ...]:
        """Blocks of x in order of first appearance, each once."""
        return tuple(block_columns(self.inputs))

    @property
    def output_blocks(self) -> tuple[str, ...]:
        """Blocks of y in order of first appearance, each once."""
        return tuple(block_columns(self.outputs))

    def input_slice(self, name: str) -> Columns:
        """Where a block stands in x: a slice where its columns are regular, else an array of indices.

        Raises:
            KeyError: for an unknown block, listing those there are.
        """
        return self._find(name, self.inputs, "input")

    def output_slice(self, name: str) -> Columns:
        """Where a block stands in y; as `input_slice`.

        Raises:
            KeyError: for an unknown block, listing those there are.
        """
        return self._find(name, self.outputs, "output")

    def input_width(self, name: str) -> int:
        """Number of columns of a block of x; 0 where there is none of this name."""
        return self.input_names.count(name)

    def output_width(self, name: str) -> int:
        """Number of columns of a block of y; 0 where there is none of this name."""
        return self.output_names.count(name)

    def has_input(self, name: str) -> bool:
        """Whether x has a block of this name."""
        return name in self.input_blocks

    def has_output(self, name: str) -> bool:
        """Whether y has a block of this name."""
        return name in self.output_blocks

    def _find(self, name: str, blocks: Blocks, side: str) -> Columns:
        columns = block_columns(blocks)
        if name not in columns:
            raise KeyError(f"No {side} block {name!r} in layout {self.name}; it has {list(columns)}.")
        return columns[name]
