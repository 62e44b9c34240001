"""The demo at toy size: its run, clip, report and motion are complete, and its ground truth is exact."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pfnn_jax.demo.judging import KNOWN, LEARNED, NO_ADAPTER, PAPER, TURN_RATES, turning_takes
from pfnn_jax.demo.pipeline import DemoConfig, demo, straight_walk
from pfnn_jax.evaluation.turning_judge import MEASURES, STYLE_MEASURES
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.labels.phase import read_phase
from pfnn_jax.motion.synthetic.styles import UNSEEN_STYLE
from pfnn_jax.run import load_run
from pfnn_jax.run_config import list_styles, style_note
from tests.raising import assert_refused

TINY = DemoConfig(seconds_per_style=4, hidden=8, steps=20, walk_seconds=2)

RATE = 0.1
"""Share by which the turn rate of a take may differ from the one asked: the facing sways with the hips."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo") / "demo"
    return out, demo(out, TINY)


@pytest.mark.slow
def test_run_contains_the_ninth_style(made):
    out, _ = made
    run = load_run(out / "run")
    assert len(list_styles(run.path)) == 9
    info = style_note(run.path, "zombie")["info"]
    assert 175 <= info["frames"] <= 180  # three seconds without the ends of the clip
    assert info["choice"]["epochs"] in info["config"]["eval_epochs"]


@pytest.mark.slow
def test_clip_is_a_bvh_file_with_a_phase_file(made):
    out, _ = made
    clip = read_bvh(out / "clip" / "zombie_straight.bvh")
    labels = read_phase(out / "clip" / "zombie_straight.phase", clip.num_frames)
    np.testing.assert_allclose(np.diff(clip.root_positions[:, 0]).sum(), 0.0, atol=0.1)  # straight ahead
    assert labels.labelled.all()


@pytest.mark.slow
def test_report_judges_every_character_and_needs_no_network(made):
    out, result = made
    report = json.loads((out / "report.json").read_text())
    assert list(report["judged"]) == [NO_ADAPTER, PAPER, LEARNED, KNOWN]
    assert all(set(row) == {*MEASURES, *STYLE_MEASURES} for row in result["judged"].values())
    page = (out / "report.html").read_text()
    assert "motion-player" in page and "data:image/png" in page
    assert "http://" not in page.replace("http://www.w3.org", "") and "https://" not in page
    for name in ("zombie", "agnostic", "neutral"):
        assert read_bvh(out / "motion" / f"{name}_figure_eight.bvh").num_frames == 120


@pytest.mark.slow
def test_existing_output_is_refused_without_overwrite(made):
    assert_refused(lambda: demo(made[0], TINY), file=made[0], place="output", value="exists")


def test_adaptation_walk_is_labelled_in_every_frame():
    labelled = straight_walk(3.0, seed=0)
    assert labelled.clip.num_frames == 181
    assert labelled.labels.labelled.all()


@pytest.mark.slow
def test_takes_turn_at_the_stated_rates(made):
    run = load_run(made[0] / "run")
    for take, rate in zip(turning_takes(UNSEEN_STYLE, run, 0), TURN_RATES, strict=True):
        yaw = np.unwrap(take.actor.root.yaw)
        middle = yaw[len(yaw) * 3 // 8 : len(yaw) * 5 // 8]
        turned = np.rad2deg(middle[-1] - middle[0]) * run.layout.fps / (len(middle) - 1)
        assert turned == pytest.approx(rate, rel=RATE)
