"""Measures of drives made by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.evaluation.drive_preset import DrivePreset, preset_commands
from pfnn_jax.evaluation.drive_test import Drive, measure_drive
from pfnn_jax.motion.ground import facing_of

FPS = 60.0
LINES = 150
SPEED = 1.2  # m/s
ROUNDING = 1e-4  # positions of several metres in single precision


def drive_along(yaw: float, slides: bool, side: float = 0.0) -> tuple[Drive, DrivePreset]:
    """Returns a straight drive and its preset.

    Args:
        yaw: degrees, commanded.
        slides: whether the toes slide with the body, or stay in place.
        side: degrees to the left of the command at which the character goes.
    """
    preset = DrivePreset(np.tile(facing_of(np.deg2rad(yaw)), (LINES, 1)), np.tile([0.0, 1.0], (LINES, 1)))
    frames = len(preset_commands(preset, FPS)[0])
    step = SPEED / FPS * facing_of(np.deg2rad(yaw + side))
    hips = np.insert(np.arange(frames)[:, None] * step, 1, 0.9, axis=1)
    toes = np.stack([hips, hips], axis=1) * [1.0, 0.0, 1.0] * float(slides) + [0.0, 0.05, 0.0]
    facing, contacts = np.tile([0.0, 1.0], (frames, 1)), np.ones((frames, 2))
    free = toes + np.arange(frames)[:, None, None] * [0.0, 0.0, 0.001]
    return Drive(
        hips=hips, toes=toes, free_toes=free, contacts=contacts, facing=facing, time_scale=np.ones(frames)
    ), preset


def measured(*args, free: bool = False, **kwargs) -> dict[str, float]:
    return measure_drive(*drive_along(*args, **kwargs), SPEED, FPS, free)


def test_feet_that_stay_do_not_slide_and_feet_that_go_with_the_body_slide_as_far():
    stays, slides = measured(0.0, False), measured(0.0, True)
    assert stays["sliding"] == stays["contact sliding"] == 0.0
    assert slides["sliding"] == pytest.approx(1.0) and slides["contact sliding"] == pytest.approx(1.0)
    assert stays["counted"] == slides["counted"] == 1.0


def test_free_toes_are_those_before_the_lock():
    assert measured(0.0, False, free=True)["contact sliding"] == pytest.approx(0.001 * FPS / SPEED)


@pytest.mark.parametrize(
    ("yaw", "part"), [(0.0, "ahead"), (90.0, "sideways"), (-90.0, "sideways"), (180.0, "backward")]
)
def test_settled_errors_are_given_by_the_angle_between_heading_and_facing(yaw, part):
    found = measured(yaw, False, side=20.0)
    assert found[part] == found["settled"] == pytest.approx(20.0, abs=ROUNDING)
    assert all(np.isnan(found[other]) for other in ("ahead", "sideways", "backward") if other != part)
    assert found[f"facing {part}"] == 0.0


def test_speed_is_relative_to_the_commanded_one():
    assert measured(0.0, False)["speed"] == pytest.approx(1.0)


def test_turning_the_world_changes_the_published_error_only():
    """A character that sways where the published angles are cut."""
    driven, preset = drive_along(90.0, False)
    hips = np.asarray(driven.hips) + 0.002 * np.sin(np.arange(len(driven.hips)))[:, None] * [0.0, 0.0, 1.0]
    found = measure_drive(replace(driven, hips=hips), preset, SPEED, FPS)
    assert found["published error"] > 90.0 and found["turned"] < 1.0
    assert found["error"] < 10.0
