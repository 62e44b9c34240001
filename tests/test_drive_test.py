"""The public drive test, from a preset and a small trained run to tables and figure."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments import drive_test
from pfnn_jax.evaluation.drive_preset import DrivePreset
from tests.raising import assert_refused
from tests.trained import walking_run

pytestmark = pytest.mark.slow

SECONDS = 3
STRAIGHT = 10.0  # degrees between a straight command and the walk of a network of 64 hidden units
WALKS = 0.25  # of the commanded speed, over three seconds that begin with standing


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive_test")
    (folder / "preset.txt").write_text("0, 0, 1, 0, 0, 1\n" * (30 * SECONDS))
    run = walking_run(tmp_path_factory)
    config = drive_test.Config((run.path,), folder / "preset.txt", folder / "out", styles=2, chunk=1)
    return config, drive_test.main(config)


def test_results_are_written_as_they_are_returned(outcome):
    config, result = outcome
    stored = json.loads((config.out / "drive_test.json").read_text())["rows"]
    assert [row["error"] for row in stored] == [row["error"] for row in result["rows"]]
    tables = (config.out / "drive_test.md").read_text().split("\n\n")
    assert [len(table.splitlines()) for table in tables] == [2 + 1 + 2 + 3, 2 + 2]
    assert (config.out / "drive_test.png").stat().st_size > 1000


def test_every_style_is_driven_by_every_controller(outcome):
    _, result = outcome
    found = {(row["style"], row["controller"]) for row in result["rows"]}
    assert len(found) == len(result["rows"]) == 2 * len(drive_test.CONTROLLERS)
    assert all(row["finite"] and not row["learned"] for row in result["rows"])


def test_tracked_characters_walk_straight_ahead_at_their_speed(outcome):
    _, result = outcome
    for row in result["rows"]:
        if row["controller"].startswith("tracked"):
            assert row["ahead"] < STRAIGHT and row["facing ahead"] < STRAIGHT, row
            assert abs(row["speed"] - 1.0) < WALKS, row
            assert np.isnan(row["sideways"]) and np.isnan(row["backward"])


def test_locked_feet_slide_less_in_contact(outcome):
    _, result = outcome
    locked, free = (
        [row["contact sliding"] for row in result["rows"] if row["controller"] == f"tracked, feet {kind}"]
        for kind in ("locked", "free")
    )
    assert np.mean(locked) < 0.5 * np.mean(free)


def test_points_that_follow_exactly_show_what_the_published_formula_adds():
    side = np.tile([1.0, 0.0], (300, 1))
    exact, swaying = drive_test.ideal_points(DrivePreset(side, side)).values()
    assert exact["error"] == 0.0 and swaying["error"] < 10.0
    assert swaying["published error"] > 90.0 and swaying["turned"] < 1.0


def test_no_runs_and_bad_presets_are_refused(outcome, tmp_path):
    config, _ = outcome
    assert_refused(lambda: drive_test.main(replace(config, runs=())), place="runs")
    bad = replace(config, preset=tmp_path / "absent.txt")
    assert_refused(lambda: drive_test.main(bad), file="absent.txt")
