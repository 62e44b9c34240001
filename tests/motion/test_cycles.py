"""Laws of cycles that are cut out of a motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.cycles import MAX_TURN, cut_cycle, repeat_cycle
from pfnn_jax.motion.kinematics import forward_kinematics, quat_conjugate, quat_from_yaw, quat_multiply
from pfnn_jax.motion.root_motion import cycle_yaw, in_place, is_cycle
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.motion.retargeting import angles
from tests.raising import assert_refused

FPS = 60.0
EXACT = 1e-9  # metres and degrees, rounding
SINGLE = 2e-6  # of the length of a quaternion
PERIOD = 0.06
"""Relative: walks vary from step to step by their own noise."""

SEAM = 1.3
"""Largest step of a joint over the seam relative to the largest of any frame of the walk."""


def walk(turn_rate: float = 0.0, speed: float = 1.3, style: str = "neutral", seconds: float = 5.0) -> MotionClip:
    frames = round(seconds * FPS)
    return synthesise(style, np.full(frames, turn_rate), np.full(frames, speed))[0]


def period_of(style: str, turn_rate: float) -> float:
    """Returns seconds per gait cycle of a walk, from its exact phase."""
    frames = round(5 * FPS)
    _, labels = synthesise(style, np.full(frames, turn_rate), np.full(frames, 1.3))
    phase = np.unwrap(labels.phase)
    return 2 * np.pi * (frames - 1) / FPS / float(phase[-1] - phase[0])


@pytest.mark.parametrize("turn_rate", [0.0, 0.5, -0.8])
def test_the_last_pose_is_the_first_one_moved_along_the_ground(turn_rate: float):
    cycle = cut_cycle(walk(turn_rate))
    between = quat_multiply(cycle.rotations[-1, 0], quat_conjugate(cycle.rotations[0, 0]))
    yaw = 2 * np.arctan2(between[2], between[0])
    assert angles(between[None], quat_from_yaw(yaw)[None]).max() < 1e-5
    assert angles(cycle.rotations[-1, 1:], cycle.rotations[0, 1:]).max() < 1e-5
    assert abs(cycle.root_positions[-1, 1] - cycle.root_positions[0, 1]) < EXACT
    assert np.sign(yaw) == np.sign(turn_rate) or (turn_rate == 0.0 and abs(yaw) < EXACT)


@pytest.mark.parametrize("style", ["neutral", "old", "strutting"])
def test_one_cycle_is_one_period_of_the_gait(style: str):
    cycle = cut_cycle(walk(style=style))
    assert (cycle.num_frames - 1) / FPS == pytest.approx(period_of(style, 0.0), rel=PERIOD)


def test_a_cycle_played_twice_does_not_jump():
    clip = walk()
    cycle = cut_cycle(clip)
    shift = cycle.root_positions[-1] - cycle.root_positions[0]
    twice = replace(
        cycle,
        root_positions=np.concatenate([cycle.root_positions[:-1], cycle.root_positions + shift]),
        rotations=np.concatenate([cycle.rotations[:-1], cycle.rotations]),
    )
    steps = [
        np.linalg.norm(np.diff(forward_kinematics(c.skeleton, c.root_positions, c.rotations)[0], axis=0), axis=-1)
        for c in (twice, clip)
    ]
    assert steps[0].max() < SEAM * steps[1].max()


def test_standing_before_a_walk_is_no_cycle():
    clip = walk()
    still = 90
    standing = replace(
        clip,
        root_positions=np.concatenate([np.repeat(clip.root_positions[:1], still, 0), clip.root_positions]),
        rotations=np.concatenate([np.repeat(clip.rotations[:1], still, 0), clip.rotations]),
    )
    cycle = cut_cycle(standing)
    speed = np.linalg.norm(cycle.root_positions[-1] - cycle.root_positions[0]) / ((cycle.num_frames - 1) / FPS)
    assert speed == pytest.approx(1.3, rel=PERIOD)


@pytest.mark.parametrize("turn_rate", [2.0, -2.0])
def test_a_cycle_turns_by_less_than_half_a_circle(turn_rate: float):
    """A cycle of three gait cycles turns further; its ends alone would show a turn to the other side."""
    assert 3.0 * abs(turn_rate) > np.pi
    clip = walk(turn_rate, speed=0.8)
    cycle = cut_cycle(clip, seconds=(0.5, 3.0))
    assert 0.0 < np.sign(turn_rate) * cycle_yaw(cycle) <= MAX_TURN
    assert_refused(lambda: cut_cycle(clip, seconds=(2.0, 3.0)), place="cycle", rule_mentions="half a circle")


@pytest.mark.parametrize("turn_rate", [0.0, 0.5])
def test_a_repeated_cycle_begins_each_time_as_it_ends(turn_rate: float):
    cycle = cut_cycle(walk(turn_rate))
    steps, step = cycle.num_frames - 1, cycle.root_positions[-1] - cycle.root_positions[0]
    twice = repeat_cycle(cut(cycle, 0, steps), cycle_yaw(cycle), step, 2)
    assert np.abs(twice.root_positions[steps] - cycle.root_positions[-1]).max() < EXACT
    assert angles(twice.rotations[steps], cycle.rotations[-1]).max() < 1e-5


def test_a_cycle_in_single_precision_is_one():
    """Its quaternions are of unit length to the error of a network's forward kinematics."""
    clip = walk()
    cycle = cut_cycle(replace(clip, rotations=(1.0 - SINGLE) * clip.rotations))
    assert is_cycle(cycle)
    still = in_place(cycle).root_positions
    assert np.abs(still[-1] - still[0]).max() < EXACT


def test_motion_that_does_not_repeat_itself_is_refused():
    clip = walk()
    climbing = replace(clip, root_positions=clip.root_positions + np.linspace(0.0, 5.0, clip.num_frames)[:, None])
    assert_refused(lambda: cut_cycle(climbing), place="cycle", rule_mentions="repeat itself")
    assert_refused(lambda: cut_cycle(walk(seconds=0.4)), place="cycle", rule_mentions="longer")
