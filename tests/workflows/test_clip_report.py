"""Warnings of a clip and of a learned style: each for what causes it, and none for a plain walk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.io.files import write_json
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise, synthetic_clips
from pfnn_jax.run_config import style_note
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.log import read_metrics
from pfnn_jax.workflows.clip_report import (
    FAR,
    RunError,
    StyleResult,
    clip_warnings,
    inspect_clip,
    result_warnings,
    run_error,
)
from pfnn_jax.workflows.pretrain import pretrain_run
from tests.motion.test_asymmetry import raise_arm

NO_WALK = "the clip is not a forward walk"
PLAIN = StyleResult(held_out_error=0.2, error_without_style=0.5, stable_on_turns=True)
OWN = RunError(0.1, "the largest error of the run's own styles")


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


def partly_labelled(labelled: LabelledClip, share: float) -> LabelledClip:
    """Returns the clip with a phase in its first frames only, as of a walk that stops."""
    frames = np.arange(labelled.clip.num_frames) < share * labelled.clip.num_frames
    return replace(labelled, labels=replace(labelled.labels, labelled=frames))


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
        (partly_labelled(walk(), 0.5), "steps in only 50% of its frames"),
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
        and "without the mirror image" in clip_warnings(report)[0]
        and "--mirror True" in clip_warnings(report)[0]
    )
    for mirror in (True, False):
        report = inspect_clip(labelled, mirror)
        assert report.mirrored is mirror and not report.measured and clip_warnings(report) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"stable_on_turns": False}, "the style diverges or does not turn"),
        ({"held_out_error": 1.2, "error_without_style": 2.0}, "the style does not fit the run"),
        ({"held_out_error": float("nan")}, "the style does not fit the run"),
        ({"held_out_error": 1.1 * FAR * OWN.error}, "3.3 times the largest error of the run's own styles"),
        ({"error_without_style": 0.1}, "the style adds nothing"),
    ],
)
def test_a_style_that_fails_is_named(change, said):
    warnings = result_warnings(PLAIN._replace(**change), OWN)
    assert len(warnings) == 1 and said in warnings[0] and "\n" not in warnings[0]


@pytest.mark.parametrize("reference", [OWN, None])
def test_a_style_that_fits_has_no_warning(reference):
    assert result_warnings(PLAIN, reference) == []


def test_a_style_far_from_the_runs_own_that_is_learned_well_has_no_warning():
    assert result_warnings(StyleResult(0.6, 2.5, True), OWN) == []
    assert len(result_warnings(StyleResult(0.6, 1.1, True), OWN)) == 1


def test_a_style_is_compared_with_the_runs_own_or_in_earlier_runs_with_the_training_loss(tmp_path):
    clips = [clip for style in ("neutral", "proud") for clip in synthetic_clips(style, 4)]
    dataset = prepare(clips, tmp_path / "data", PrepareConfig())
    run = pretrain_run(
        dataset, tmp_path / "run", PretrainConfig(AdapterConfig(rank=2), hidden=8, steps=4, batch_size=16)
    )
    notes = {name: style_note(run.path, name) for name in run.config.styles}
    found = run_error(run)
    assert found is not None and found.error == max(note["info"]["error"] for note in notes.values())
    for name, note in notes.items():
        del note["info"]["error"]
        write_json(run.path / "styles" / name / "style.json", note)
    found = run_error(run)
    assert found is not None and found.error == read_metrics(run.path)[-1]["loss"] and "training loss" in found.what
    (run.path / "metrics.jsonl").unlink()
    assert run_error(run) is None
