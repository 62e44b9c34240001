"""Laws of the judge: real clips judge as they should, other rates and skeletons do not matter, spreads are means."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.evaluation.clip_classifier import WindowConfig, clip_accuracy, train_clip_classifier
from pfnn_jax.evaluation.motion_windows import POINT_ROLES, motion_windows, point_windows
from pfnn_jax.evaluation.style_classifier import ClassifierConfig
from pfnn_jax.evaluation.transfer_judge import MEASURES, Recognisers, clips_frechet, judge_transfer, summarise
from pfnn_jax.motion.clip import cut, resample
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.transfer.clip_rows import clip_points

EXACT = 1e-9  # metres and their ratios
RESAMPLED = 0.1  # of a centimetre: half the frames, and joints lie on arcs
SMALL = ClassifierConfig(filters=16, features=16, epochs=30, batch_size=16, learning_rate=3e-3, dropout=0.0)
STYLES = ("neutral", "old", "proud")


@pytest.fixture(scope="module")
def clips():
    return {style: [take.clip for take in synthetic_clips(style, 6.0, clip_seconds=2.0)] for style in STYLES}


@pytest.fixture(scope="module")
def classifier(clips):
    known = [(clip, style) for style, own in clips.items() for clip in own[:-1]]
    windows = WindowConfig(frames=30, stride=15, time_scales=(1.0,))
    return train_clip_classifier(
        [clip for clip, _ in known], [style for _, style in known], windows=windows, config=SMALL
    )


def test_content_as_result_keeps_the_content_and_the_ground_truth_is_the_right_answer(clips):
    content, style, truth = clips["neutral"][0], clips["old"][0], clips["old"][1]
    nothing = judge_transfer(content, style, content, truth)
    assert set(nothing) == set(MEASURES)
    for measure in ("CC, cm", "CC warped, cm", "bone error, cm", "trajectory, m", "trajectory shape, m"):
        assert nothing[measure] == pytest.approx(0.0, abs=EXACT)
    assert nothing["jitter ratio"] == pytest.approx(1.0, abs=EXACT)
    assert nothing["style recognised"] is None  # without classifiers
    right = judge_transfer(content, style, truth, truth)
    assert right["SC++, cm"] == right["SC++ warped, cm"] == pytest.approx(0.0, abs=EXACT)
    assert right["CC, cm"] == pytest.approx(nothing["SC++, cm"], abs=EXACT)
    copied = judge_transfer(content, style, style)
    assert copied["to style warped, cm"] == pytest.approx(0.0, abs=EXACT) and copied["SC++, cm"] is None


def test_judge_compares_at_one_frame_rate(clips):
    content, style = clips["neutral"][0], clips["old"][0]
    whole, half = (judge_transfer(content, style, resample(style, fps), fps=30.0) for fps in (60.0, 30.0))
    assert half["CC, cm"] == pytest.approx(whole["CC, cm"], abs=RESAMPLED)
    assert half["jitter ratio"] == pytest.approx(whole["jitter ratio"], rel=EXACT)


def test_classifier_recognises_clips_of_other_takes_whatever_their_length(clips, classifier):
    held_out = [own[-1] for own in clips.values()]
    assert clip_accuracy(classifier, held_out, STYLES) == 1.0
    assert clip_accuracy(classifier, [cut(clip, 0, 40) for clip in held_out], STYLES) == 1.0
    likely = classifier.probabilities(held_out[1])
    assert likely.sum() == pytest.approx(1.0, abs=1e-6)
    assert classifier.probability(held_out[1], "old") == pytest.approx(likely[1], abs=EXACT)


def test_recognition_is_of_the_wanted_style(clips, classifier):
    content, style = clips["neutral"][-1], clips["old"][-1]
    found = judge_transfer(content, style, style, recognisers=Recognisers(style=classifier))
    missed = judge_transfer(content, style, content, recognisers=Recognisers(style=classifier))
    assert (found["style recognised"], missed["style recognised"]) == (1.0, 0.0)
    assert found["content recognised"] is None


def test_frechet_distance_of_clips_is_zero_to_themselves(clips, classifier):
    assert clips_frechet(classifier, clips["old"], clips["old"]) == pytest.approx(0.0, abs=1e-5)
    assert clips_frechet(classifier, clips["old"], clips["proud"]) > 0.1


def test_short_clips_are_padded_to_one_window(clips):
    short = cut(clips["old"][0], 0, 21)
    windows = point_windows(short, frames=30)
    assert windows.shape == (1, 30, 126)
    np.testing.assert_array_equal(windows[0, :4, 63:], 0.0)  # it stands still before it begins
    inner = motion_windows(clip_points(short), POINT_ROLES, short.fps, frames=20)
    assert inner.shape == (1, 20, 126)


def test_spread_is_the_mean_with_its_interval_and_leaves_out_what_is_missing():
    records = [{"CC, cm": value, "SC++, cm": None} for value in (1.0, 2.0, 3.0, 6.0)]
    found = summarise(records)
    assert set(found) == {"CC, cm"}
    spread = found["CC, cm"]
    assert (spread.mean, spread.count) == (3.0, 4) and spread.low < 3.0 < spread.high
    alone = summarise(records[:1])["CC, cm"]
    assert (alone.low, alone.high, alone.std) == (1.0, 1.0, 0.0)
