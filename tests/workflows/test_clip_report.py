"""Warnings of a clip and of a learned style: each for what causes it, and none for a plain walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise
from pfnn_jax.workflows.clip_report import FAR, clip_warnings, inspect_clip, result_warnings
from tests.motion.test_asymmetry import raise_arm

NO_WALK = "the clip is no walk ahead"
PLAIN = {"choice": {"held_out_error": 0.2}, "error_without_style": 0.5, "stable_on_turns": True}


def walk(style="neutral", frames=300) -> LabelledClip:
    return LabelledClip(*synthesise(style, np.zeros(frames), np.full(frames, STYLES[style].speed)))


def turned(labelled: LabelledClip, degrees: float) -> LabelledClip:
    """Returns the clip with its travel, not its body, turned to the left."""
    positions = labelled.clip.root_positions.copy()
    across, ahead = positions[:, 0].copy(), positions[:, 2].copy()
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    positions[:, 0], positions[:, 2] = c * across + s * ahead, c * ahead - s * across
    return replace(labelled, clip=replace(labelled.clip, root_positions=positions))


def moved(labelled: LabelledClip, scale: float = 1.0, bounce: float = 0.0) -> LabelledClip:
    """Returns the clip with its travel scaled, and its hips moved up and down by `bounce` metres."""
    positions = labelled.clip.root_positions * [scale, 1.0, scale]
    positions[:, 1] += 0.5 * bounce * np.sin(np.arange(len(positions)) / 20)
    return replace(labelled, clip=replace(labelled.clip, root_positions=positions))


@pytest.mark.parametrize("style", STYLES)
def test_plain_walks_have_no_warning_and_are_mirrored(style):
    report = inspect_clip(walk(style))
    assert report.mirrored and report.measured and clip_warnings(report) == []


@pytest.mark.parametrize(
    ("labelled", "said"),
    [
        (turned(walk(), 40.0), "40° to the left"),
        (turned(walk(), -90.0), "90° to the right"),
        (turned(walk(), 180.0), "moves backwards"),
        (moved(walk(), scale=0.1), "m/s"),
        (moved(walk(), bounce=0.6), "hips rise and fall"),
    ],
)
def test_a_clip_that_is_no_walk_ahead_is_named(labelled, said):
    warnings = clip_warnings(inspect_clip(labelled, mirror=True))
    assert len(warnings) == 1 and warnings[0].startswith(NO_WALK) and said in warnings[0]


@pytest.mark.parametrize(
    ("file", "said"),
    [
        ("bandai-namco-1/dataset-1_walk_old_001.bvh", None),
        ("bandai-namco-1/dataset-1_walk_tired_001.bvh", None),
        ("bandai-namco-1/dataset-1_dash_normal_001.bvh", None),
        ("bandai-namco-2/dataset-2_walk-turn-right_normal_001.bvh", None),
        ("xia-test/proud_01_000.bvh", None),
        ("bandai-namco-1/dataset-1_walk-left_happy_001.bvh", "to the left"),
        ("bandai-namco-1/dataset-1_walk-right_active_001.bvh", "to the right"),
        ("bandai-namco-1/dataset-1_walk-back_old_001.bvh", "backwards"),
        ("xia-test/neutral_16_000.bvh", "hips rise and fall"),
        ("xia-test/proud_22_000.bvh", "no alternating steps"),
    ],
)
def test_real_walks_ahead_are_told_from_others(mocap, file, said):
    labelled = load_labelled(ClipFile(mocap / file, "any"), phase=False)
    warnings = [line for line in clip_warnings(inspect_clip(labelled)) if line.startswith(NO_WALK)]
    if said is None:
        assert not warnings
    else:
        assert len(warnings) == 1 and said in warnings[0]


def test_only_a_measured_decision_against_mirroring_is_a_warning():
    labelled = walk()
    labelled = replace(labelled, clip=raise_arm(labelled.clip))
    report = inspect_clip(labelled)
    assert (
        not report.mirrored
        and "not mirrored" in clip_warnings(report)[0]
        and "--mirror True" in clip_warnings(report)[0]
    )
    for mirror in (True, False):
        report = inspect_clip(labelled, mirror)
        assert report.mirrored is mirror and not report.measured and clip_warnings(report) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"stable_on_turns": False}, "no setting walks circles without diverging"),
        ({"choice": {"held_out_error": 1.2}, "error_without_style": 2.0}, "worse than predicting the mean"),
        ({"choice": {"held_out_error": float("nan")}}, "worse than predicting the mean"),
        ({"choice": {"held_out_error": 1.1 * FAR * 0.1}}, "3.3 times the training loss"),
        ({"error_without_style": 0.1}, "adds nothing"),
    ],
)
def test_a_style_that_fails_is_named(change, said):
    warnings = result_warnings({**PLAIN, **change}, loss=0.1)
    assert len(warnings) == 1 and said in warnings[0] and "\n" not in warnings[0]


@pytest.mark.parametrize("loss", [0.1, None])
def test_a_style_that_fits_has_no_warning(loss):
    assert result_warnings(PLAIN, loss) == []
