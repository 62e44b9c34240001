"""Turns rows that a network has written back into motion. The frame rules are documented in `layout`."""

from __future__ import annotations

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import require_finite
from pfnn_jax.motion.ground import facing_of, to_world
from pfnn_jax.motion.kinematics import (
    quat_conjugate,
    quat_exp,
    quat_from_forward_up,
    quat_from_yaw,
    quat_multiply,
)
from pfnn_jax.motion.skeleton import Skeleton


def root_steps(layout: FrameLayout, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the motion of the root to the next frame, read from the outputs of any layout.

    Under `next_frame` layouts the next root is the first trajectory sample.

    Args:
        layout: of the outputs.
        y: [N, Dy] in layout units.

    Returns:
        velocity [N, 2] metres per second (x, z) relative to the current root, and yaw rate [N] radians per second.
    """

    def block(name: str) -> np.ndarray:
        return y[:, layout.output_slice(name)]

    if not layout.next_frame:
        velocity = block("root_velocity") * (layout.length_unit / layout.time_unit)
        return velocity, block("root_yaw_rate")[:, 0] * (layout.yaw_unit / layout.time_unit)
    x, z, forward_x, forward_z = (
        block(f"trajectory_{kind}_{axis}")[:, 0] for kind in ("position", "direction") for axis in "xz"
    )
    velocity = np.stack([x, z], axis=-1) * (layout.length_unit * layout.fps)
    return velocity, np.arctan2(forward_x, forward_z) * layout.fps


def median_speed(layout: FrameLayout, y: np.ndarray) -> float:
    """Returns the median speed along the ground in metres per second over rows y [N, Dy] in layout units.

    The median of many walks and a few runs is the speed of a walk.
    """
    velocity, _ = root_steps(layout, y)
    return float(np.median(np.linalg.norm(velocity, axis=1)))


def clip_from_outputs(
    skeleton: Skeleton,
    layout: FrameLayout,
    y: np.ndarray,
    root_positions: np.ndarray,
    root_yaw: np.ndarray,
    fps: float = 60.0,
) -> MotionClip:
    """Returns the motion that outputs describe, on roots that the caller has integrated (`root_steps`).

    Joint rotations and the position of joint 0 come from the outputs; the positions of the other joints follow from the
    skeleton, so that bones are rigid whatever the network predicts.

    Args:
        skeleton: J joints.
        layout: of J joints; its units are those of `y`.
        y: [T, Dy] in layout units.
        root_positions: [T, 2] metres on the ground, of the roots that the outputs are relative to; under `next_frame`
            layouts these are the roots of the previous frames.
        root_yaw: [T] radians about +Y, of the same roots.
        fps: frames per second.

    Raises:
        InputError: if the width is not the layout's, or a value is not finite.
    """
    y = np.asarray(y, np.float64)
    if y.ndim != 2 or y.shape[1] != layout.output_size or skeleton.num_joints != layout.num_joints:
        raise InputError(
            "outputs",
            "array",
            f"shape {y.shape} on {skeleton.num_joints} joints",
            f"layout {layout.name} has {layout.output_size} columns for {layout.num_joints}",
        )
    require_finite(y, layout.output_names, "outputs", "y")
    yaw = np.asarray(root_yaw, np.float64)
    hips = y[:, layout.output_slice("joint_position")][:, :3] * layout.length_unit
    hips = to_world(hips, facing_of(yaw))
    hips[:, [0, 2]] += root_positions
    world = quat_multiply(quat_from_yaw(yaw)[:, None], _output_rotations(layout, y))
    above = world[:, np.maximum(skeleton.parents, 0)]
    local = quat_multiply(quat_conjugate(above), world)
    local[:, 0] = world[:, 0]
    return MotionClip(skeleton, fps, hips, local)


def _output_rotations(layout: FrameLayout, y: np.ndarray) -> np.ndarray:
    """Returns rotations [T, J, 4] relative to the root."""

    def block(name: str) -> np.ndarray:
        return y[:, layout.output_slice(name)].reshape(len(y), layout.num_joints, 3)

    if layout.has_output("joint_rotation"):
        return quat_exp(block("joint_rotation"))
    return quat_from_forward_up(block("joint_forward"), block("joint_up"))
