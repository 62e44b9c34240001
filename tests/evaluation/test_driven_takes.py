"""Characters driven along takes: by a trained run, in both ways, all takes at once."""

from __future__ import annotations

from dataclasses import replace

import jax
import numpy as np
import pytest

from experiments.common.turning_judged import WAYS, StyledNetwork, judge_network, judged_table
from pfnn_jax.control.controller import assemble_controller, make_controller
from pfnn_jax.evaluation.driven_takes import MARGIN_SECONDS, DrivenTake, follow_takes, make_driven_take, track_takes
from pfnn_jax.evaluation.turning_judge import judge_walk
from pfnn_jax.inference.predictor import make_predictor
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run, load_style
from tests.trained import walking_run

SAME = 1e-3  # metres: a rollout enlarges rounding errors, which depend on the place in a batch
SPEED = 0.1  # of the speed: command tracking within a take of a few seconds
DRIFT = 0.3  # metres, mean distance of a tracked character from its path


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    return walking_run(tmp_path_factory)


def take(run: Run, degrees_per_second: float, style: str = "old") -> DrivenTake:
    rate = np.zeros(240)
    rate[60:180] = np.deg2rad(degrees_per_second)
    speed = 0.7 if style == "old" else 1.2
    return make_driven_take(LabelledClip(*synthesise(style, rate, np.full(240, speed), seed=5)), run)


@pytest.fixture(scope="module")
def takes(run) -> list[DrivenTake]:
    return [take(run, 40.0), take(run, -40.0)]


@pytest.fixture(scope="module")
def walks(run, takes) -> dict:
    """Walks by way and style."""
    found = {}
    for style in ("old", "proud"):
        controller = make_controller(run, (style,))
        found["controller", style] = track_takes(controller, controller.style_weights(0), run, takes)
        found["loop", style] = follow_takes(make_predictor(run, style), run, takes)
    return found


@pytest.mark.slow
@pytest.mark.parametrize("way", ["loop", "controller"])
def test_own_style_walks_more_like_the_actor_than_another(takes, walks, way):
    distances = []
    for style in ("old", "proud"):
        judged = [judge_walk(*pair) for pair in zip(takes, walks[way, style], strict=True)]
        assert all(one["failed"] == 0.0 for one in judged)
        distances.append(np.mean([one["distance"] for one in judged]))
    assert distances[0] < distances[1]


@pytest.mark.slow
def test_tracked_character_keeps_to_the_path_and_the_speed_of_the_actor(takes, walks):
    for one in (judge_walk(*pair) for pair in zip(takes, walks["controller", "old"], strict=True)):
        assert one["speed"] == pytest.approx(1.0, abs=SPEED) and one["path"] < 100 * DRIFT


@pytest.mark.slow
@pytest.mark.parametrize("way", ["loop", "controller"])
def test_walk_covers_the_take_and_a_margin(takes, walks, way):
    for one, walk in zip(takes, walks[way, "old"], strict=True):
        assert walk.place[walk.first] >= one.begin > walk.place[walk.first - 1]
        assert walk.place[walk.last] >= one.end > walk.place[walk.last - 1]
        assert len(walk.joints) - 1 - walk.last <= MARGIN_SECONDS * one.fps


@pytest.mark.slow
def test_walk_along_a_take_does_not_depend_on_the_other_takes(run, takes, walks):
    alone = follow_takes(make_predictor(run, "old"), run, takes[1:])[0]
    np.testing.assert_allclose(alone.joints, walks["loop", "old"][1].joints, atol=SAME)


def test_network_that_diverges_is_counted_and_raises_nothing(run, takes):
    style = jax.tree.map(lambda leaf: np.full_like(leaf, np.nan), load_style(run, "old"))
    predictor = replace(make_predictor(run, "old"), style=style)
    controller = assemble_controller(run.shared, {"old": style}, run, speeds={"old": 0.7})
    for walks in (
        follow_takes(predictor, run, takes),
        track_takes(controller, controller.style_weights(0), run, takes),
    ):
        assert [walk.faults for walk in walks] == [("not finite",)] * 2
        assert all(judge_walk(*pair)["failed"] == 1.0 for pair in zip(takes, walks, strict=True))


@pytest.mark.slow
def test_experiments_judge_a_style_in_both_ways(run, takes, walks):
    styled = StyledNetwork(run.shared, load_style(run, "old"), run, 0.7)
    judged = judge_network(styled, takes, "old", None)
    expected = [judge_walk(*pair)["distance"] for pair in zip(takes, walks["loop", "old"], strict=True)]
    np.testing.assert_allclose(judged["loop"].of_takes("distance"), expected, atol=100 * SAME)
    for way in WAYS:
        table = judged_table({"CP": judged}, way)
        assert f"| {way} | CP |" in table and "| failed | 0 |" in table
