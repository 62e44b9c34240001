"""Tests of learned styles: takes, turning frames, and the pose-and-velocity error."""

from __future__ import annotations

import numpy as np

from pfnn_jax.evaluation.style_test import is_turning, join_takes, pose_and_velocity_error
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.synthetic.walks import synthesise

LAYOUT = mason2018(21)


def rows(degrees_per_second: float, frames: int = 240):
    clip, labels = synthesise("neutral", np.full(frames, np.deg2rad(degrees_per_second)), np.full(frames, 1.2))
    return clip_features(clip, LAYOUT, labels)


def test_joined_takes_keep_their_rows_and_names():
    parts = [rows(0.0), rows(30.0, 120)]
    takes = join_takes(parts, ["straight", "turn"])
    np.testing.assert_array_equal(takes.rows.x, np.concatenate([part.x for part in parts]))
    np.testing.assert_array_equal(np.bincount(takes.take), [len(part.x) for part in parts])
    assert takes.names == ("straight", "turn")


def test_frames_that_turn_faster_than_the_rate_to_either_side_are_turning():
    assert not is_turning(rows(0.0).y, LAYOUT, 20.0).any()
    assert is_turning(rows(40.0).y, LAYOUT, 20.0).mean() > 0.9
    assert is_turning(rows(-40.0).y, LAYOUT, 20.0).mean() > 0.9


def test_error_covers_only_positions_and_velocities_in_units_of_std():
    y = rows(0.0).y
    std = np.full(LAYOUT.output_size, 0.5)
    assert pose_and_velocity_error(y, y, LAYOUT, std).max() == 0.0
    moved = y.copy()
    moved[:, LAYOUT.output_slice("joint_position")] += 0.5
    moved[:, LAYOUT.output_slice("joint_velocity")] += 0.5
    moved[:, LAYOUT.output_slice("phase_change")] += 100.0
    # float32 rows of magnitude one have a relative rounding error of 1e-7
    np.testing.assert_allclose(pose_and_velocity_error(y, moved, LAYOUT, std), 1.0, rtol=1e-5)
