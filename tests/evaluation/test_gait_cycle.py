"""The mean gait cycle and the distance between two: what must not matter, and what is measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.evaluation.gait_cycle import LARGEST_SHIFT, NUM_PHASES, cycle_distance, mean_cycle
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.ground import turn
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply
from pfnn_jax.motion.labels.phase import PhaseLabels, cut_phase
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.world_motion import WorldMotion, world_motion
from tests.raising import assert_refused

EXACT = 1e-9  # metres; sums of a few hundred float64 numbers of about one metre
SAME_WALK = 0.01  # metres between the cycles of two parts of one walk: its noise
ENDS = 0.003  # metres; the facing is smoothed over time, so that the ends of a part have a slightly other one


def walk(style: str = "neutral", frames: int = 360, seed: int = 0) -> tuple[MotionClip, PhaseLabels]:
    return synthesise(style, np.zeros(frames), np.ones(frames), seed=seed)


def cycle_of(clip: MotionClip, labels: PhaseLabels) -> np.ndarray:
    return mean_cycle(world_motion(clip), labels)


def test_cycle_has_a_pose_for_every_phase():
    clip, labels = walk()
    assert cycle_of(clip, labels).shape == (NUM_PHASES, clip.skeleton.num_joints, 3)


def test_distance_to_itself_is_zero():
    cycle = cycle_of(*walk())
    assert cycle_distance(cycle, cycle).max() == 0.0


def test_distance_is_symmetric():
    cycle, other = cycle_of(*walk()), cycle_of(*walk("old"))
    np.testing.assert_allclose(cycle_distance(cycle, other), cycle_distance(other, cycle), atol=EXACT)


def test_place_and_heading_do_not_matter():
    clip, labels = walk()
    moved = replace(
        clip,
        root_positions=turn(clip.root_positions, np.float64(1.0)) + [3.0, 0.0, -2.0],
        rotations=clip.rotations.copy(),
    )
    moved.rotations[:, 0] = quat_multiply(quat_from_yaw(np.float64(1.0)), clip.rotations[:, 0])
    np.testing.assert_allclose(cycle_of(moved, labels), cycle_of(clip, labels), atol=EXACT)


def test_known_offset_is_measured_at_its_joint_only():
    clip, labels = walk()
    world = world_motion(clip)
    hand = world.roles.left_hand
    positions = world.positions.copy()
    positions[:, hand] += [0.0, 0.1, 0.0]
    apart = cycle_distance(mean_cycle(world, labels), mean_cycle(replace(world, positions=positions), labels))
    expected = np.where(np.arange(clip.skeleton.num_joints) == hand, 0.1, 0.0)
    np.testing.assert_allclose(apart, expected, atol=EXACT)


@pytest.mark.parametrize("later", [7, 20, 33])
def test_walk_that_starts_later_has_the_same_cycle(later):
    clip, labels = walk(frames=600)
    world = world_motion(clip)
    part = WorldMotion(replace_frames(clip, later), world.positions[later:], world.rotations[later:])
    apart = cycle_distance(mean_cycle(world, labels), mean_cycle(part, cut_phase(labels, later, 600)))
    assert apart.max() < ENDS


@pytest.mark.parametrize("shift", [-LARGEST_SHIFT, 1, LARGEST_SHIFT])
def test_labels_that_are_off_by_up_to_an_eighth_do_not_matter(shift):
    cycle = cycle_of(*walk())
    assert cycle_distance(cycle, np.roll(cycle, shift, axis=0)).max() == 0.0


def test_labels_that_are_off_by_half_a_cycle_matter():
    cycle = cycle_of(*walk())
    assert cycle_distance(cycle, np.roll(cycle, NUM_PHASES // 2, axis=0)).mean() > 2 * SAME_WALK


def test_two_takes_of_a_style_are_nearer_than_two_styles():
    cycle, again, other = cycle_of(*walk()), cycle_of(*walk(seed=1)), cycle_of(*walk("old"))
    assert cycle_distance(cycle, again).mean() < SAME_WALK < cycle_distance(cycle, other).mean()


def test_less_than_a_cycle_is_refused():
    clip, labels = walk()
    short = replace(labels, labelled=np.arange(labels.num_frames) < 20)
    assert_refused(lambda: cycle_of(clip, short), place="phase", rule_mentions="a whole gait cycle")


def replace_frames(clip: MotionClip, start: int) -> MotionClip:
    return replace(clip, root_positions=clip.root_positions[start:], rotations=clip.rotations[start:])
