"""Root and trajectory windows: exact on straight and circular walks, invariant to where the clip is."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.kinematics import forward_kinematics, quat_rotate
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.trajectory import (
    Root,
    hips_root,
    root_motion,
    sample_offsets,
    trajectory_windows,
)

EXACT = 1e-12  # float64, sums of a few terms of order one
OFFSETS = np.arange(-60, 60, 10)


def straight(frames: int, fps: float, speed: float = 1.4, yaw: float = 0.7) -> Root:
    direction = np.array([np.sin(yaw), np.cos(yaw)])
    path = np.arange(frames)[:, None] * (speed / fps) * direction + [3.0, -2.0]
    return Root(path, np.tile(direction, (frames, 1)))


@pytest.mark.parametrize("fps", [30.0, 60.0, 120.0])
@pytest.mark.parametrize("frames", [2, 40, 200])
def test_windows_of_a_straight_walk_are_exact_up_to_both_ends(fps, frames):
    positions, directions = trajectory_windows(straight(frames, fps), fps)
    expected = 1.4 * OFFSETS / 60
    assert positions.shape == directions.shape == (frames, 12, 2)
    np.testing.assert_allclose(positions[..., 0], 0.0, atol=EXACT)
    np.testing.assert_allclose(positions[..., 1], np.tile(expected, (frames, 1)), atol=EXACT)
    np.testing.assert_allclose(directions, np.broadcast_to([0.0, 1.0], directions.shape), atol=EXACT)


def test_windows_of_a_circle_are_the_same_in_every_frame_away_from_the_ends():
    yaw = np.arange(300) * 0.02
    circle = Root(2.0 * np.stack([-np.cos(yaw), np.sin(yaw)], -1), np.stack([np.sin(yaw), np.cos(yaw)], -1))
    positions, directions = trajectory_windows(circle, 60.0)
    inner = slice(60, 240)
    np.testing.assert_allclose(positions[inner], np.broadcast_to(positions[60], (180, 12, 2)), atol=EXACT)
    angle = np.arctan2(directions[100, :, 0], directions[100, :, 1])
    np.testing.assert_allclose(angle, OFFSETS * 0.02, atol=EXACT)


def test_the_trajectory_of_a_single_frame_stands_still():
    positions, directions = trajectory_windows(straight(1, 60.0), 60.0)
    assert not positions.any()
    np.testing.assert_allclose(directions, np.broadcast_to([0.0, 1.0], (1, 12, 2)), atol=EXACT)


def test_samples_must_fall_on_frames():
    assert (sample_offsets(120.0) == 2 * OFFSETS).all()
    with pytest.raises(ValueError, match="multiple of 6, got 25"):
        sample_offsets(25.0)


def test_root_facing_follows_the_commanded_turns():
    turn = np.full(240, 0.5)
    clip, _ = synthesise("neutral", turn, np.full(240, 1.2))
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root = root_motion(positions, need_roles(clip.skeleton), 60.0)
    lag = 0.1  # radians; hips and shoulders swing about the path's direction
    assert np.abs(wrap_angle(root.yaw - turn.cumsum() / 60))[30:-30].max() < lag
    np.testing.assert_allclose(np.linalg.norm(root.directions, axis=-1), 1.0, atol=EXACT)
    assert (root.positions == positions[:, 0][:, [0, 2]]).all()


def test_smoothing_does_not_depend_on_frame_rate():
    slow, fast = (synthesise("proud", np.zeros(2 * f), np.full(2 * f, 1.2), fps=float(f), seed=1) for f in (60, 120))
    roots = []
    for clip, _ in (slow, fast):
        positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
        roots.append(root_motion(positions, need_roles(clip.skeleton), clip.fps))
    sway = 0.05  # radians; the wobble of the two clips is drawn at different rates
    assert np.abs(wrap_angle(roots[0].yaw - roots[1].yaw[::2])).max() < sway


def test_heading_of_the_hip_joints_agrees_with_the_hips_own_axis(mocap):
    """In 100STYLE files the hips' own +Z points forward, and is what the authors took; other rigs have no such axis."""
    take = next(clip for clip in list_clips(mocap / "100style") if clip.path.stem == "Angry_FW")
    clip = load_clip(take)
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    forward = quat_rotate(rotations[:, 0], [0.0, 0.0, 1.0])
    off = np.degrees(wrap_angle(hips_root(positions, need_roles(clip.skeleton)).yaw - np.arctan2(*forward.T[[0, 2]])))
    assert np.sqrt(np.mean(off**2)) < 0.6 and np.abs(off).max() < 3.0  # degrees: both lean and tilt at once


def test_the_hips_heading_does_not_depend_on_the_shoulders():
    clip, _ = synthesise("proud", np.full(60, 0.3), np.full(60, 1.2), seed=1)
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    roles = need_roles(clip.skeleton)
    root, moved = hips_root(positions, roles), positions.copy()
    moved[:, [roles.left_shoulder, roles.right_shoulder]] += [0.3, 0.0, -0.2]
    assert (hips_root(moved, roles).directions == root.directions).all()
    across = positions[:, roles.left_hip] - positions[:, roles.right_hip]
    np.testing.assert_allclose((root.directions * across[:, [0, 2]]).sum(axis=-1), 0.0, atol=EXACT)
    assert (root.directions[:, 1] > 0).all()  # forward, not backward
