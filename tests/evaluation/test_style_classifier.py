"""The style classifier: invariances of its windows, its accuracy, and laws of the Fréchet distance."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.evaluation.motion_windows import WINDOW_FRAMES, clip_windows, motion_windows
from pfnn_jax.evaluation.style_classifier import (
    ClassifierConfig,
    confusion_matrix,
    features,
    frechet_distance,
    gaussian_frechet,
    recognition_accuracy,
    scores,
    shrunk_covariance,
    train_classifier,
)
from pfnn_jax.motion.clip import mirror_clip, resample
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import synthetic_clips

FLOAT32 = 1e-5  # windows are stored in single precision, metres and metres per second below 10
ROUNDING = 1e-9  # of sums over a few hundred products in double precision
SAMPLING = 0.1  # of a distance near 3, from 20,000 samples of each side
TAKES = 0.9  # share recognised of windows of real takes that were not trained on; 0.99 was measured on all of them
RESAMPLED = 0.02  # metres and metres per second: joints lie on arcs, and a linear step cuts their corners


@pytest.fixture(scope="module")
def clip():
    return synthetic_clips("neutral", 4.0, clip_seconds=4.0)[0].clip


def moved(clip, yaw: float, x: float, z: float):
    """Returns the clip moved on the ground and rotated about the vertical."""
    turn = quat_from_yaw(np.array(yaw))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    return replace(clip, root_positions=quat_rotate(turn, clip.root_positions) + [x, 0, z], rotations=rotations)


@given(st.floats(-3, 3), st.floats(-50, 50), st.floats(-50, 50))
def test_windows_are_invariant_to_position_and_heading(clip, yaw, x, z):
    np.testing.assert_allclose(clip_windows(moved(clip, yaw, x, z)), clip_windows(clip), atol=FLOAT32)


def test_windows_are_one_second_of_positions_and_velocities(clip):
    windows, joints = clip_windows(clip), clip.skeleton.num_joints
    assert windows.shape == (6, WINDOW_FRAMES, 6 * joints) and windows.dtype == np.float32
    positions, velocities = windows[..., : 3 * joints], windows[..., 3 * joints :]
    assert np.abs(positions[:, :, [0, 2]]).max() < FLOAT32  # the hips are above the root
    assert 0.5 < velocities[:, :, 2].mean() < 2.0  # and move forwards


def test_windows_of_the_mirror_image_are_appended(clip):
    both = clip_windows(clip, mirror=True)
    np.testing.assert_array_equal(both[: len(both) // 2], clip_windows(clip))
    np.testing.assert_array_equal(both[len(both) // 2 :], clip_windows(mirror_clip(clip)))


def test_motion_shorter_than_a_window_has_no_windows(clip):
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    assert len(motion_windows(positions[:WINDOW_FRAMES], need_roles(clip.skeleton), clip.fps)) == 0
    assert len(motion_windows(positions[: WINDOW_FRAMES + 1], need_roles(clip.skeleton), clip.fps)) == 1


def test_windows_do_not_depend_on_the_frame_rate(clip):
    slow = clip_windows(resample(clip, 30.0))
    own = clip_windows(clip)[: len(slow)]
    joints = 3 * clip.skeleton.num_joints
    np.testing.assert_allclose(slow[..., :joints], own[..., :joints], atol=RESAMPLED)


def random_windows(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Returns windows of 3 'styles' that differ in the frequency of one column, at random phases."""
    rng = np.random.default_rng(seed)
    labels = rng.integers(0, 3, count)
    angles = np.arange(20) * np.array([0.3, 0.8, 1.5])[labels][:, None] + rng.uniform(0, 6.3, (count, 1))
    windows = rng.normal(size=(count, 20, 4)).astype(np.float32)
    windows[:, :, 0] += 3 * np.sin(angles)
    return windows, labels


@pytest.fixture(scope="module")
def learned():
    windows, labels = random_windows(600)
    config = ClassifierConfig(filters=16, features=16, epochs=20, batch_size=32, learning_rate=3e-3, dropout=0.0)
    return train_classifier(windows, labels, 3, config)


def test_classifier_learns_frequencies_and_its_confusion_matrix_agrees_with_its_accuracy(learned):
    windows, labels = random_windows(300, seed=1)
    assert recognition_accuracy(learned, windows, labels) > 0.9
    table = confusion_matrix(learned, windows, labels)
    np.testing.assert_array_equal(table.sum(axis=1), np.bincount(labels))
    assert np.trace(table) / len(labels) == recognition_accuracy(learned, windows, labels)


def test_training_is_deterministic_given_the_seed():
    windows, labels = random_windows(40)
    config = ClassifierConfig(filters=4, features=4, epochs=1)
    one, two = (train_classifier(windows, labels, 3, config) for _ in range(2))
    jax.tree.map(np.testing.assert_array_equal, one, two)


def test_features_do_not_depend_on_the_chunk_size(learned, monkeypatch):
    windows, _ = random_windows(7)
    whole = features(learned, windows)
    monkeypatch.setattr("pfnn_jax.evaluation.style_classifier.CHUNK", 3)
    np.testing.assert_allclose(
        features(learned, windows), whole, rtol=1e-4, atol=1e-4
    )  # XLA chooses other algorithms by size
    assert scores(learned, windows).shape == (7, 3)


def test_style_without_windows_does_not_break_training():
    windows, labels = random_windows(30)
    found = train_classifier(windows, labels, 5, ClassifierConfig(filters=2, features=2, epochs=1))
    assert scores(found, windows).shape == (30, 5) and np.isfinite(scores(found, windows)).all()


@pytest.mark.parametrize(
    ("windows", "labels", "styles"),
    [(np.zeros((2, 3)), [0, 0], None), (np.zeros((2, 3, 4)), [0], None), (np.zeros((1, 3, 4)), [2], 2)],
)
def test_mismatched_windows_and_labels_are_refused(windows, labels, styles):
    with pytest.raises(ValueError, match="`(windows|labels)` must"):
        train_classifier(windows, np.array(labels), styles)


def test_bad_sizes_are_refused_by_field():
    with pytest.raises(ValueError, match="ClassifierConfig.filters"):
        ClassifierConfig(filters=0)
    with pytest.raises(ValueError, match="ClassifierConfig.dropout"):
        ClassifierConfig(dropout=1.0)


def gaussians(seed: int, size: int = 5):
    rng = np.random.default_rng(seed)
    means, factors = rng.normal(size=(2, size)), rng.normal(size=(2, size, size))
    return [(mean, factor @ factor.T) for mean, factor in zip(means, factors, strict=True)]


@given(st.integers(0, 10_000))
def test_gaussian_frechet_equals_the_closed_form_and_is_symmetric(seed):
    (mean_a, cov_a), (mean_b, cov_b) = gaussians(seed)
    root = np.real(np.asarray(scipy.linalg.sqrtm(cov_a @ cov_b)))
    expected = ((mean_a - mean_b) ** 2).sum() + np.trace(cov_a + cov_b - 2 * root)
    found = gaussian_frechet(mean_a, cov_a, mean_b, cov_b)
    np.testing.assert_allclose(found, expected, rtol=1e-5)  # sqrtm loses half of the digits near singular products
    np.testing.assert_allclose(gaussian_frechet(mean_b, cov_b, mean_a, cov_a), found, rtol=1e-6)


def test_frechet_distance_in_one_dimension_adds_squared_differences_of_mean_and_std():
    found = gaussian_frechet(np.zeros(1), np.array([[4.0]]), np.array([3.0]), np.array([[1.0]]))
    np.testing.assert_allclose(found, 3.0**2 + (2.0 - 1.0) ** 2, rtol=ROUNDING)


def test_frechet_distance_is_zero_to_itself_and_symmetric():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(40, 6)), rng.normal(size=(25, 6)) + 1
    assert frechet_distance(a, a) < ROUNDING
    np.testing.assert_allclose(frechet_distance(a, b), frechet_distance(b, a), rtol=ROUNDING)


def test_frechet_distance_converges_to_the_distance_of_the_gaussians():
    (mean_a, cov_a), (mean_b, cov_b) = gaussians(3, size=3)
    rng = np.random.default_rng(0)
    a, b = rng.multivariate_normal(mean_a, cov_a, 20_000), rng.multivariate_normal(mean_b, cov_b, 20_000)
    assert abs(frechet_distance(a, b) - gaussian_frechet(mean_a, cov_a, mean_b, cov_b)) < SAMPLING


def test_shrunk_covariance_is_regular_for_few_samples_and_unbiased_for_many():
    rng = np.random.default_rng(0)
    few, many = rng.normal(size=(4, 10)), rng.normal(size=(50_000, 10)) * np.arange(1, 11)
    assert np.linalg.eigvalsh(shrunk_covariance(few)).min() > 1e-3
    np.testing.assert_allclose(np.trace(shrunk_covariance(few)), few.var(axis=0).sum(), rtol=ROUNDING)
    np.testing.assert_allclose(shrunk_covariance(many), np.cov(many.T, bias=True), atol=0.01 * 100)
    assert frechet_distance(np.ones((1, 3)), np.ones((5, 3))) == 0.0


def test_real_styles_are_recognised_on_held_out_takes(mocap):
    styles, train, test = ("elderly", "feminine"), [], []
    files = list_clips(mocap / "bandai-namco-2")
    for label, style in enumerate(styles):
        own = [file for file in files if file.style == style and file.content == "walk"][:4]
        for number, file in enumerate(own):
            windows = clip_windows(load_clip(file), mirror=True)
            (test if number % 4 == 3 else train).append((windows, np.full(len(windows), label)))
    windows, labels = (np.concatenate(parts) for parts in zip(*train, strict=True))
    classifier = train_classifier(windows, labels, 2, ClassifierConfig(filters=8, epochs=8))
    unseen, truth = (np.concatenate(parts) for parts in zip(*test, strict=True))
    assert recognition_accuracy(classifier, unseen, truth) > TAKES
