"""Angles between headings, by CAMDM's formula and by ours, of walks made by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.evaluation.heading_metrics import (
    find_lag,
    heading_errors,
    mean_of_numbers,
    published_trajectory_error,
    seconds_since_change,
)
from pfnn_jax.motion.ground import facing_of

FRAMES = 120
ROUNDING = 1e-6  # degrees


def walk(yaw: np.ndarray) -> np.ndarray:
    """Returns positions [T, 2] of a walk whose step after frame t has the yaw [T] in degrees."""
    steps = facing_of(np.deg2rad(yaw))
    return np.cumsum(np.concatenate([np.zeros((1, 2)), steps[:-1]]), axis=0)


def both(wanted: np.ndarray, walked: np.ndarray) -> tuple[float, float]:
    """Returns CAMDM's error and the mean of ours, of yaws [T] in degrees."""
    commanded, root = facing_of(np.deg2rad(wanted)), walk(walked)
    return published_trajectory_error(commanded, root), mean_of_numbers(heading_errors(commanded, root))


AHEAD = np.zeros(FRAMES)
LEFT_AND_RIGHT = np.where(np.arange(FRAMES) < (FRAMES - 1) / 2, 30.0, -30.0)


def test_walk_that_follows_exactly_has_no_error():
    assert both(AHEAD, AHEAD) == pytest.approx((0.0, 0.0), abs=ROUNDING)


@pytest.mark.parametrize("side", [90.0, -90.0])
def test_walk_to_the_side_is_90_degrees_off(side):
    assert both(AHEAD, AHEAD + side) == pytest.approx((90.0, 90.0), abs=ROUNDING)


def test_left_and_right_cancel_by_the_published_formula_only():
    commanded, root = facing_of(AHEAD), walk(LEFT_AND_RIGHT)
    # of an odd number of steps one is left over
    assert published_trajectory_error(commanded, root) < 30.0 / (FRAMES - 1) + ROUNDING
    np.testing.assert_allclose(heading_errors(commanded, root), 30.0)


def test_sway_at_the_cut_counts_as_half_a_turn_by_the_published_formula_only():
    sway = np.where(np.arange(FRAMES) % 2 == 0, 1.0, -1.0)
    published, ours = both(AHEAD + 90.0, AHEAD + 90.0 + sway)
    assert published == pytest.approx(180.0, abs=360.0 / FRAMES) and ours == pytest.approx(1.0)
    published, ours = both(AHEAD, AHEAD + sway)
    assert published < 1.0 and ours == pytest.approx(1.0)


def test_no_error_is_larger_than_half_a_turn():
    assert both(AHEAD + 170.0, AHEAD - 170.0)[1] == pytest.approx(20.0)


def test_command_to_stand_has_no_heading():
    commanded = facing_of(AHEAD) * (np.arange(FRAMES) < 60)[:, None]
    errors = heading_errors(commanded, walk(AHEAD))
    assert np.isnan(errors[60:]).all() and not np.isnan(errors[:60]).any()
    # the published formula takes it for a command to walk along -X
    assert published_trajectory_error(0.0 * commanded, walk(AHEAD - 90.0)) == pytest.approx(0.0, abs=ROUNDING)


def test_lag_is_found_and_removed():
    wanted = 90.0 * (np.arange(FRAMES) // 30)
    commanded, root = facing_of(np.deg2rad(wanted)), walk(np.roll(wanted, 7))
    assert find_lag(commanded, root, 60) == 7
    assert mean_of_numbers(heading_errors(commanded, root, 7)) == pytest.approx(0.0, abs=ROUNDING)
    assert np.isnan(heading_errors(commanded, root, 7)[-7:]).all()


def test_walk_without_commands_has_no_lag():
    assert find_lag(np.zeros((FRAMES, 2)), walk(AHEAD), 60) == 0


def test_time_since_a_change_starts_again_with_every_heading():
    yaw = np.deg2rad([0.0, 0.0, 0.5, 90.0, 90.0, 90.0, 90.0, 90.0])
    commanded = facing_of(yaw) * np.array([1, 1, 1, 1, 1, 0, 1, 1])[:, None]
    expected = [0.0, 0.1, 0.2, 0.0, 0.1, np.nan, 0.0, 0.1]
    np.testing.assert_allclose(seconds_since_change(commanded, 10.0), expected)
