"""The judge of turning takes: what must not matter, what known differences measure, and walks of a trained run."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pfnn_jax.evaluation.driven_takes import DrivenTake, Walk, make_driven_take, walk_of_joints
from pfnn_jax.evaluation.gait_cycle import LARGEST_SHIFT, NUM_PHASES
from pfnn_jax.evaluation.style_classifier import ClassifierConfig
from pfnn_jax.evaluation.transfer_metrics import frame_distances
from pfnn_jax.evaluation.turning_judge import (
    MEASURES,
    WARPING_SECONDS,
    WORST_DISTANCE,
    judge_style,
    judge_walk,
    mean_measures,
    repetition_distance,
    train_recogniser,
    warped_distance,
)
from pfnn_jax.motion.clip import MotionClip, cut, resample
from pfnn_jax.motion.datasets.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.ground import turn
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply
from pfnn_jax.motion.labels.phase import CYCLE, cut_phase
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.world_motion import world_motion
from tests.raising import assert_refused

LEAD, LENGTH = 120, 300
"""Frames of straight walking before the take, and of the take."""

EXACT = 1e-9
MOVED = 1e-6  # relative: places on the path are found by nearest points, whose coordinates round differently
LABELLERS = 0.7  # centimetres between a walk with exact labels and the same walk with found ones
ENDS = 0.3  # centimetres; the facing is smoothed, so that the ends of a take have a slightly different one
WARPED = 0.8  # centimetres that a body moves in a frame of 30 fps, by which the ends of two walks may differ
SLOWED = 0.5  # centimetres; the facing of a slower walk is smoothed over less of its path
RATE = 0.03  # of the turn rate, for the same reason
OUT_OF_STEP = 1.5  # centimetres between two walks of one style that begin with different feet, in a turn


def body(skeleton) -> Any:
    """Returns what a take needs to know of a network."""
    return SimpleNamespace(layout=mason2018(skeleton.num_joints), skeleton=skeleton)


def course(style: str = "old", seed: int = 5) -> LabelledClip:
    """Returns a walk: straight on, a turn to the left of 86°, and straight on."""
    rate = np.zeros(LEAD + LENGTH + LEAD)
    rate[LEAD + 100 : LEAD + 200] = np.deg2rad(52.0)
    return LabelledClip(*synthesise(style, rate, np.full(len(rate), 0.8), seed=seed))


def middle(whole: LabelledClip) -> LabelledClip:
    return LabelledClip(cut(whole.clip, LEAD, LEAD + LENGTH), cut_phase(whole.labels, LEAD, LEAD + LENGTH))


def moved(labelled: LabelledClip, angle: float = 1.0, shift: tuple[float, ...] = (3.0, 0.0, -2.0)) -> LabelledClip:
    clip, rotations = labelled.clip, labelled.clip.rotations.copy()
    rotations[:, 0] = quat_multiply(quat_from_yaw(np.float64(angle)), rotations[:, 0])
    roots = turn(clip.root_positions, np.float64(angle)) + np.array(shift)
    return replace(labelled, clip=replace(clip, root_positions=roots, rotations=rotations))


def joints_of(clip: MotionClip) -> np.ndarray:
    return world_motion(clip).positions


@pytest.fixture(scope="module")
def take() -> DrivenTake:
    labelled = middle(course())
    return make_driven_take(labelled, body(labelled.clip.skeleton))


@pytest.fixture(scope="module")
def other(take) -> Walk:
    return walk_of_joints(take, joints_of(course("proud").clip))


def test_actor_differs_from_itself_by_nothing(take):
    found = judge_walk(take, take.actor)
    for measure in ("distance", "turning", "trunk", "arms", "legs", "cycle", "warped", "end", "failed"):
        assert found[measure] < EXACT, measure
    for measure in ("speed", "contacts", "flicker", "sliding", "skating", "turn rate"):
        assert found[measure] == pytest.approx(1.0, abs=EXACT), measure
    assert found["path"] < ENDS


def test_poses_of_the_actor_are_the_nearest_to_themselves(take):
    found = judge_style([take], [take.actor])
    assert found["precision"] < EXACT and found["recall"] < EXACT


def test_place_and_heading_of_the_world_do_not_matter(take, other):
    labelled = moved(middle(course()))
    there = make_driven_take(labelled, body(labelled.clip.skeleton))
    walk = walk_of_joints(there, joints_of(moved(course("proud")).clip))
    expected, found = judge_walk(take, other), judge_walk(there, walk)
    for measure in MEASURES:
        assert found[measure] == pytest.approx(expected[measure], rel=MOVED, abs=MOVED, nan_ok=True), measure


def test_labels_shifted_by_part_of_a_cycle_do_not_matter(take):
    shifted = (take.actor.phase + LARGEST_SHIFT * CYCLE / NUM_PHASES) % CYCLE
    # Frames at the ends whose phase now lies beyond the take are compared with those a cycle away.
    assert judge_walk(take, replace(take.actor, phase=shifted))["distance"] < ENDS


def test_walk_whose_labels_are_found_is_the_actors_own(take):
    found = judge_walk(take, walk_of_joints(take, joints_of(course().clip)))
    assert found["distance"] < LABELLERS and found["warped"] < WARPED and found["cycle"] < LABELLERS
    assert found["contacts"] > 0.95 and found["turn rate"] == pytest.approx(1.0, abs=RATE)


def test_slower_walk_has_the_same_poses_and_turns_more_slowly(take):
    clip = course().clip
    slow = resample(replace(clip, fps=0.8 * clip.fps), clip.fps)  # the same frames last longer
    found = judge_walk(take, walk_of_joints(take, joints_of(slow)))
    assert found["distance"] < LABELLERS + SLOWED and found["warped"] < WARPED
    assert found["speed"] == pytest.approx(0.8, abs=RATE) and found["turn rate"] == pytest.approx(0.8, abs=RATE)


def test_style_counts_more_than_step(take, other):
    again = judge_walk(take, walk_of_joints(take, joints_of(course(seed=6).clip)))
    assert again["distance"] < OUT_OF_STEP < judge_walk(take, other)["distance"]


def test_known_offset_of_one_part_is_measured_there_alone(take):
    joints = take.actor.joints.copy()
    joints[:, [*take.roles.left_foot, *take.roles.right_foot], 1] += 0.04
    found = judge_walk(take, replace(take.actor, joints=joints))
    assert found["legs"] == pytest.approx(4.0 * 4 / 8) and found["arms"] < EXACT and found["trunk"] < EXACT


def test_straight_walk_does_not_turn_and_leaves_the_path(take):
    frames = LEAD + LENGTH + 2 * LEAD
    straight = synthesise("old", np.zeros(frames), np.full(frames, 0.8), seed=5)[0]
    walk = walk_of_joints(take, joints_of(straight))
    if walk.faults:
        assert judge_walk(take, walk)["failed"] == 1.0
    else:
        found = judge_walk(take, walk)
        assert abs(found["turn rate"]) < RATE and found["path"] > 10.0


def test_phase_of_the_network_stands_in_for_steps_that_are_not_found(take):
    unlabelled = replace(take.actor, phase=np.full_like(take.actor.phase, np.nan))
    found = judge_walk(take, replace(unlabelled, network_phase=take.actor.phase))
    assert found["distance"] < EXACT and found["failed"] == 0.0
    assert judge_walk(take, unlabelled)["failed"] == 1.0


def test_contacts_that_flicker_are_counted_against_the_actors(take):
    contacts = take.actor.contacts.copy()
    contacts[10:20:2] = ~contacts[10:20:2]
    found = judge_walk(take, replace(take.actor, contacts=contacts, network_contacts=take.actor.contacts))
    assert found["flicker"] > 1.2 and found["network flicker"] == 1.0
    assert found["contacts"] == pytest.approx(1.0 - 5 / LENGTH)


def test_frames_without_a_foot_on_the_floor_are_counted_against_those_of_a_run(take):
    assert np.isnan(judge_walk(take, take.actor)["airborne"])
    contacts = take.actor.contacts.copy()
    contacts[::2] = False
    run = replace(take.actor, contacts=contacts)
    assert judge_walk(replace(take, actor=run), run)["airborne"] == pytest.approx(1.0, abs=EXACT)
    standing = replace(take.actor, contacts=np.ones_like(contacts))
    assert judge_walk(replace(take, actor=run), standing)["airborne"] == 0.0


def test_feet_that_move_while_the_actors_stand_slide(take):
    joints = take.actor.joints + np.linspace(0.0, 0.1, LENGTH)[:, None, None] * np.array([1.0, 0.0, 0.0])
    assert judge_walk(take, replace(take.actor, joints=joints))["sliding"] > 1.0
    still = take.actor.joints.copy()
    feet = [*take.roles.left_foot, *take.roles.right_foot]
    still[:, feet] = still[:1, feet]
    assert judge_walk(take, replace(take.actor, joints=still))["sliding"] < EXACT


def test_failed_walks_count_with_the_worst_distance(take):
    joints = joints_of(course().clip)
    diverged = joints.copy()
    diverged[200:] = np.nan
    failed = [diverged, joints * [1.0, 0.5, 1.0], joints[:200]]
    for walk in (walk_of_joints(take, one) for one in failed):
        found = judge_walk(take, walk)
        assert len(walk.faults) == 1 and found["failed"] == 1.0
        assert found["distance"] == found["cycle"] == found["warped"] == WORST_DISTANCE and found["contacts"] == 0.0
    assert set(found) == set(MEASURES)


def test_distance_of_no_walk_is_above_the_worst(take):
    walk = walk_of_joints(take, joints_of(course().clip))
    exploded = walk.joints.copy()
    exploded[:, take.roles.left_hand] += 100.0
    assert judge_walk(take, replace(walk, joints=exploded))["distance"] == WORST_DISTANCE


def test_body_on_the_ground_is_about_the_worst_distance_away(take):
    poses = take.actor.poses
    lying = poses[..., [0, 2, 1]] * [1.0, 0.0, 1.0]
    apart = 100 * np.linalg.norm(poses - lying, axis=-1).mean()
    assert WORST_DISTANCE < apart < 3 * WORST_DISTANCE


def test_takes_of_one_style_repeat_each_other_more_closely_than_those_of_two(take):
    again, proud = (middle(course(style, 6)) for style in ("old", "proud"))
    again, proud = (make_driven_take(one, body(one.clip.skeleton)) for one in (again, proud))
    own = repetition_distance([take, again])
    assert 0.0 < own < OUT_OF_STEP < repetition_distance([take, proud])
    assert np.isnan(repetition_distance([take]))


def test_means_are_over_the_walks_that_have_a_measure():
    judged = [{"a": 1.0, "b": np.nan}, {"a": 3.0, "b": np.nan}, {"a": np.nan, "b": np.nan}]
    means = mean_measures(judged)
    assert means["a"] == 2.0 and np.isnan(means["b"])


@pytest.mark.parametrize(("rows", "columns"), [(40, 40), (30, 44), (41, 29)])
def test_warped_distance_is_the_recursion_within_its_band(rows, columns):
    rng = np.random.default_rng(rows)
    true, own = rng.normal(size=(rows, 4, 3)), rng.normal(size=(columns, 4, 3))
    own[: min(rows, columns)] += 2 * true[: min(rows, columns)]  # so that the path is not the diagonal alone
    distances = frame_distances(true, own)
    least = {(-1, -1): 0.0}
    for i in range(rows):
        for j in range(columns):
            band = abs(i / (rows - 1) - j / (columns - 1)) * max(rows, columns) / 30.0
            d = distances[i, j] if band <= WARPING_SECONDS else np.inf
            before = [least.get((i - 1, j), np.inf) + d, least.get((i, j - 1), np.inf) + d]
            least[i, j] = min(*before, least.get((i - 1, j - 1), np.inf) + 2 * d)
    expected = least[rows - 1, columns - 1] / (rows + columns)
    assert warped_distance(true, own, 30.0) == pytest.approx(expected, abs=EXACT)


def test_take_at_another_rate_is_refused():
    labelled = middle(course())
    slow = replace(labelled, clip=replace(labelled.clip, fps=30.0))
    assert_refused(lambda: make_driven_take(slow, body(slow.clip.skeleton)), place="frame rate", value=30.0)


def test_recogniser_knows_the_styles_that_it_saw(take, other):
    clips = {style: [course(style, seed).clip for seed in range(2)] for style in ("old", "proud")}
    recogniser = train_recogniser(clips, ClassifierConfig(filters=8, features=8, epochs=8))
    own, wrong = (judge_style([take], [walk], "old", recogniser) for walk in (take.actor, other))
    assert own["recognised"] == 1.0 and wrong["recognised"] == 0.0
    assert own["frechet"] < EXACT < wrong["frechet"]


def test_real_take_is_recognised_in_the_clip_that_it_was_cut_from(mocap):
    """Cuts a take out of a real turning clip, and judges the whole clip and a slower one as walks along it."""
    file = next(
        f for f in list_clips(mocap / "bandai-namco-2") if f.path.stem == "dataset-2_walk-turn-left_elderly_008"
    )
    whole = load_labelled(file)
    part = slice(30, whole.clip.num_frames - 30)
    labels = cut_phase(whole.labels, part.start, part.stop)
    take = make_driven_take(LabelledClip(cut(whole.clip, part.start, part.stop), labels), body(whole.clip.skeleton))
    own = judge_walk(take, walk_of_joints(take, joints_of(whole.clip)))
    assert own["distance"] < LABELLERS and own["contacts"] > 0.95 and own["end"] < 5.0
    slow = resample(replace(whole.clip, fps=0.8 * whole.clip.fps), whole.clip.fps)
    slower = judge_walk(take, walk_of_joints(take, joints_of(slow)))
    assert own["distance"] <= slower["distance"] < LABELLERS + SLOWED
    assert slower["turn rate"] == pytest.approx(0.8 * own["turn rate"], abs=RATE)
