"""Laws of the metrics: zero on perfect motion, known values on known motion, and invariances."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.evaluation import metrics
from pfnn_jax.motion.features.layout import mason2018, pfnn2017
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import STYLES, stance_contacts, synthesise
from pfnn_jax.motion.trajectory import root_motion

EXACT = 1e-12  # float64 rounding of sums of a few hundred terms
FPS = 60.0


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def moving_foot(speed: float, height: float, frames: int = 60) -> np.ndarray:
    time = np.arange(frames) / FPS
    return np.stack([0.6 * speed * time, np.full(frames, height), 0.8 * speed * time], axis=-1)[:, None]


@pytest.mark.parametrize("layout", [mason2018(5), pfnn2017(5)], ids=lambda layout: layout.name)
def test_weighted_mean_of_group_errors_is_the_total_error(layout, rng):
    true, pred = rng.standard_normal((2, 40, layout.output_size))
    std = rng.uniform(0.5, 2.0, layout.output_size)
    errors = metrics.one_step_error(true, pred, layout, std)
    sizes = {
        group: sum(layout.output_width(block) for block in layout.output_blocks if block in blocks)
        for group, blocks in metrics.GROUPS.items()
    }
    assert sum(sizes.values()) == layout.output_size
    whole = sum(errors[group] * size for group, size in sizes.items() if size) / layout.output_size
    assert errors["all"] == pytest.approx(whole, abs=EXACT)
    assert set(metrics.one_step_error(true, true, layout, std).values()) == {0.0}


def test_one_step_error_of_the_mean_is_one(rng):
    layout = mason2018(3)
    true = rng.standard_normal((500, layout.output_size)) * 3 + 1
    mean = np.broadcast_to(true.mean(axis=0), true.shape)
    errors = metrics.one_step_error(true, mean, layout, true.std(axis=0))
    assert all(value == pytest.approx(1.0, abs=EXACT) for value in errors.values())


def test_one_step_error_puts_each_block_in_its_group():
    layout = mason2018(3)
    true = np.zeros((2, layout.output_size))
    pred = true.copy()
    pred[:, layout.output_slice("phase_change")] = 3.0
    errors = metrics.one_step_error(true, pred, layout)
    assert errors["phase_change"] == 9.0
    assert errors["pose"] == errors["velocity"] == errors["root"] == errors["trajectory"] == 0.0


def test_one_step_error_refuses_another_number_of_columns():
    with pytest.raises(ValueError, match="columns of layout mason2018"):
        metrics.one_step_error(np.zeros((2, 3)), np.zeros((2, 3)), mason2018(3))


def test_bone_length_error_is_the_mean_stretch():
    parents, lengths = np.array([-1, 0, 1]), np.array([9.0, 1.0, 2.0])
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [1, 2, 0]])[None].repeat(4, axis=0)
    assert metrics.bone_length_error(positions, parents, lengths) == 0.0
    positions[:, 2, 1] = 2.2
    assert metrics.bone_length_error(positions, parents, lengths) == pytest.approx(0.1, abs=EXACT)
    assert metrics.bone_length_error(positions + 5.0, parents, lengths) == pytest.approx(0.1, abs=EXACT)


@pytest.mark.parametrize(
    ("height", "expected"), [(0.0, 1.0), (-0.01, 1.0), (0.0125, 2 - 2**0.5), (0.025, 0.0), (0.3, 0.0)]
)
def test_skating_weight_falls_with_height(height, expected):
    assert metrics.foot_skating(moving_foot(1.0, height), FPS) == pytest.approx(expected, abs=1e-9)
    raised = moving_foot(1.0, height + 0.085)
    assert metrics.foot_skating(raised, FPS, ground=np.array([0.085])) == pytest.approx(expected, abs=1e-9)


def test_skating_is_independent_of_the_frame_rate_and_zero_for_a_still_foot():
    foot = moving_foot(1.0, 0.0, 61)
    assert metrics.foot_skating(foot[::2], FPS / 2) == pytest.approx(metrics.foot_skating(foot, FPS), abs=EXACT)
    assert metrics.foot_skating(moving_foot(0.0, 0.0), FPS) == 0.0


@pytest.mark.parametrize(("speed", "height", "expected"), [(1.0, 0.0, 1.0), (0.4, 0.0, 0.0), (1.0, 0.06, 0.0)])
def test_skating_ratio_counts_fast_low_frames(speed, height, expected):
    assert metrics.skating_ratio(moving_foot(speed, height), FPS) == expected


def test_skating_ratio_ignores_a_single_fast_frame_and_counts_any_foot():
    still, slide = moving_foot(0.0, 0.0), moving_foot(0.0, 0.0)
    slide[30:, 0, 0] += 0.6 / FPS  # one frame at 0.6 m/s: too short for the average over five
    assert metrics.skating_ratio(slide, FPS) == 0.0
    both = np.concatenate([still, moving_foot(1.0, 0.0)], axis=1)
    assert metrics.skating_ratio(both, FPS) == 1.0


def test_contact_sliding_counts_only_frames_in_contact():
    feet = np.concatenate([moving_foot(0.0, 0.0), moving_foot(1.0, 0.5)], axis=1)
    contacts = np.zeros(feet.shape[:2], bool)
    assert np.isnan(metrics.contact_sliding(feet, contacts, FPS))
    contacts[:, 0] = True
    assert metrics.contact_sliding(feet, contacts, FPS) == 0.0
    contacts[:] = True
    assert metrics.contact_sliding(feet, contacts, FPS) == pytest.approx(0.5, abs=1e-9)


@pytest.mark.parametrize(("height", "expected"), [(0.0, 1.0), (0.0125, 2 - 2**0.5), (-0.0125, 2 - 2**0.5)])
def test_skating_near_the_ground_is_not_lowered_by_feet_in_the_air(height, expected):
    feet = np.concatenate([moving_foot(1.0, height), moving_foot(3.0, 0.2)], axis=1)
    assert metrics.near_ground_skating(feet, FPS) == pytest.approx(expected, abs=1e-9)
    assert metrics.near_ground_skating(feet + [0.0, 0.5, 0.0], FPS, ground=0.5) == pytest.approx(expected, abs=1e-9)
    assert metrics.near_ground_skating(feet + [0.0, 0.5, 0.0], FPS) == 0.0


def test_skating_near_the_ground_counts_vertical_motion_and_leaves_out_weights_of_zero():
    foot = np.zeros((4, 1, 3))
    foot[:, 0, 1] = [0.0, 0.025, 0.0, 0.0]  # steps up to a weight of 0, down to 1, and none
    assert metrics.near_ground_skating(foot, 1.0) == pytest.approx(0.025 / 2, abs=EXACT)


def test_sliding_over_travel_is_one_for_a_toe_that_is_dragged_along_and_zero_for_a_planted_one():
    root = moving_foot(1.3, 0.9)[:, 0]
    assert metrics.sliding_over_travel(moving_foot(1.3, 0.4), root) == pytest.approx(1.0, abs=1e-9)
    assert metrics.sliding_over_travel(moving_foot(0.0, -0.2), root) == 0.0
    both = np.concatenate([moving_foot(0.65, 0.0), moving_foot(5.0, 0.011)], axis=1)  # the second is above 1 cm
    assert metrics.sliding_over_travel(both, root) == pytest.approx(0.5, abs=1e-9)
    assert np.isnan(metrics.sliding_over_travel(both, 0 * root))


def test_jitter_of_a_cubic_is_its_third_derivative():
    time = np.arange(30) / FPS
    positions = np.stack([time**3, 2 * time**2 + 1, 0 * time], axis=-1)[:, None]
    assert metrics.jitter(positions, FPS) == pytest.approx(6.0, rel=1e-6)  # cancellation over 60³
    assert metrics.jitter(positions[..., [1, 1, 2]], FPS) == pytest.approx(0.0, abs=1e-6)


def test_trajectory_error_of_a_shifted_path():
    path = np.stack([np.linspace(0, 10, 101), np.zeros(101)], axis=-1)
    assert metrics.trajectory_error(path, path) == metrics.TrajectoryError(0.0, 0.0, 0.0)
    shifted = path + [0.3, 0.4]
    error = metrics.trajectory_error(shifted, path, limit=0.49)
    assert (error.mean, error.final, error.failed) == pytest.approx((0.5, 0.5, 1.0), abs=EXACT)


def test_path_error_ignores_timing_but_not_distance():
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 5.0]])
    late = np.stack([np.linspace(0, 3, 50), np.zeros(50)], axis=-1)
    assert metrics.path_error(late, path).mean == pytest.approx(0.0, abs=EXACT)
    error = metrics.path_error(np.array([[2.0, 1.0], [10.0, 2.0], [13.0, 9.0]]), path)
    assert (error.mean, error.final, error.failed) == pytest.approx((2.0, 5.0, 2 / 3), abs=EXACT)


def slow_npss(true: np.ndarray, pred: np.ndarray) -> float:
    """Returns NPSS by its definition, with loops and an explicit discrete Fourier transform."""
    sequences, frames, features = true.shape

    def spectrum(signal):
        angles = -2j * np.pi * np.outer(np.arange(frames), np.arange(frames)) / frames
        return np.abs(np.exp(angles) @ signal) ** 2

    numerator = denominator = 0.0
    for n in range(sequences):
        for d in range(features):
            p, q = spectrum(true[n, :, d]), spectrum(pred[n, :, d])
            distance = moved = 0.0
            for a, b in zip(p / p.sum(), q / q.sum(), strict=True):
                moved += a - b
                distance += abs(moved)
            numerator += p.sum() * distance
            denominator += p.sum()
    return numerator / denominator


def test_npss_equals_the_slow_definition(rng):
    true, pred = rng.standard_normal((2, 3, 32, 4)) * [1.0, 2.0, 0.1, 5.0]
    assert metrics.npss(true, pred) == pytest.approx(
        slow_npss(true, pred), rel=1e-9
    )  # FFT against an explicit transform


def test_npss_is_zero_for_shifted_and_scaled_motion_and_ignores_constant_zero_features(rng):
    true = rng.standard_normal((2, 40, 3))
    true[..., 2] = 0.0
    assert metrics.npss(true, true) == 0.0
    assert metrics.npss(true, 3.0 * np.roll(true, 7, axis=1)) == pytest.approx(0.0, abs=EXACT)
    assert metrics.npss(np.zeros((1, 8, 2)), true[:1, :8, :2]) == 0.0


def test_npss_is_proportional_to_the_difference_of_frequency():
    time = np.arange(64) / 64
    waves = {k: np.sin(2 * np.pi * k * time)[None, :, None] for k in (4, 5, 8)}
    assert metrics.npss(waves[4], waves[8]) == pytest.approx(4 * metrics.npss(waves[4], waves[5]), rel=1e-9)


@pytest.mark.parametrize("rate", [-90.0, 0.0, 45.0, 200.0])
def test_turn_rate_of_a_circle_is_exact(rate):
    yaw = np.deg2rad(rate) * np.arange(300) / FPS
    wrapped = np.arctan2(np.sin(yaw), np.cos(yaw))
    assert metrics.achieved_turn_rate(wrapped, FPS) == pytest.approx(rate, abs=1e-9)


def test_nearest_pose_distance_is_a_root_mean_square_over_joints(rng, monkeypatch):
    real = rng.standard_normal((70, 6, 3))
    assert np.all(metrics.nearest_pose_distance(real[::-1], real) == 0.0)
    near = real[[5, 60, 2]] + np.array([0.03, 0.0, 0.04])
    assert metrics.nearest_pose_distance(near, real) == pytest.approx(np.full(3, 0.05), abs=EXACT)
    poses = rng.standard_normal((50, 6, 3))
    whole = np.linalg.norm(poses[:, None] - real, axis=-1)
    expected = np.sqrt((whole**2).mean(axis=-1)).min(axis=-1)
    assert metrics.nearest_pose_distance(poses, real) == pytest.approx(expected, abs=EXACT)


def test_nearest_pose_distance_does_not_depend_on_the_chunk_size(rng, monkeypatch):
    poses, real = rng.standard_normal((31, 4, 3)), rng.standard_normal((17, 4, 3))
    whole = metrics.nearest_pose_distance(poses, real)
    small = metrics._chunks
    monkeypatch.setattr(metrics, "_chunks", lambda rows, width: small(rows, width, 40))
    np.testing.assert_array_equal(metrics.nearest_pose_distance(poses, real), whole)


def test_resting_heights_are_the_heights_in_stance():
    feet = np.concatenate([moving_foot(0.0, 0.02), moving_foot(0.0, 0.09)], axis=1)
    feet[40:, :, 1] += 0.2
    np.testing.assert_allclose(metrics.planted_heights(feet), [0.02, 0.09], atol=EXACT)


def test_procedural_walks_have_no_sliding_constant_bones_and_the_commanded_turn_rate():
    clip, labels = synthesise("strutting", np.full(600, np.deg2rad(40.0)), np.full(600, 1.1))
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    roles = need_roles(clip.skeleton)
    feet = positions[:, [*roles.left_foot, *roles.right_foot]]
    contacts = stance_contacts(STYLES["strutting"], labels.phase)
    assert metrics.contact_sliding(feet, contacts, FPS) < 1e-10  # rounding of metres, times 60
    lengths = np.linalg.norm(clip.skeleton.offsets, axis=-1)
    assert metrics.bone_length_error(positions, clip.skeleton.parents, lengths) < EXACT
    root = root_motion(positions, roles, FPS)
    assert metrics.achieved_turn_rate(root.yaw, FPS) == pytest.approx(40.0, abs=2.0)  # hips and shoulders twist
    slid = feet.copy()
    slid[..., 2] += np.arange(600)[:, None] / FPS
    assert metrics.contact_sliding(slid, contacts, FPS) == pytest.approx(1.0, abs=1e-9)
