"""Tests of a learned style: one-step errors on unseen takes, locked rollouts, and walks on circles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.loop.rollout import locked_rollout
from pfnn_jax.control.stability import TURN_RATE, walk_circles
from pfnn_jax.evaluation.metrics import (
    achieved_turn_rate,
    bone_length_error,
    foot_skating,
    jitter,
    nearest_pose_distance,
    one_step_error,
    planted_heights,
    skating_ratio,
)
from pfnn_jax.inference.predictor import Predictor, evaluate
from pfnn_jax.inference.rows import evaluate_rows
from pfnn_jax.motion.features.decode import median_speed, root_steps
from pfnn_jax.motion.features.encode import Features, join_rows, select_rows
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.skeleton import Skeleton, need_roles

LOCKED_SECONDS = 3.0
"""Length of the rollouts with root, trajectory and phase locked to the ground truth."""


@dataclass(frozen=True, eq=False)
class Takes:
    """Concatenated rows of several takes, in layout units.

    Attributes:
        rows: x, y, phase and frames of all takes.
        take: [N] index of each row's take.
        names: names of the takes.
    """

    rows: Features
    take: np.ndarray
    names: tuple[str, ...]


def join_takes(parts: Sequence[Features], names: Sequence[str]) -> Takes:
    """Returns the takes with the given features and names as one record."""
    return Takes(join_rows(parts), np.repeat(np.arange(len(parts)), [len(p.x) for p in parts]), tuple(names))


def is_turning(y: np.ndarray, layout: FrameLayout, degrees_per_second: float = 20.0) -> np.ndarray:
    """Returns [N] bool: whether the root turns faster than a rate in the true outputs y [N, Dy]."""
    return np.abs(np.rad2deg(root_steps(layout, y)[1])) > degrees_per_second


def pose_and_velocity_error(y: np.ndarray, predicted: np.ndarray, layout: FrameLayout, std: np.ndarray) -> np.ndarray:
    """Returns the mean squared normalised error [N] of each row's joint positions and velocities."""
    columns = np.r_[layout.output_slice("joint_position"), layout.output_slice("joint_velocity")]
    return np.mean(((predicted - y)[:, columns] / std[columns]) ** 2, axis=1)


def one_step_test(predictor: Predictor, takes: Takes, layout: FrameLayout, std: np.ndarray) -> dict[str, Any]:
    """Returns one-step errors on takes: by group of columns, on the turning frames only, and per take.

    Args:
        predictor: the network and style.
        takes: true rows.
        layout: frame layout of the rows.
        std: [Dy] by which errors are divided; the same for all compared methods.

    Returns:
        `all` and the groups of `one_step_error`; `pose_velocity` (positions and velocities together) over all frames,
        `pose_velocity_turning` over those that turn faster than 20°/s (None if there are none); and
        `per_take`: name -> error.
    """
    y = takes.rows.y
    predicted = evaluate_rows(predictor, takes.rows.x, takes.rows.phase)
    errors = pose_and_velocity_error(y, predicted, layout, std)
    turning = is_turning(y, layout)
    per_take = np.bincount(takes.take, errors) / np.bincount(takes.take)
    return {
        **one_step_error(y, predicted, layout, std),
        "pose_velocity": float(errors.mean()),
        "pose_velocity_turning": float(errors[turning].mean()) if turning.any() else None,
        "per_take": dict(zip(takes.names, per_take.tolist(), strict=True)),
    }


def locked_test(
    predictor: Predictor, takes: Takes, layout: FrameLayout, std: np.ndarray, num_frames: int, most: int = 12
) -> float:
    """Returns the pose-and-velocity error of rollouts with root, trajectory and phase locked to the ground truth.

    Args:
        predictor, takes, layout, std: as for `one_step_test`.
        num_frames: length of each rollout; takes with fewer consecutive rows are skipped.
        most: largest number of takes.

    Returns:
        Mean over takes and frames; infinity if a rollout is not finite, NaN if no take is long enough.
    """
    starts = [np.flatnonzero(takes.take == index) for index in range(len(takes.names))]
    windows = [rows[:num_frames] for rows in starts if len(rows) >= num_frames][:most]
    windows = [rows for rows in windows if takes.rows.frames[rows[-1]] - takes.rows.frames[rows[0]] == num_frames - 1]
    if not windows:
        return float("nan")
    rows = np.stack(windows)
    run = partial(locked_rollout, evaluate, predictor, layout)
    outputs = np.asarray(jax.vmap(run)(jnp.asarray(takes.rows.x[rows]), jnp.asarray(takes.rows.phase[rows])))
    errors = [pose_and_velocity_error(takes.rows.y[r], o, layout, std) for r, o in zip(rows, outputs, strict=True)]
    error = float(np.mean(errors))
    return error if np.isfinite(error) else float("inf")


def circle_test(
    predictor: Predictor, clip: Features, turning: Features, layout: FrameLayout, skeleton: Skeleton, seconds: float
) -> dict[str, float]:
    """Measures walks on a left and a right circle at 45°/s, started in the clip's first pose.

    Args:
        predictor: the network and style.
        clip: rows of the adaptation clip, for the first pose and the speed.
        turning: all real rows of the style while it turns.
        layout, skeleton: frame layout and skeleton of the rows.
        seconds: length of each walk.

    Returns:
        Means over both sides: `turn_rate` (achieved over commanded), `nearest_turning_pose` (metres), `skating` (m/s),
        `skating_ratio`, `bone_error` (metres) and `jitter` (m/s³); all infinite if a walk is not finite.
    """
    speed = max(median_speed(layout, clip.y), 0.3)
    frames = walk_circles(predictor, layout, clip.x[0], clip.phase[0], speed, seconds)
    if not np.isfinite(np.asarray(frames.outputs)).all():
        names = ("turn_rate", "nearest_turning_pose", "skating", "skating_ratio", "bone_error", "jitter")
        return dict.fromkeys(names, float("inf"))
    pose, warm_up = layout.output_slice("joint_position"), round(layout.fps)
    real = _poses(turning.y[:, pose], layout)
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    roles = need_roles(skeleton)
    feet = [*roles.left_foot, *roles.right_foot]
    sides = []
    for side in range(2):
        outputs, joints = np.asarray(frames.outputs[side])[warm_up:], np.asarray(frames.joint_positions[side])[warm_up:]
        rate = achieved_turn_rate(np.asarray(frames.root_yaw[side])[warm_up:], layout.fps)
        ground = planted_heights(real[:, feet])
        sides.append(
            {
                "turn_rate": rate / np.rad2deg(TURN_RATE) * (1.0 if side == 0 else -1.0),
                "nearest_turning_pose": float(nearest_pose_distance(_poses(outputs[:, pose], layout), real).mean()),
                "skating": foot_skating(joints[:, feet], layout.fps, ground),
                "skating_ratio": skating_ratio(joints[:, feet], layout.fps, ground),
                "bone_error": bone_length_error(joints, skeleton.parents, lengths),
                "jitter": jitter(joints, layout.fps),
            }
        )
    return {name: float(np.mean([side[name] for side in sides])) for name in sides[0]}


def _poses(rows: np.ndarray, layout: FrameLayout) -> np.ndarray:
    """Returns joint positions [N, J, 3] in metres relative to the root."""
    return rows.reshape(len(rows), layout.num_joints, 3) * layout.length_unit


@dataclass(frozen=True, eq=False)
class StyleTest:
    """The data on which every method of learning one style is measured.

    Attributes:
        layout, skeleton: frame layout and skeleton of all rows.
        clip: rows of the adaptation clip.
        straight, turning: takes of the style that no method was trained on.
        std: [Dy] by which errors are divided.
        circle_seconds: length of the walks on circles.
    """

    layout: FrameLayout
    skeleton: Skeleton
    clip: Features
    straight: Takes
    turning: Takes
    std: np.ndarray
    circle_seconds: float = 20.0

    def measure(self, predictor: Predictor) -> dict[str, Any]:
        """Returns `straight` and `turning` one-step errors, the `locked` error, and the results of `circle_test`."""
        rows = self.turning.rows
        turning = select_rows(rows, is_turning(rows.y, self.layout))
        num_frames = round(LOCKED_SECONDS * self.layout.fps)
        return {
            "straight": one_step_test(predictor, self.straight, self.layout, self.std),
            "turning": one_step_test(predictor, self.turning, self.layout, self.std),
            "locked": locked_test(predictor, self.turning, self.layout, self.std, num_frames),
            **circle_test(predictor, self.clip, turning, self.layout, self.skeleton, self.circle_seconds),
        }
