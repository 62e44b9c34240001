"""Comparison of generated walks with an actor's: measures of constructed walks, and one of a trained run."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.control.controller import make_controller
from pfnn_jax.evaluation.actor_test import (
    LEAD_SECONDS,
    PATH_POINTS,
    Actor,
    ActorWalk,
    actor_distance,
    compare_walk,
    follow_actor,
    holding_distance,
    make_actor,
    one_step_distance,
    path_of,
    progress_along,
    retargeting_distance,
)
from pfnn_jax.inference.predictor import make_predictor
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.kinematics import quat_from_axis_angle, quat_multiply
from pfnn_jax.motion.paths import figure_eight
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.world_motion import world_motion
from pfnn_jax.run import Run
from tests.trained import walking_run

FRAMES = 300
LABELLERS = 0.5  # centimetres between a walk with exact labels and the same walk with found ones
ROUNDING = 1e-6
FLOOR = 1.0  # centimetres: the same skeleton there and back is the same motion
SPEED = 0.03  # of the speed: the filter that removes the sway shortens a path a little


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Run:
    return walking_run(tmp_path_factory)


def take(style: str = "old", seed: int = 5, turn: float = 0.0) -> LabelledClip:
    speed = 0.7 if style == "old" else 1.2
    return LabelledClip(*synthesise(style, np.full(FRAMES, turn), np.full(FRAMES, speed), seed=seed))


@pytest.fixture(scope="module")
def actor(run) -> Actor:
    return make_actor(take(), run)


def walk(clip: MotionClip, speed: float = 1.0, path_error: float = 0.0) -> ActorWalk:
    return ActorWalk(clip, speed, path_error)


def test_actors_own_walk_differs_by_nothing(actor):
    found = compare_walk(actor, walk(actor.world.clip))
    assert found["distance"] < LABELLERS and found["lean"] < ROUNDING and found["faults"] == []
    assert abs(found["height"] - 1) < ROUNDING and abs(found["floating"]) < ROUNDING


def test_floating_walk_is_measured_in_centimetres(actor):
    clip = actor.world.clip
    found = compare_walk(actor, walk(replace(clip, root_positions=clip.root_positions + [0.0, 0.05, 0.0])))
    assert found["floating"] == pytest.approx(5.0) and found["distance"] == pytest.approx(5.0, abs=LABELLERS)


def test_walk_on_its_back_has_failed(actor):
    clip = actor.world.clip
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), -np.pi / 2), rotations[:, 0])
    found = compare_walk(actor, walk(replace(clip, rotations=rotations)))
    assert found["lean"] > 60 and any("trunk" in fault for fault in found["faults"])


def test_sunken_walk_has_failed(actor):
    clip = actor.world.clip
    found = compare_walk(actor, walk(replace(clip, root_positions=clip.root_positions * [1.0, 0.5, 1.0])))
    assert any("hips" in fault for fault in found["faults"])


def test_still_body_has_no_steps(actor):
    clip = actor.world.clip
    still = replace(
        clip, root_positions=clip.root_positions * 0 + clip.root_positions[:1], rotations=clip.rotations * 1
    )
    still.rotations[:] = clip.rotations[:1]
    found = compare_walk(actor, walk(still))
    assert found["distance"] is None and "no steps" in found["faults"]


@pytest.mark.parametrize(("speed", "path_error"), [(0.2, 0.0), (1.8, 0.0), (1.0, 2.0)])
def test_a_walk_that_does_not_follow_its_command_has_failed(actor, speed, path_error):
    assert len(compare_walk(actor, walk(actor.world.clip, speed, path_error))["faults"]) == 1


def test_path_contains_the_take_between_straight_pieces(actor):
    world = world_motion(actor.on_run)
    path, begin, end, speed = path_of(world)
    assert len(path.points) == PATH_POINTS and speed == pytest.approx(0.7, rel=SPEED)
    assert begin == pytest.approx(LEAD_SECONDS * speed) and (end - begin) == pytest.approx(0.7 * FRAMES / 60, rel=SPEED)
    first = world.positions[0, world.roles.hips][[0, 2]]
    assert np.linalg.norm(path.points - first, axis=-1).min() < 0.1


def test_progress_does_not_jump_where_a_path_comes_near_itself():
    path = figure_eight(1.0)
    np.testing.assert_array_equal(progress_along(path.points, path), np.arange(len(path.points)))


def test_there_and_back_on_the_same_skeleton_costs_nothing(actor, run):
    assert retargeting_distance(actor, run) < FLOOR


def test_actor_repeats_a_style_more_closely_than_another_style(actor, run):
    again, other = make_actor(take(seed=6), run), make_actor(take("proud"), run)
    near, far = actor_distance(actor, again), actor_distance(actor, other)
    assert near is not None and far is not None and near < far


@pytest.mark.slow
def test_own_style_walks_more_like_the_actor_than_another(actor, run):
    distances = {}
    for style in ("old", "proud"):
        controller = make_controller(run, (style,))
        found = compare_walk(actor, follow_actor(controller, controller.style_weights(0), run, actor))
        assert found["faults"] == []
        distances[style] = found["distance"]
    assert distances["old"] < distances["proud"]


def test_own_style_predicts_the_actor_better_than_another(actor, run):
    own, other = (one_step_distance(make_predictor(run, style), actor, run) for style in ("old", "proud"))
    assert own < other and holding_distance(actor, run) > 0
