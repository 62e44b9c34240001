"""Recorded presets: what is read, what is refused, and which commands they become."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.evaluation.drive_preset import PRESET_FPS, DrivePreset, preset_commands, read_preset
from pfnn_jax.evaluation.heading_metrics import angle_errors, mean_of_numbers
from tests.raising import assert_refused

GOOD = "-1, 0, 0, 0, 0, 1"
ROUNDING = 1e-6


@pytest.fixture
def written(tmp_path):
    def write(*lines: str):
        (tmp_path / "preset.txt").write_text("\n".join(lines) + "\n")
        return tmp_path / "preset.txt"

    return write


def test_right_of_unity_is_right_here(written):
    preset = read_preset(written("1, 0, 0, 0, 0, 1", "0, 0, 1, 0.6, 0, 0.8"))
    np.testing.assert_allclose(preset.stick, [[-1, 0], [0, 1]])
    np.testing.assert_allclose(preset.facing, [[0, 1], [-0.6, 0.8]])


def test_facings_become_unit_vectors(written):
    np.testing.assert_allclose(read_preset(written("0, 0, 0, 0, 0, 3")).facing, [[0, 1]])


@pytest.mark.parametrize(
    ("line", "value", "rule"),
    [
        ("1, 0, 0, 0, 1", "5 values", "6"),
        ("1 0 0 0 0 1", "1 values", "commas"),
        ("1, 0, 0, 0, 0, 1, 0", "7 values", "6"),
        ("1, 0, left, 0, 0, 1", "left", "number"),
        ("1, 0, nan, 0, 0, 1", "nan", "number"),
        ("1, 0, inf, 0, 0, 1", "inf", "number"),
        ("1, 0, , 0, 0, 1", "", "number"),
        ("0, 0, -1.5, 0, 0, 1", "-1.5", "[-1, 1]"),
        ("1, 0, 0, 0, 1, 0", "facing 0, 0", "direction"),
        ("", "1 values", "6"),
    ],
)
def test_first_bad_line_is_named(written, line, value, rule):
    path = written(GOOD, line, GOOD)
    assert_refused(lambda: read_preset(path), file="preset.txt", place="line 2", value=value, rule_mentions=rule)


def test_file_without_lines_and_missing_file_are_refused(written, tmp_path):
    path = written("", " ")
    assert_refused(lambda: read_preset(path), place="lines", value=0)
    assert_refused(lambda: read_preset(tmp_path / "absent.txt"), file="absent.txt", place="file")


def test_every_line_holds_until_the_next():
    preset = DrivePreset(np.eye(2), np.eye(2)[::-1])
    velocity, direction = preset_commands(preset, 2 * PRESET_FPS)
    np.testing.assert_array_equal(velocity, np.eye(2)[[0, 0, 1, 1]])
    np.testing.assert_array_equal(direction, np.eye(2)[[1, 1, 0, 0]])
    assert len(preset_commands(preset, PRESET_FPS)[0]) == 2


def test_corner_of_the_stick_is_no_faster_and_half_a_stick_is_half_as_fast():
    preset = DrivePreset(np.array([[1.0, 1.0], [0.0, 0.5], [0.0, 0.0]]), np.tile([0.0, 1.0], (3, 1)))
    speeds = np.linalg.norm(preset_commands(preset, PRESET_FPS)[0], axis=-1)
    np.testing.assert_allclose(speeds, [1.0, 0.5, 0.0], atol=ROUNDING)


def test_public_preset_is_55_seconds_of_side_and_back_walks(reference):
    path = reference / "camdm" / "preset.txt"
    if not path.is_file():
        pytest.skip(f"{path} is absent")
    preset = read_preset(path)
    assert len(preset.stick) == 1654 and round(preset.seconds) == 55
    assert mean_of_numbers(angle_errors(preset.stick, preset.facing)) == pytest.approx(81.6, abs=0.05)
