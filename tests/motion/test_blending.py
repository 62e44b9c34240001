"""Laws of blending two clips of one skeleton."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.motion.blending import PARTS, Parts, blend_clips, part_weights
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_axis_angle, quat_multiply, quat_normalise
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.motion.retargeting import SOURCES, angles, example
from tests.raising import assert_refused

ANGLE = 1e-5  # degrees
WHOLE_TURN_STEP = 45.0
"""Degrees that a part of a rotation turns in a frame near a whole turn, while the rotation turns by 16."""


def pair() -> tuple[MotionClip, MotionClip]:
    """Returns two walks, whose rotations are less than 120 degrees apart."""
    clips = [
        synthesise(style, np.full(30, 0.2), np.full(30, speed))[0] for style, speed in (("neutral", 1.3), ("old", 0.8))
    ]
    return clips[0], clips[1]


@pytest.mark.parametrize("parts", PARTS)
def test_weight_zero_is_the_content_to_the_last_bit(parts: Parts):
    content, result = pair()
    weights, root = part_weights(content.skeleton, parts)
    blended = blend_clips(content, result, 0.0 * weights, 0.0 * root)
    assert np.array_equal(blended.rotations, content.rotations)
    assert np.array_equal(blended.root_positions, content.root_positions)


def test_weight_one_is_the_result_to_the_last_bit():
    content, result = pair()
    blended = blend_clips(content, result, *part_weights(content.skeleton, "all"))
    assert np.array_equal(blended.rotations, result.rotations)
    assert np.array_equal(blended.root_positions, result.root_positions)


@given(st.floats(0.01, 1.5))
def test_the_rotation_between_both_is_scaled_by_the_weight(strength: float):
    content, result = pair()
    weights, root = part_weights(content.skeleton, "all")
    blended = blend_clips(content, result, strength * weights, strength * root)
    whole, part = angles(content.rotations, result.rotations), angles(content.rotations, blended.rotations)
    assert np.abs(part - strength * whole).max() < ANGLE


def test_a_part_of_a_growing_rotation_does_not_jump_at_half_a_turn():
    content, _ = pair()
    turn = np.deg2rad(np.linspace(0.0, 260.0, content.num_frames))
    turned = quat_multiply(content.rotations, quat_from_axis_angle(np.array([0.0, 0.0, 1.0]), turn)[:, None])
    half = blend_clips(content, replace(content, rotations=turned), np.full(content.skeleton.num_joints, 0.5), 0.0)
    between = quat_multiply(quat_conjugate(content.rotations), half.rotations)
    expected = quat_from_axis_angle(np.array([0.0, 0.0, 1.0]), turn / 2)[:, None]
    assert angles(between, np.broadcast_to(expected, between.shape)).max() < ANGLE


@pytest.mark.parametrize("strength", [0.25, 0.5, 0.75, 1.5])
def test_a_part_of_a_growing_rotation_does_not_jump_at_a_whole_turn(strength: float):
    content, _ = pair()
    content = replace(content, rotations=np.broadcast_to((1.0, 0.0, 0.0, 0.0), content.rotations.shape))
    half = np.deg2rad(np.linspace(0.0, 240.0, content.num_frames))
    past = np.stack([np.cos(half), np.full_like(half, 0.02), np.zeros_like(half), np.sin(half)], axis=-1)
    rotations = np.broadcast_to(quat_normalise(past)[:, None], content.rotations.shape)
    weights = np.full(content.skeleton.num_joints, strength)
    blended = blend_clips(content, replace(content, rotations=rotations), weights, 0.0).rotations
    assert angles(blended[1:], blended[:-1]).max() < WHOLE_TURN_STEP


def test_the_sign_of_a_quaternion_does_not_matter():
    content, result = pair()
    weights = np.full(content.skeleton.num_joints, 0.5)
    other = replace(result, rotations=-result.rotations)
    assert angles(
        blend_clips(content, result, weights, 0.5).rotations, blend_clips(content, other, weights, 0.5).rotations
    ).max() < ANGLE  # fmt: skip


@pytest.mark.parametrize("name", SOURCES)
def test_upper_and_lower_body_are_all_of_it(mocap: Path, name: str):
    skeleton = example(mocap, name).skeleton
    (every, root), (upper, still), (lower, moves), (arms, none) = (part_weights(skeleton, parts) for parts in PARTS)
    assert np.array_equal(upper + lower, every)
    assert (arms <= upper).all() and arms.any() and not arms.all()
    assert (root, still, moves, none) == (1.0, 0.0, 1.0, 0.0)


def test_fingers_belong_to_no_part_and_joints_between_parts_to_the_part_below(mocap: Path):
    skeleton = example(mocap, "xia").skeleton
    every = dict(zip(skeleton.names, part_weights(skeleton, "all")[0], strict=True))
    lower = dict(zip(skeleton.names, part_weights(skeleton, "lower")[0], strict=True))
    assert not any(every[name] for name in ("LThumb", "RThumb", "LeftFingerBase", "LeftHandIndex1"))
    assert lower["LHipJoint"] == lower["Hips"] == 1.0
    assert lower["LowerBack"] == 0.0


def test_an_unknown_part_is_refused():
    skeleton = pair()[0].skeleton
    assert_refused(lambda: part_weights(skeleton, "left"), place="parts", value="left")  # pyright: ignore[reportArgumentType]


def test_clips_of_different_length_are_refused():
    content, result = pair()
    shorter = replace(result, rotations=quat_normalise(result.rotations[:5]))
    with pytest.raises(ValueError, match="rotations"):
        blend_clips(content, shorter, np.ones(content.skeleton.num_joints), 1.0)
