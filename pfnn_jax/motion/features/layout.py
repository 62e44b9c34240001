"""Frame layouts: which numbers a network reads and writes, at which columns and in which units.

There are two frame rules. `mason2018` and `pfnn2017` follow Holden et al. 2017. For frame i,

- x_i holds the trajectory around frame i relative to root i, and the joints of frame i-1 relative to root i-1;
- y_i holds the joints of frame i relative to root i; root velocity, yaw rate and phase change from frame i to i+1;
  and the future trajectory of frame i+1 relative to root i+1;
- velocities look forward, from i to i+1.

So the joint blocks of x_{i+1} equal those of y_i. The `mason2022` layouts (`next_frame`) follow Mason et al. 2022:

- x_i holds the trajectory and the joints of frame i relative to root i;
- y_i holds the future trajectory and the joints of frame i+1, still relative to root i;
- velocities look back, from i-1 to i.

So the first trajectory sample of y_i is root i+1 relative to root i, which serves as the root velocity. Blocks have
names, so that index arithmetic is confined to this file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from pfnn_jax.motion.skeleton import MAX_JOINTS, Skeleton, need_roles

Block = tuple[str, int]
"""Name and number of columns."""

Columns = slice | np.ndarray
"""The columns of a block: usable in `y[:, columns]`, `y.at[columns].set` and `np.r_[columns]`."""


@dataclass(frozen=True)
class Interleaved:
    """Blocks that alternate: all `parts` in order, repeated `count` times.

    The block of a part has `count * size` columns. Interleaved joints read as `y[:, columns].reshape(N, J, 3)`.

    Attributes:
        count: number of repetitions.
        parts: (block, columns in one repetition) in order.
    """

    count: int
    parts: tuple[Block, ...]


Blocks = tuple[Block | Interleaved, ...]
"""All blocks of a vector, in order."""


@lru_cache(maxsize=256)
def column_names(blocks: Blocks) -> tuple[str, ...]:
    """Returns the block name of each of D columns."""
    return tuple(name for name, size in _turns(blocks) for _ in range(size))


@lru_cache(maxsize=256)
def block_columns(blocks: Blocks) -> dict[str, Columns]:
    """Returns the columns of every block, by name in order of first appearance.

    Contiguous or regularly strided blocks are slices, others read-only arrays of indices.

    Raises:
        ValueError: if a name belongs to two blocks, or a size is not positive.
    """
    parts = [part for block in blocks for part in (block.parts if isinstance(block, Interleaved) else (block,))]
    names = [name for name, _ in parts]
    if len(set(names)) < len(names):
        raise ValueError(f"Block names must be unique, got {names}.")
    counts = [block.count for block in blocks if isinstance(block, Interleaved)]
    if min([size for _, size in parts] + counts, default=1) < 1:
        raise ValueError(f"A block must have at least one column, got {blocks}.")
    owners = np.array(column_names(blocks))
    return {name: _columns(np.flatnonzero(owners == name)) for name in names}


def _turns(blocks: Blocks) -> Iterator[Block]:
    for block in blocks:
        yield from block.parts * block.count if isinstance(block, Interleaved) else (block,)


def _columns(index: np.ndarray) -> Columns:
    first, last = int(index[0]), int(index[-1])
    steps = set(np.diff(index).tolist())
    if steps <= {1}:
        return slice(first, last + 1)
    if len(steps) == 1:
        return slice(first, last + 1, steps.pop())
    # Unsigned, so that JAX does not wrap negative indices: it caches the width of signed constants between programs,
    # and fails where another precision is in force.
    index = index.astype(np.uint32)
    index.setflags(write=False)
    return index


PhaseKind = Literal["global", "local", "velocity"]
PHASE_SIZES: dict[PhaseKind, int] = {"global": 0, "local": 8, "velocity": 12}
"""Size of the gating input; 0 for the scalar phase of a gait cycle."""


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
        inputs: (block, size) or interleaved blocks, in order.
        outputs: as `inputs`.
        phase_kind: the gating input: `global`, the phase of the gait cycle in radians;
            `local`, (sin, cos) of four end effectors scaled by amplitude and speed; `velocity`, the velocities of
            the four in metres per second, relative to the root.
        next_frame: whether outputs describe the next frame relative to the current root.
        hips_heading: whether the root takes its facing from the hips alone, unsmoothed, rather than from hips and
            shoulders, smoothed.
        ends: joints of left hand, right hand, left toe and right toe, the end effectors of `local` and `velocity`;
            empty where they are unused or unknown (`layout_for` finds them).
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
        if not 1 <= self.num_joints <= MAX_JOINTS:
            raise ValueError(f"FrameLayout.num_joints must be 1 to {MAX_JOINTS}, got {self.num_joints}.")
        if min(self.fps, self.length_unit, self.time_unit, self.phase_unit) <= 0 or self.yaw_unit == 0:
            raise ValueError(f"FrameLayout units must be positive, got {self}.")
        if self.ends and (len(self.ends) != 4 or not all(0 <= end < self.num_joints for end in self.ends)):
            raise ValueError(f"FrameLayout.ends must be 4 of {self.num_joints} joints, got {self.ends}.")

    @property
    def input_size(self) -> int:
        """Dx, the size of x."""
        return len(self.input_names)

    @property
    def output_size(self) -> int:
        """Dy, the size of y."""
        return len(self.output_names)

    @property
    def phase_size(self) -> int:
        """G, the size of the gating input; 0 for a scalar phase."""
        return PHASE_SIZES[self.phase_kind]

    @property
    def input_names(self) -> tuple[str, ...]:
        """Block names of the Dx columns of x."""
        return column_names(self.inputs)

    @property
    def output_names(self) -> tuple[str, ...]:
        """Block names of the Dy columns of y."""
        return column_names(self.outputs)

    @property
    def joint_inputs(self) -> np.ndarray:
        """Mask [Dx] of the columns of x that describe joints."""
        return np.array([name.startswith("joint_") for name in self.input_names])

    @property
    def input_blocks(self) -> tuple[str, ...]:
        """Blocks of x in order of first appearance."""
        return tuple(block_columns(self.inputs))

    @property
    def output_blocks(self) -> tuple[str, ...]:
        """Blocks of y in order of first appearance."""
        return tuple(block_columns(self.outputs))

    def input_slice(self, name: str) -> Columns:
        """Returns the columns of a block of x: a slice where they are regular, else an array of indices.

        Raises:
            KeyError: for an unknown block, listing the known ones.
        """
        return self._find(name, self.inputs, "input")

    def output_slice(self, name: str) -> Columns:
        """Returns the columns of a block of y, as `input_slice` does.

        Raises:
            KeyError: for an unknown block, listing the known ones.
        """
        return self._find(name, self.outputs, "output")

    def input_width(self, name: str) -> int:
        """Returns the number of columns of a block of x; 0 if there is no such block."""
        return self.input_names.count(name)

    def output_width(self, name: str) -> int:
        """Returns the number of columns of a block of y; 0 if there is no such block."""
        return self.output_names.count(name)

    def has_input(self, name: str) -> bool:
        """Returns whether x has a block of this name."""
        return name in self.input_blocks

    def has_output(self, name: str) -> bool:
        """Returns whether y has a block of this name."""
        return name in self.output_blocks

    def _find(self, name: str, blocks: Blocks, side: str) -> Columns:
        columns = block_columns(blocks)
        if name not in columns:
            raise KeyError(f"No {side} block {name!r} in layout {self.name}; it has {list(columns)}.")
        return columns[name]


TRAJECTORY_OFFSETS = tuple(range(-60, 60, 10))
"""Frames at 60 fps, relative to now, at which the trajectory is sampled (paper: one second each way)."""

NUM_SAMPLES = len(TRAJECTORY_OFFSETS)
"""Trajectory samples in every input: 12."""

NOW = TRAJECTORY_OFFSETS.index(0)
"""Index of the present among the samples."""

NUM_FUTURE = NUM_SAMPLES - NOW
"""Trajectory samples in every output: 6, from now to +50 frames."""

GAITS = ("stand", "walk", "jog", "crouch", "jump", "bump")
"""The gait labels of `pfnn2017`, in the order of its blocks of 12."""

STYLE100_ENDS = (16, 11, 24, 20)
"""End of left hand, end of right hand, left toe and right toe among the 25 joints of 100STYLE."""


def _trajectory(samples: int) -> tuple[Block, ...]:
    return tuple((f"trajectory_{kind}_{axis}", samples) for kind in ("position", "direction") for axis in "xz")


def mason2018(num_joints: int = 31) -> FrameLayout:
    """Returns the layout of Mason et al. 2018 (section 4): 48 + 6J inputs, 28 + 12J outputs (234, 400 for 31 joints).

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
    """Returns the layout of Holden et al. 2017 (section 5): 156 + 6J inputs, 32 + 9J outputs (342, 311 for 31 joints).

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


def mason2022(num_joints: int = 25, ends: tuple[int, ...] | None = None) -> FrameLayout:
    """Returns the layout of Mason et al. 2022 (section 3.2): 48 + 12J inputs and 42 + 12J outputs.

    For 25 joints these are 348 and 342.

    Metres, seconds and radians. Trajectory samples and joints are interleaved, in the order of the published weights:
    a sample is position x, z, direction x, z; a joint is position, forward, up, velocity. Outputs end with the local
    phases of the next frame, their change, and the contacts of the right and the left foot. The gating input is the
    eight numbers of the local phases.

    Args:
        num_joints: J.
        ends: joints of left hand, right hand, left toe, right toe; None takes those of 100STYLE for 25 joints and
            leaves them unknown for others.
    """
    phases: tuple[Block, ...] = (("local_phase", 8), ("local_phase_change", 8), ("foot_contacts", 2))
    return _mason2022("mason2022", num_joints, phases, "local", ends)


def mason2022_mann(num_joints: int = 25, ends: tuple[int, ...] | None = None) -> FrameLayout:
    """Returns `mason2022` for mode-adaptive networks (Zhang et al. 2018): 48 + 12J inputs, 26 + 12J outputs.

    326 outputs for 25 joints. There are no phases: the gating input is the velocities of the four end effectors.
    Arguments as `mason2022`.
    """
    return _mason2022("mason2022_mann", num_joints, (("foot_contacts", 2),), "velocity", ends)


def mason2022_pfnn(num_joints: int = 25) -> FrameLayout:
    """Returns `mason2022` for phase-functioned networks: 48 + 12J inputs, 27 + 12J outputs (327 for 25 joints).

    Outputs end with the contacts and `phase_change`, radians per second as in `mason2018`.

    Args:
        num_joints: J.
    """
    return _mason2022("mason2022_pfnn", num_joints, (("foot_contacts", 2), ("phase_change", 1)), "global", ())


def _mason2022(
    name: str, num_joints: int, last: tuple[Block, ...], phase_kind: PhaseKind, ends: tuple[int, ...] | None
) -> FrameLayout:
    sample = _trajectory(1)
    joints = Interleaved(
        num_joints, (("joint_position", 3), ("joint_forward", 3), ("joint_up", 3), ("joint_velocity", 3))
    )
    if ends is None:
        ends = STYLE100_ENDS if num_joints == 25 else ()
    return FrameLayout(
        name=name,
        num_joints=num_joints,
        fps=60.0,
        length_unit=1.0,
        time_unit=1.0,
        phase_unit=1.0,
        yaw_unit=1.0,
        inputs=(Interleaved(NUM_SAMPLES, sample), joints),
        outputs=(Interleaved(NUM_FUTURE, sample), joints, *last),
        phase_kind=phase_kind,
        next_frame=True,
        hips_heading=True,
        ends=ends,
    )


LAYOUTS: dict[str, Callable[[int], FrameLayout]] = {
    layout.__name__: layout for layout in (mason2018, pfnn2017, mason2022, mason2022_mann, mason2022_pfnn)
}
"""Layouts by name; each takes the number of joints. For a given skeleton `layout_for` finds the end effectors too."""


def layout_for(name: str, skeleton: Skeleton) -> FrameLayout:
    """Returns the layout of this name for a skeleton, with the end effectors if the layout uses them.

    Args:
        name: key of `LAYOUTS`.
        skeleton: J joints; for `mason2022` layouts as `extend_hands` makes it, with roles.

    Raises:
        KeyError: for an unknown name.
        InputError: if the layout uses end effectors and the skeleton has no roles.
    """
    layout = LAYOUTS[name](skeleton.num_joints)
    return replace(layout, ends=end_joints(skeleton)) if layout.phase_size else layout


def end_joints(skeleton: Skeleton) -> tuple[int, ...]:
    """Returns the joints of left hand, right hand, left toe and right toe, in the order of local phases.

    Raises:
        InputError: if the skeleton has no roles.
    """
    roles = need_roles(skeleton)
    return roles.left_hand, roles.right_hand, roles.left_foot[1], roles.right_foot[1]
