"""Foot contacts: correct on exact ground truth, invariant to size and floor height, plausible on real walks."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts, measured_leg_length, slow_feet
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.skeleton import SHIN, THIGH
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise

LEFT, RIGHT = slice(0, 2), slice(2, 4)


def contacts_of(clip: MotionClip, size: float = 1.0, floor: float = 0.0) -> np.ndarray:
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    positions = size * positions + [0.0, floor, 0.0]
    return foot_contacts(positions, need_roles(clip.skeleton), clip.fps)


@pytest.fixture(scope="module")
def walk() -> MotionClip:
    return synthesise("neutral", np.linspace(-0.5, 0.5, 300), np.full(300, 1.2), seed=2)[0]


def test_contacts_do_not_change_with_size_or_floor(walk):
    contacts = contacts_of(walk)
    assert contacts.any(axis=0).all() and not contacts.all(axis=0).any()
    assert (contacts_of(walk, size=2.0) == contacts).all()
    assert (contacts_of(walk, floor=1.5) == contacts).all()


@pytest.mark.parametrize("style", ["neutral", "angry", "old", "zombie"])
def test_each_foot_is_in_contact_during_its_half_of_the_phase(style):
    clip, labels = synthesise(style, np.zeros(400), np.full(400, STYLES[style].speed))
    contacts = contacts_of(clip)
    # the middle of a foot's support, clear of both double supports
    right, left = (np.abs(labels.phase - centre) < 0.4 for centre in (0.5 * np.pi, 1.5 * np.pi))
    assert contacts[right][:, RIGHT].mean() > 0.95 and contacts[right][:, LEFT].mean() < 0.05
    assert contacts[left][:, LEFT].mean() > 0.95 and contacts[left][:, RIGHT].mean() < 0.05


def test_measured_leg_length_is_that_of_a_nearly_straight_leg(walk):
    positions, _ = forward_kinematics(walk.skeleton, walk.root_positions, walk.rotations)
    assert 0.93 * (THIGH + SHIN) < measured_leg_length(positions, need_roles(walk.skeleton)) <= THIGH + SHIN + 1e-9


def test_slow_feet_depend_only_on_speed(walk):
    roles = need_roles(walk.skeleton)
    still = np.zeros((5, walk.skeleton.num_joints, 3))
    assert slow_feet(still + [0.0, 9.0, 0.0], roles, 60.0, 0.01).all()
    moving = still + np.arange(5)[:, None, None] * [0.02, 0.0, 0.0]
    assert not slow_feet(moving, roles, 60.0, 1.19).any()
    assert slow_feet(moving, roles, 60.0, 1.21).all()


@pytest.mark.parametrize(
    ("folder", "pick"), [("bandai-namco-2", slice(None, None, 60)), ("bandai-namco-1", slice(None, None, 12))]
)
def test_real_steps_resampled_from_30_fps_have_contacts_of_both_feet(mocap, folder, pick):
    for file in list_clips(mocap / folder)[pick]:
        share = contacts_of(load_clip(file)).mean(axis=0)  # a fast run has a long flight
        assert (0.08 < share).all() and (share < 0.9).all(), (file.path.name, share)


def test_contacts_at_two_frame_rates_agree(mocap):
    clip = load_clip(next(c for c in list_clips(mocap / "xia") if c.content == "walk"), fps=120.0)
    fast, slow = contacts_of(clip), contacts_of(resample(dataclasses.replace(clip), 60.0))
    assert (fast[::2] == slow).mean() > 0.97  # onsets may fall to either side of a frame
