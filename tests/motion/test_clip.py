"""Laws of cutting, resampling and mirroring whole clips."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut, mirror_clip, resample, swap_sides
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_yaw, quat_multiply, quat_rotate, quat_to_matrix
from pfnn_jax.motion.skeleton import need_roles
from tests.motion.skeletons import MIRROR, body_clip
from tests.raising import assert_refused

FLOAT64 = 1e-12  # sign changes and one slerp
BONES = 0.001  # metres: left and right bones of the Bandai-Namco skeleton differ by this much
REFLECTION = np.array([-1.0, 1.0, 1.0])


def positions(clip: MotionClip) -> np.ndarray:
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def same_motion(a: MotionClip, b: MotionClip, tolerance: float = FLOAT64) -> None:
    np.testing.assert_allclose(a.root_positions, b.root_positions, atol=tolerance)
    alike = np.abs(np.sum(a.rotations * b.rotations, axis=-1))
    np.testing.assert_allclose(alike, 1.0, atol=tolerance)


def test_cut_keeps_the_given_frames():
    clip = body_clip(frames=9)
    part = cut(clip, 2, 5)
    assert part.num_frames == 3
    np.testing.assert_array_equal(part.rotations, clip.rotations[2:5])


@pytest.mark.parametrize(("start", "stop"), [(-1, 3), (3, 3), (4, 2), (0, 10), (20, 30)])
def test_a_cut_outside_the_clip_is_refused(start, stop):
    clip = replace(body_clip(frames=9), source="take.bvh")
    assert_refused(lambda: cut(clip, start, stop), file="take.bvh", place="cut", value=f"frames {start} to {stop}")


def test_resampling_to_the_same_rate_changes_nothing():
    clip = body_clip(frames=9, fps=60.0)
    np.testing.assert_array_equal(resample(clip, 60.0).rotations, clip.rotations)
    np.testing.assert_array_equal(resample(clip, 60.0).root_positions, clip.root_positions)


@pytest.mark.parametrize("frames", [1, 2, 9, 10])
def test_halving_the_rate_keeps_every_second_frame(frames):
    clip = body_clip(frames=frames, fps=120.0)
    half = resample(clip, 60.0)
    assert half.fps == 60.0
    np.testing.assert_array_equal(half.rotations, clip.rotations[::2])
    np.testing.assert_array_equal(half.root_positions, clip.root_positions[::2])


def test_doubling_the_rate_keeps_every_frame_and_adds_midpoints():
    clip = body_clip(frames=6, fps=30.0)
    clip.rotations[:, 0] = quat_from_yaw(0.4 * np.arange(6.0))
    twice = resample(clip, 60.0)
    assert twice.num_frames == 11
    np.testing.assert_array_equal(twice.rotations[::2], clip.rotations)
    middles = (clip.root_positions[1:] + clip.root_positions[:-1]) / 2
    np.testing.assert_allclose(twice.root_positions[1::2], middles, atol=FLOAT64)
    np.testing.assert_allclose(twice.rotations[1::2, 0], quat_from_yaw(0.2 + 0.4 * np.arange(5.0)), atol=FLOAT64)


@settings(max_examples=50, deadline=None)
@given(frames=st.integers(1, 200), fps=st.floats(5.0, 240.0), new=st.floats(5.0, 240.0))
def test_any_rate_spans_the_clip_with_unit_rotations(frames, fps, new):
    clip = body_clip(frames=frames, fps=fps)
    out = resample(clip, new)
    lost = (frames - 1) / fps - (out.num_frames - 1) / new
    assert -1e-6 < lost < 1 / new + 1e-6  # seconds at the end, less than one new frame
    np.testing.assert_allclose(np.linalg.norm(out.rotations, axis=-1), 1.0, atol=FLOAT64)
    np.testing.assert_array_equal(out.rotations[0], clip.rotations[0])


@pytest.mark.parametrize("fps", [0.0, -30.0, np.nan, np.inf])
def test_a_frame_rate_must_be_positive_and_finite(fps):
    assert_refused(lambda: resample(body_clip(), fps), place="frame rate", value=fps)


def test_mirroring_twice_is_identity():
    clip = body_clip(frames=9)
    back = mirror_clip(mirror_clip(clip))
    same_motion(back, clip)
    assert (back.mirrored, back.content) == (False, "walk-turn-left")


def test_mirroring_reflects_positions_of_a_symmetric_skeleton():
    clip = body_clip(frames=9)
    mirrored = mirror_clip(clip)
    assert mirrored.mirrored and mirrored.content == "walk-turn-right"
    np.testing.assert_allclose(positions(mirrored), (positions(clip) * REFLECTION)[:, MIRROR], atol=FLOAT64)
    np.testing.assert_allclose(np.linalg.norm(mirrored.rotations, axis=-1), 1.0, atol=FLOAT64)


def test_mirroring_turns_facing_and_keeps_up():
    clip = body_clip(frames=4, spread=0.1)
    for axis, kept in (((0.0, 0.0, 1.0), REFLECTION), ((0.0, 1.0, 0.0), REFLECTION), ((1.0, 0.0, 0.0), -REFLECTION)):
        expected = quat_rotate(clip.rotations[:, 0], np.array(axis)) * kept
        np.testing.assert_allclose(
            quat_rotate(mirror_clip(clip).rotations[:, 0], np.array(axis)), expected, atol=FLOAT64
        )


def test_mirroring_keeps_the_skeletons_bone_lengths():
    clip = body_clip(frames=9)
    offsets = clip.skeleton.offsets.copy()
    offsets[13, 1] -= 0.02  # a left thigh 2 cm longer
    clip = replace(clip, skeleton=replace(clip.skeleton, offsets=offsets))
    mirrored = mirror_clip(clip)
    same_motion(mirror_clip(mirrored), clip)
    missed = np.abs(positions(mirrored) - (positions(clip) * REFLECTION)[:, MIRROR])
    assert missed.max() < 0.02 + FLOAT64
    np.testing.assert_array_equal(mirrored.skeleton.offsets, offsets)


def reframed(clip: MotionClip, seed: int) -> MotionClip:
    """Returns the same motion on joints with rotated frames, each pair of sides mirrored by its own reflection."""
    random = np.random.default_rng(seed)
    joints, parents = clip.skeleton.num_joints, clip.skeleton.parents
    quarter = np.array([[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5], [0.5, -0.5, -0.5, -0.5]])
    turn = quarter[random.integers(0, 3, joints)]
    for joint in range(joints):  # partners: the reflected frame, then a half turn about one of its axes
        partner = clip.skeleton.mirror[joint]
        if partner > joint:
            turn[partner] = quat_multiply(turn[joint] * [1, 1, -1, -1], np.eye(4)[random.integers(0, 4)])
    conjugate = turn * [1, -1, -1, -1]
    outer = np.where(parents[:, None] >= 0, conjugate[parents], [1.0, 0.0, 0.0, 0.0])
    rotations = quat_multiply(quat_multiply(outer, clip.rotations), turn)
    skeleton = replace(clip.skeleton, offsets=quat_rotate(outer, clip.skeleton.offsets))
    return replace(clip, skeleton=skeleton, rotations=rotations)


@pytest.mark.parametrize("seed", range(6))
def test_mirroring_does_not_depend_on_the_joints_frames(seed):
    """Bones along any local axis, as in the Bandai-Namco files; each frame's own reflection is found."""
    clip = body_clip(frames=40, spread=0.2)
    turned = reframed(clip, seed)
    np.testing.assert_allclose(positions(turned), positions(clip), atol=FLOAT64)
    expected = reframed(mirror_clip(clip), seed)
    same_motion(mirror_clip(turned), expected)


@pytest.mark.parametrize("content", ["bandai-namco-2/dataset-2_walk-turn-left_active_003.bvh"])
def test_mirroring_a_recorded_turn_reverses_it(mocap, content):
    clip = read_bvh(mocap / content)
    mirrored = mirror_clip(clip)
    expected = (positions(clip) * REFLECTION)[:, clip.skeleton.mirror]
    np.testing.assert_allclose(positions(mirrored), expected, atol=BONES)
    # a mirrored pose resembles the clip's own poses: no joint's frame is turned round
    mean, mean_mirrored = (quat_to_matrix(c.rotations[:, 1:]).mean(axis=0) for c in (clip, mirrored))
    assert np.all(np.einsum("jab,jab->j", mean, mean_mirrored) > 1.0)  # a trace of 3 is equality, -1 a half turn
    roles = need_roles(clip.skeleton)
    assert np.all(np.isfinite(positions(mirrored)[:, roles.head]))


def test_sides_in_a_content_are_words():
    assert swap_sides("walk-turn-left") == "walk-turn-right"
    assert swap_sides("right-left") == "left-right"
    assert swap_sides("walk") == "walk"
