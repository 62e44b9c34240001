"""Laws of the metrics of style transfer: zero on equal clips, known values on constructed ones, and invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.evaluation.transfer_metrics import (
    content_consistency,
    dynamic_time_warping,
    facing_poses,
    frame_distances,
    pose_distance,
    style_consistency,
    trajectory_distance,
)
from pfnn_jax.motion.body_points import POINT_NAMES
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.motion.world_motion import world_motion

EXACT = 1e-12  # float64 rounding of sums of a few hundred terms
FACING = 1e-9  # metres: positions some metres from the origin, turned


@pytest.fixture(scope="module")
def walk():
    return synthetic_clips("neutral", 2.0, clip_seconds=2.0)[0].clip


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def literal_warping(distances: np.ndarray) -> float:
    """The recursion of Sakoe and Chiba, cell by cell."""
    least = np.full(distances.shape, np.inf)
    for i, j in np.ndindex(*distances.shape):
        before = [2 * distances[0, 0]] if i == j == 0 else []
        before += [least[i - 1, j] + distances[i, j]] if i else []
        before += [least[i, j - 1] + distances[i, j]] if j else []
        before += [least[i - 1, j - 1] + 2 * distances[i, j]] if i and j else []
        least[i, j] = min(before)
    return least[-1, -1] / sum(distances.shape)


@given(st.floats(-3, 3), st.floats(-50, 50), st.floats(-50, 50))
def test_poses_are_invariant_to_position_and_heading(walk, yaw, x, z):
    turn = quat_from_yaw(np.array(yaw))
    rotations = walk.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    moved = replace(walk, root_positions=quat_rotate(turn, walk.root_positions) + [x, 0, z], rotations=rotations)
    np.testing.assert_allclose(facing_poses(world_motion(moved)), facing_poses(world_motion(walk)), atol=FACING)


def test_a_jump_of_the_whole_body_is_no_part_of_its_poses(walk):
    raised = walk.root_positions + np.array([0.0, 1.0, 0.0]) * np.linspace(0, 1, walk.num_frames)[:, None]
    jumping = facing_poses(world_motion(replace(walk, root_positions=raised)))
    poses = facing_poses(world_motion(walk))
    np.testing.assert_allclose(jumping, poses, atol=FACING)
    assert poses.shape == (walk.num_frames, len(POINT_NAMES), 3)
    np.testing.assert_allclose(poses[:, 0, [0, 2]], 0.0, atol=FACING)  # the hips
    np.testing.assert_allclose(np.ptp(poses[:, 0, 1]), 0.0, atol=FACING)


def test_distance_of_poses_is_the_mean_over_points_and_common_frames(rng):
    poses = rng.standard_normal((9, 21, 3))
    shifted = poses + [0.03, 0.0, 0.04]
    assert content_consistency(poses, poses) == 0.0
    assert content_consistency(shifted[:5], poses) == pytest.approx(0.05, abs=EXACT)
    shifted[:, 1:] = poses[:, 1:]
    assert pose_distance(poses, shifted) == pytest.approx(0.05 / 21, abs=EXACT)


def test_style_consistency_is_the_mean_over_ground_truths(rng):
    poses = rng.standard_normal((9, 21, 3))
    truths = [poses, poses + [0.1, 0.0, 0.0], poses[:4] + [0.0, 0.2, 0.0]]
    assert style_consistency(poses, truths) == pytest.approx(0.1, abs=EXACT)


def test_warping_forgives_a_change_of_timing_and_cutting_does_not(rng):
    poses = rng.standard_normal((20, 21, 3))
    slow = poses[np.sort(np.r_[0:20, 3, 3, 7, 12, 12, 19])]
    assert pose_distance(poses, slow, warp=True) == 0.0
    assert pose_distance(poses, slow) > 0.5


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (7, 1), (8, 8), (5, 11), (13, 4)])
def test_warping_is_the_recursion_of_sakoe_and_chiba(shape, rng):
    distances = rng.uniform(0.0, 1.0, shape)
    cost, path = dynamic_time_warping(distances)
    assert cost == pytest.approx(literal_warping(distances), abs=EXACT)
    assert cost == pytest.approx(dynamic_time_warping(distances.T)[0], abs=EXACT)
    steps = np.diff(path, axis=0)
    assert tuple(path[0]) == (0, 0) and tuple(path[-1]) == (shape[0] - 1, shape[1] - 1)
    assert ((steps >= 0) & (steps <= 1)).all() and (steps.sum(axis=1) >= 1).all()
    weights = np.concatenate([[2], steps.sum(axis=1)])
    assert weights.sum() == sum(shape)
    assert cost == pytest.approx((weights * distances[tuple(path.T)]).sum() / sum(shape), abs=EXACT)


def test_warping_costs_at_most_the_distance_frame_by_frame(rng):
    for _ in range(5):
        a, b = rng.standard_normal((2, 30, 21, 3))
        assert pose_distance(a, b, warp=True) <= pose_distance(a, b) + EXACT
        np.testing.assert_allclose(np.diag(frame_distances(a, b)).mean(), pose_distance(a, b), atol=EXACT)


def test_trajectory_distance_ignores_the_start_and_with_fitted_speed_the_scale():
    time = np.linspace(0, 1, 50)
    path = np.stack([time, time**2], axis=-1)
    assert trajectory_distance(path + 7.0, path[:40]) == pytest.approx(0.0, abs=EXACT)
    assert trajectory_distance(path + [[0.0, 0.0]] + np.outer(time, [0.0, 0.2]), path) == pytest.approx(0.1, abs=EXACT)
    assert trajectory_distance(1.7 * path, path) == pytest.approx(0.7 * np.linalg.norm(path, axis=1).mean(), abs=EXACT)
    assert trajectory_distance(1.7 * path, path, fit_speed=True) == pytest.approx(0.0, abs=EXACT)
    apart = trajectory_distance(-path, path, fit_speed=True)
    assert apart == pytest.approx(np.linalg.norm(path, axis=1).mean(), abs=EXACT)  # no speed makes it the other way
    assert trajectory_distance(0 * path, path, fit_speed=True) == pytest.approx(apart, abs=EXACT)
