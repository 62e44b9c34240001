"""Units of a layout's blocks, conversion between layouts, and the layout of the 2018 authors' run-time code."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pfnn_jax.motion.features.layout import FrameLayout, mason2018

LENGTHS = ("trajectory_position_x", "trajectory_position_z", "joint_position", "terrain_height")
VELOCITIES = ("joint_velocity", "root_velocity")


def block_unit(layout: FrameLayout, name: str) -> tuple[float, str]:
    """Returns the factor that converts a block to SI units, and the name of that unit.

    Args:
        layout: with the block among its inputs or outputs.
        name: of the block.

    Returns:
        The factor, and `m`, `m/s`, `rad/s`, or `1` for numbers without a unit.
    """
    if name in LENGTHS:
        return layout.length_unit, "m"
    if name in VELOCITIES:
        return layout.length_unit / layout.time_unit, "m/s"
    if name == "root_yaw_rate":
        return layout.yaw_unit / layout.time_unit, "rad/s"
    if name == "phase_change":
        return layout.phase_unit / layout.time_unit, "rad/s"
    return 1.0, "1"


def authors2018(num_joints: int = 31) -> FrameLayout:
    """Returns `mason2018` as the authors' run-time code reads and writes it.

    Lengths are in half metres (its `UnitScale` is 2), times in frames at 60 fps, yaw rate in degrees per frame and
    phase change in cycles per frame; in the outputs, root and phase come before the trajectory.

    Args:
        num_joints: J.
    """
    ours = mason2018(num_joints)
    first = (("root_velocity", 2), ("root_yaw_rate", 1), ("phase_change", 1))
    return replace(
        ours,
        length_unit=0.5,
        time_unit=1.0 / ours.fps,
        phase_unit=2.0 * math.pi,
        yaw_unit=math.pi / 180.0,
        outputs=(*first, *(block for block in ours.outputs if block not in first)),
    )


def convert_columns(source: FrameLayout, target: FrameLayout, side: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns how rows of one layout become rows of another with the same blocks.

    Args:
        source, target: layouts with blocks of the same names and widths, in any order and units.
        side: `inputs` or `outputs`.

    Returns:
        Columns [D] of the source and factors [D], so that `row[columns] * factors` is the target's row.
    """
    slices = [(layout.input_slice if side == "inputs" else layout.output_slice) for layout in (source, target)]
    sizes = [(layout.input_size if side == "inputs" else layout.output_size) for layout in (source, target)]
    columns, factors = np.zeros(sizes[1], np.int64), np.ones(sizes[1])
    for name in target.input_blocks if side == "inputs" else target.output_blocks:
        there = slices[1](name)
        columns[there] = np.arange(sizes[0])[slices[0](name)]
        factors[there] = block_unit(source, name)[0] / block_unit(target, name)[0]
    return columns, factors
