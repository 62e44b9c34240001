"""Features: golden frames of the authors' pipeline, laws of invariance and symmetry, and the way back to a clip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.features import Features, clip_features
from pfnn_jax.motion.gait import flat_crouch, read_gait
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.layout import pfnn2017
from pfnn_jax.motion.phase import PhaseLabels, read_phase, resample_phase

GOLDEN = 1e-3  # standard deviations: the golden file's own rounding is float32
GOLDEN_UNIT = 0.05644  # metres per file unit: the golden frames were made with 5.644 cm, four digits of CMU's scale
MASKED = 1e6  # inputs that the authors switched off have deviations far above this
STEM = "LocomotionFlat04_000"


@pytest.fixture(scope="module")
def flat(mocap: Path) -> tuple[MotionClip, PhaseLabels]:
    """The flat clip and its hand-made labels at 60 fps."""
    clip = read_bvh(mocap / "pfnn" / f"{STEM}.bvh", unit=GOLDEN_UNIT)
    labels = read_phase(mocap / "pfnn" / f"{STEM}.phase", clip.num_frames)
    clip = resample(clip, 60.0)
    return clip, resample_phase(labels, 120.0, 60.0, clip.num_frames)


@pytest.fixture(scope="module")
def golden_frames(flat) -> np.ndarray:
    """Frames of the golden file: every fifth from 60 on, of those whose phase is not exactly 0."""
    _, labels = flat
    return np.flatnonzero(labels.phase[60:] > 0)[::5][:200] + 60


@pytest.fixture(scope="module")
def golden_rows(flat, golden_frames, mocap) -> Features:
    clip, labels = flat
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    gait = read_gait(mocap / "pfnn" / f"{STEM}.gait")[::2]
    gait = flat_crouch(gait, positions[:, clip.skeleton.roles.head, 1])
    features = clip_features(clip, pfnn2017(), labels, gait)
    rows = np.searchsorted(features.frames, golden_frames)
    assert (features.frames[rows] == golden_frames).all()
    return Features(features.x[rows], features.y[rows], features.phase[rows], golden_frames)


def test_inputs_equal_the_golden_frames(golden_rows, reference):
    golden = np.load(reference / f"pfnn_real_{STEM}.npz")
    std = np.fromfile(reference / "pfnn" / "Xstd.bin", "<f4").astype(np.float64)
    used = std < MASKED
    assert used.sum() == 342 - 72
    off = np.abs(golden_rows.x - golden["x"])[:, used] / std[used]
    assert off.max() < GOLDEN
    np.testing.assert_allclose(golden_rows.phase, golden["phase"], atol=1e-6)


def test_outputs_equal_the_golden_frames_up_to_quaternion_sign(golden_rows, reference):
    golden = np.load(reference / f"pfnn_real_{STEM}.npz")["y_true"]
    mean, std = (np.fromfile(reference / "pfnn" / f"Y{n}.bin", "<f4").astype(np.float64) for n in ("mean", "std"))
    layout = pfnn2017()
    block = layout.output_slice("joint_rotation")
    y = golden_rows.y.astype(np.float64)
    y[:, block] = _nearest_pole(y[:, block], mean[block])
    assert (np.abs(y - golden) / std).max() < GOLDEN


def _nearest_pole(logs: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """The logarithm of q or of -q, whichever lies nearer to the mean: the golden file's choice."""
    logs = logs.reshape(len(logs), -1, 3)
    half = np.linalg.norm(logs, axis=-1, keepdims=True)
    other = logs * (half - np.pi) / np.maximum(half, 1e-12)
    centre = mean.reshape(-1, 3)
    nearer = np.linalg.norm(logs - centre, axis=-1) <= np.linalg.norm(other - centre, axis=-1)
    return np.where(nearer[..., None], logs, other).reshape(len(logs), -1)
