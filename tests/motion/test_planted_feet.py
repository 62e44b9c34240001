"""Laws of feet that stay in place while they are in contact."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.evaluation.metrics import contact_sliding, jitter
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.interpolation import interpolate, interpolate_rotations
from pfnn_jax.motion.kinematics import quat_from_axis_angle
from pfnn_jax.motion.labels.contacts import foot_contacts, foot_joints
from pfnn_jax.motion.labels.phase import runs_of
from pfnn_jax.motion.planted_feet import clean_contacts, plant_feet
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.motion.retargeting import angles, example, moved, world
from tests.raising import assert_refused

SLIDING = 0.04
"""Metres per second in contact after planting: feet come to rest within some frames. Real feet have 0.05 to 0.12."""
FLOATING = 0.01  # metres, mean height of feet in contact above where they should be
JERK = 1.35  # of the jerk before, which has feet that never come to rest
EXACT = 1e-9
SPLINE_ENDS = 1e-8
"""What a spline forgets of how values go on beyond their ends."""


def walk(frames: int = 180) -> MotionClip:
    return synthesise("neutral", np.full(frames, 0.0), np.full(frames, 1.3))[0]


def feet_of(clip: MotionClip) -> np.ndarray:
    return world(clip)[0][:, foot_joints(need_roles(clip.skeleton))]


def contacts_of(clip: MotionClip) -> np.ndarray:
    return foot_contacts(world(clip)[0], need_roles(clip.skeleton), clip.fps)


def skating(clip: MotionClip) -> MotionClip:
    """Returns the clip with a path stretched by a tenth, swaying and hovering by some centimetres."""
    time = np.arange(clip.num_frames) / clip.fps
    root = clip.root_positions * np.array([1.1, 1.0, 1.1])
    root[:, 0] += 0.02 * np.sin(4.0 * time)
    root[:, 1] += 0.03
    return replace(clip, root_positions=root)


def plant(clip: MotionClip, content: MotionClip) -> MotionClip:
    return plant_feet(clip, contacts_of(content), feet_of(content)[..., 1])


@pytest.mark.parametrize("name", ["procedural", "bandai", "100style", "xia"])
def test_feet_in_contact_do_not_slide_and_stand_on_the_ground(mocap: Path, name: str):
    content = example(mocap, name)
    slid, contacts = skating(content), contacts_of(content)
    held = plant(slid, content)
    before, after = (contact_sliding(feet_of(clip), contacts, content.fps) for clip in (slid, held))
    assert after < min(SLIDING, before / 4)
    apart = (feet_of(held) - feet_of(content))[..., 1][contacts]
    assert abs(apart.mean()) < FLOATING


@pytest.mark.parametrize("name", ["procedural", "bandai", "100style", "xia"])
def test_planting_makes_no_jerk(mocap: Path, name: str):
    content = example(mocap, name)
    before, after = (
        jitter(world(clip)[0], content.fps) for clip in (skating(content), plant(skating(content), content))
    )
    assert after < 1.3 * before


def test_bones_and_the_upper_body_remain():
    content = walk()
    slid = skating(content)
    held = plant(slid, content)
    legs = [j for j, name in enumerate(content.skeleton.names) if name.endswith(("UpLeg", "Leg", "Foot"))]
    others = [j for j in range(content.skeleton.num_joints) if j not in legs]
    assert np.array_equal(held.rotations[:, others], slid.rotations[:, others])
    assert np.array_equal(held.root_positions[:, [0, 2]], slid.root_positions[:, [0, 2]])


def test_feet_that_stand_still_are_left_alone():
    content = walk(60)
    still = replace(
        content,
        root_positions=np.repeat(content.root_positions[:1], 60, 0),
        rotations=np.repeat(content.rotations[:1], 60, 0),
    )
    held = plant_feet(still, np.ones((60, 4), bool), feet_of(still)[..., 1])
    assert np.abs(world(held)[0] - world(still)[0]).max() < 1e-6


def test_without_contacts_nothing_changes_above_the_ground():
    content = walk(60)
    held = plant_feet(content, np.zeros((60, 4), bool), np.full((60, 4), -1.0))
    assert np.abs(world(held)[0] - world(content)[0]).max() < 1e-6


def test_planting_does_not_depend_on_where_the_clip_is():
    content = walk(90)
    there = [moved(clip, 1.1, np.array([3.0, 0.0, -4.0])) for clip in (skating(content), content)]
    held, apart = plant(skating(content), content), plant(*there)
    assert np.abs(world(apart)[0] - world(moved(held, 1.1, np.array([3.0, 0.0, -4.0])))[0]).max() < 1e-6


def test_a_body_without_toes_is_held_by_its_ankles(mocap: Path):
    clip = read_bvh(mocap / "field" / "univrm.bvh")
    clip = cut(clip, 0, min(clip.num_frames, 200))
    held = plant(skating(clip), clip)
    assert np.isfinite(held.rotations).all()


def test_contacts_of_another_length_are_refused():
    content = walk(20)
    assert_refused(lambda: plant_feet(content, np.ones((19, 4), bool), np.zeros((20, 4))), place="contacts")
    assert_refused(lambda: plant_feet(content, np.ones((20, 4), bool), np.zeros((20, 2))), place="heights")


def test_short_contacts_and_gaps_are_noise():
    contacts = np.zeros((40, 1), bool)
    contacts[5:20], contacts[10], contacts[30] = True, False, True
    assert runs_of(clean_contacts(contacts, 60.0)[:, 0]) == [(5, 20)]


def test_interpolation_gives_back_whole_frames_and_cubics():
    time = np.arange(20.0)
    values = np.stack([np.sin(0.3 * time), 0.1 * time], axis=1)
    assert np.abs(interpolate(values, time) - values).max() < EXACT
    between = np.arange(3.0, 16.0, 0.25)
    assert np.abs(interpolate(values, between) - np.stack([np.sin(0.3 * between), 0.1 * between], axis=1)).max() < 1e-3


@pytest.mark.parametrize("frames", [2, 3, 20, 60])
def test_interpolation_keeps_the_velocity_at_both_ends(frames: int):
    line = 0.1 * np.arange(float(frames))
    between = np.arange(0.0, frames - 1, 0.25)
    assert np.abs(interpolate(line, between) - 0.1 * between).max() < SPLINE_ENDS


def test_interpolated_rotations_lie_on_the_way():
    time, axis = np.arange(20.0), np.array([0.0, 0.6, 0.8])
    rotations = quat_from_axis_angle(axis, 0.2 * time)[:, None] * np.where(time % 2, -1.0, 1.0)[:, None, None]
    between = np.arange(3.0, 16.0, 0.5)
    assert (
        angles(interpolate_rotations(rotations, between)[:, 0], quat_from_axis_angle(axis, 0.2 * between)).max() < 0.05
    )
