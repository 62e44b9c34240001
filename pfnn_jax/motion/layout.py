"""Frame layouts: which numbers a network reads and writes, where they stand and in which units.

There are two frame rules. `mason2018` and `pfnn2017` follow that of Holden et al. 2017. For frame i,

- x_i holds the trajectory around frame i relative to root i, and the joints of frame i-1 relative to root i-1;
- y_i holds the joints of frame i relative to root i; root velocity, yaw rate and phase change from frame i to i+1;
  and the trajectory from now on around frame i+1 relative to root i+1;
- velocities look forward, from i to i+1.

So the joint blocks of x_{i+1} equal those of y_i. The `mason2022` layouts (`next_frame`) follow that of Mason et al.
2022:

- x_i holds the trajectory and the joints of frame i relative to root i;
- y_i holds the trajectory from now on and the joints of frame i+1, still relative to root i;
- velocities look back, from i-1 to i.

So the first trajectory sample of y_i is root i+1 seen from root i, and stands for a root velocity. No index arithmetic
happens outside this file and `frame_layout`: blocks have names.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from pfnn_jax.motion.blocks import Block, Interleaved
from pfnn_jax.motion.frame_layout import FrameLayout, PhaseKind
from pfnn_jax.motion.skeleton import Skeleton, need_roles

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

STYLE100_ENDS = (16, 11, 24, 20)
"""Left hand end, right hand end, left toe, right toe among the 25 joints of 100STYLE."""


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


def mason2022(num_joints: int = 25, ends: tuple[int, ...] | None = None) -> FrameLayout:
    """Layout of Mason et al. 2022 (section 4.2): 48 + 12J inputs and 42 + 12J outputs, 348 and 342 for 25 joints.

    Metres, seconds and radians. Trajectory samples and joints are interleaved, in the order of the published weights:
    a sample is position x, z, direction x, z; a joint is position, forward, up, velocity. Outputs end with the local
    phases of the next frame, their change, and the contacts of the right and of the left foot. Blending coefficients
    depend on the eight numbers of the local phases.

    Args:
        num_joints: J.
        ends: joints of left hand, right hand, left toe, right toe; None takes those of 100STYLE for 25 joints and
            leaves them unknown for others.
    """
    phases: tuple[Block, ...] = (("local_phase", 8), ("local_phase_change", 8), ("foot_contacts", 2))
    return _mason2022("mason2022", num_joints, phases, "local", ends)


def mason2022_mann(num_joints: int = 25, ends: tuple[int, ...] | None = None) -> FrameLayout:
    """`mason2022` for mode-adaptive networks (Zhang et al. 2018): 48 + 12J inputs, 26 + 12J outputs, 326 for 25 joints.

    No phases; blending coefficients depend on the velocities of the four end effectors. Arguments as `mason2022`.
    """
    return _mason2022("mason2022_mann", num_joints, (("foot_contacts", 2),), "velocity", ends)


def mason2022_pfnn(num_joints: int = 25) -> FrameLayout:
    """`mason2022` for phase-functioned networks: 48 + 12J inputs and 27 + 12J outputs, 327 for 25 joints.

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
"""Layouts by name; each takes the number of joints. Where a skeleton is at hand, `layout_for` knows its end effectors
too."""


def layout_for(name: str, skeleton: Skeleton) -> FrameLayout:
    """The layout of this name for a skeleton, with its end effectors where the layout uses them.

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
    """Joints of left hand, right hand, left toe and right toe, the order of local phases.

    Raises:
        InputError: if the skeleton has no roles.
    """
    roles = need_roles(skeleton)
    return roles.left_hand, roles.right_hand, roles.left_foot[1], roles.right_foot[1]
