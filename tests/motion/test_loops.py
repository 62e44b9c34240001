"""Cycles are repeated without a seam; other clips are left as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip, cut, move_clip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_axis_angle, quat_from_yaw, quat_multiply
from pfnn_jax.motion.loops import REPEATED_SECONDS, repeat_loop
from pfnn_jax.motion.skeleton import Skeleton

EXACT = 1e-9

SKELETON = Skeleton(("Hips", "Leg"), np.array([-1, 0]), np.array([[0.0, 0, 0], [0, -0.8, 0]]), (), np.arange(2))

FRAMES = 30
"""Of one cycle, at 30 frames per second."""


def cycle(frames, speed=0.0, yaw_rate=0.0):
    """Returns a clip in which a leg swings once a second while the body travels and turns."""
    t = np.arange(frames) / FRAMES
    rotations = np.zeros((frames, 2, 4))
    rotations[:, 1] = quat_from_axis_angle(np.array([1.0, 0, 0]), 0.5 * np.sin(2 * np.pi * t))
    rotations[:, 0] = quat_multiply(
        quat_from_yaw(yaw_rate * t), quat_from_axis_angle(np.array([0, 0, 1.0]), 0.1 * np.cos(2 * np.pi * t))
    )
    angle, radius = yaw_rate * t, speed / yaw_rate if yaw_rate else 0.0
    line = np.stack((np.zeros(frames), np.zeros(frames), speed * t), axis=1)
    arc = radius * np.stack((1 - np.cos(angle), np.zeros(frames), np.sin(angle)), axis=1)
    positions = (arc if yaw_rate else line) + [0.3, 0.9, 0.1]
    return MotionClip(SKELETON, 30.0, positions, rotations)


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize(("speed", "yaw_rate"), [(0.0, 0.0), (1.3, 0.0)])
def test_a_repeated_cycle_is_the_motion_that_goes_on(closed, speed, yaw_rate):
    """With and without its first pose again at its end."""
    clip, note = repeat_loop(cycle(FRAMES + closed, speed, yaw_rate))
    longer = cycle(clip.num_frames, speed, yaw_rate)
    assert clip.num_frames >= REPEATED_SECONDS * clip.fps and "1.00 s" in note
    assert np.allclose(clip.root_positions, longer.root_positions, atol=EXACT)
    assert np.allclose(np.abs(np.sum(clip.rotations * longer.rotations, axis=-1)), 1.0, atol=EXACT)


@pytest.mark.parametrize("closed", [True, False])
def test_the_signs_of_quaternions_do_not_count(closed):
    clip = cycle(FRAMES + closed, 1.3, 0.7)
    signs = np.ones((clip.num_frames, 1, 1))
    signs[-1] = -1.0
    expected, found = repeat_loop(clip)[0], repeat_loop(replace(clip, rotations=signs * clip.rotations))[0]
    assert np.allclose(found.root_positions, expected.root_positions, atol=EXACT)
    assert np.allclose(np.abs(np.sum(found.rotations * expected.rotations, axis=-1)), 1.0, atol=EXACT)


def test_a_cycle_along_an_arc_goes_on_along_it():
    clip, _ = repeat_loop(cycle(FRAMES + 1, 1.3, 0.7))
    longer = cycle(clip.num_frames, 1.3, 0.7)
    assert np.allclose(clip.root_positions, longer.root_positions, atol=EXACT)
    ours, theirs = (forward_kinematics(SKELETON, c.root_positions, c.rotations)[0] for c in (clip, longer))
    assert np.allclose(ours, theirs, atol=EXACT)


def test_repeating_commutes_with_moving_the_clip():
    moved = (quat_from_yaw(1.1), np.array([3.0, 0.0, -2.0]))
    clip = cycle(FRAMES + 1, 1.3)
    first, second = repeat_loop(move_clip(clip, *moved))[0], move_clip(repeat_loop(clip)[0], *moved)
    assert np.allclose(first.root_positions, second.root_positions, atol=EXACT)


@pytest.mark.parametrize("frames", [20, 45, 5, 300])
def test_other_clips_are_left_as_they_are(frames):
    """Part of a cycle, one and a half, too few frames, and a long recording."""
    clip = cycle(frames)
    assert repeat_loop(clip) == (clip, "")
    still = cut(cycle(60), 0, 60)
    still = MotionClip(SKELETON, 30.0, still.root_positions[:1].repeat(60, 0), still.rotations[:1].repeat(60, 0))
    assert repeat_loop(still) == (still, "")
