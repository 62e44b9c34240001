"""Laws of joint rotations from positions of a body's points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.motion.body_points import POINT_NAMES, find_body_points
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.joint_rotations import angle_between, best_rotation, rotations_from_positions, steady_arcs
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_normalise, quat_rotate
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.trajectory import root_motion
from pfnn_jax.motion.world_motion import world_motion
from tests.motion.retargeting import SOURCES, angles, example, world

EXACT = 1e-9  # metres
SAME_ROTATION = 1e-4
"""Degrees: what float64 loses in the logarithm of rotations near the identity."""
FROM_T_POSE = 0.03
"""Metres by which a walk's points are missed from a T-pose: where neither clavicles nor necks show their share."""
NOISE = 0.02  # metres
OVERSTRETCHED_STEP = 20.0
"""Degrees that a joint turns in a frame while an elbow bends to one side and then to the other within half a second."""
OPPOSITE_STEP = 10.0
"""Degrees that a rotation turns in a frame in which its vector, near the opposite of where it was, turns by 2.7."""
MOST_BENT = 90.0
"""Degrees by which a wrist bends at most where a network folds it back."""
LARGEST_STEP = 75.0
"""Degrees that a joint turns in a frame of positions with `NOISE`, which turn short bones by 30. A flip turns 180."""


def points_of(clip: MotionClip) -> np.ndarray:
    return find_body_points(clip.skeleton).positions(*world(clip))


def solve(clip: MotionClip, positions: np.ndarray) -> MotionClip:
    return rotations_from_positions(clip.skeleton, find_body_points(clip.skeleton), positions, clip)


def walk(frames: int = 60, style: str = "neutral") -> MotionClip:
    return synthesise(style, np.full(frames, 0.3), np.full(frames, 1.3))[0]


def yaw_of_facing(clip: MotionClip) -> np.ndarray:
    motion = world_motion(clip)
    return root_motion(motion.positions, motion.roles, clip.fps).yaw


def in_t_pose(clip: MotionClip) -> MotionClip:
    """Returns a clip of a T-pose that faces as the clip does."""
    rotations = np.zeros_like(clip.rotations)
    rotations[..., 0] = 1.0
    rotations[:, 0] = quat_from_yaw(yaw_of_facing(clip))
    return replace(clip, rotations=rotations)


def bone_lengths(clip: MotionClip) -> np.ndarray:
    positions, _ = world(clip)
    return np.linalg.norm(positions[:, 1:] - positions[:, clip.skeleton.parents[1:]], axis=-1)


@pytest.mark.parametrize("name", SOURCES)
def test_a_clips_own_positions_give_back_the_clip(mocap: Path, name: str):
    clip = example(mocap, name)
    solved = solve(clip, points_of(clip))
    assert np.abs(world(solved)[0] - world(clip)[0]).max() < EXACT
    assert angles(solved.rotations, clip.rotations).max() < SAME_ROTATION


@pytest.mark.parametrize("file", ["makehuman_walk_pairs", "rokoko_dance", "wham", "olaf_walk_24fps", "cgspeed_daz"])
def test_own_positions_give_back_the_clip_on_skeletons_of_other_producers(mocap: Path, file: str):
    clip = read_bvh(mocap / "field" / f"{file}.bvh")
    clip = cut(clip, 0, min(clip.num_frames, 120))
    assert np.abs(world(solve(clip, points_of(clip)))[0] - world(clip)[0]).max() < EXACT


@pytest.mark.parametrize("style", ["neutral", "old", "zombie"])
def test_positions_are_reached_from_a_t_pose(style: str):
    clip = walk(style=style)
    reached = points_of(solve(in_t_pose(clip), points_of(clip)))
    assert np.linalg.norm(reached - points_of(clip), axis=-1).max() < FROM_T_POSE


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.5))
def test_bones_stay_rigid_and_values_finite_for_any_positions(seed: int, noise: float):
    clip = walk(20)
    hostile = points_of(clip) + np.random.default_rng(seed).normal(scale=noise, size=(20, 21, 3))
    solved = solve(clip, hostile)
    assert np.abs(bone_lengths(solved) - np.linalg.norm(clip.skeleton.offsets[1:], axis=-1)).max() < EXACT
    assert np.abs(np.linalg.norm(solved.rotations, axis=-1) - 1.0).max() < EXACT


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_noise_flips_no_joint(seed: int):
    clip = walk(40)
    noise = np.random.default_rng(seed).normal(size=(40, 21, 3))
    noise *= NOISE / np.linalg.norm(noise, axis=-1, keepdims=True)
    solved = solve(clip, points_of(clip) + noise)
    assert angles(solved.rotations[1:], solved.rotations[:-1]).max() < LARGEST_STEP


def test_a_knee_bent_backwards_is_bent_forwards():
    clip = walk(10)
    positions = points_of(clip)
    hip, knee, ankle = (POINT_NAMES.index(f"left_{part}") for part in ("thigh", "shin", "foot"))
    left = positions[:, hip] - positions[:, POINT_NAMES.index("right_thigh")]
    forward = np.cross(positions[:, ankle] - positions[:, hip], left)
    forward /= np.linalg.norm(forward, axis=-1, keepdims=True)
    middle = (positions[:, hip] + positions[:, ankle]) / 2
    positions[:, knee] = middle - 0.15 * forward
    solved = points_of(solve(clip, positions))
    assert (np.sum((solved[:, knee] - (solved[:, hip] + solved[:, ankle]) / 2) * forward, axis=-1) > 0.05).all()


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_elbow_that_bends_to_either_side_does_not_flip_its_arm(side: str):
    clip = walk(60)
    positions = points_of(clip)
    shoulder, elbow, hand = (POINT_NAMES.index(f"{side}_{part}") for part in ("upper_arm", "lower_arm", "hand"))
    forward = quat_rotate(quat_from_yaw(yaw_of_facing(clip)), np.array([0.0, 0.0, 1.0]))
    bend = 0.15 * np.cos(2 * np.pi * np.arange(60) / 60)[:, None] * np.array([0.0, 1.0, 0.0])
    positions[:, elbow] = positions[:, shoulder] + 0.28 * forward
    positions[:, hand] = positions[:, elbow] + 0.24 * forward + bend
    positions[:, hand + 1] = positions[:, hand] + 0.1 * forward
    solved = solve(clip, positions)
    assert angles(solved.rotations[1:], solved.rotations[:-1]).max() < OVERSTRETCHED_STEP


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_hand_that_folds_back_onto_its_forearm_does_not_flip(side: str):
    clip = walk(60)
    positions = points_of(clip)
    elbow, hand = (POINT_NAMES.index(f"{side}_{part}") for part in ("lower_arm", "hand"))
    along = positions[:, hand] - positions[:, elbow]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    across = np.cross(along, np.array([0.0, 0.0, 1.0]))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    bend = np.deg2rad(np.linspace(0.0, 360.0, 60))[:, None]
    positions[:, hand + 1] = positions[:, hand] + 0.15 * (np.cos(bend) * along + np.sin(bend) * across)
    solved = solve(clip, positions)
    points = points_of(solved)
    bones = np.diff(points[:, [elbow, hand, hand + 1]], axis=1)
    assert np.rad2deg(angle_between(bones[:, 0], bones[:, 1])).max() < MOST_BENT
    assert angles(solved.rotations[1:], solved.rotations[:-1]).max() < OPPOSITE_STEP


def test_joints_without_points_keep_their_rotation(mocap: Path):
    clip = example(mocap, "mixamo")
    noisy = points_of(clip) + np.random.default_rng(0).normal(scale=0.02, size=(clip.num_frames, 21, 3))
    fingers = [j for j, name in enumerate(clip.skeleton.names) if "Thumb" in name]
    assert fingers
    assert np.allclose(solve(clip, noisy).rotations[:, fingers], clip.rotations[:, fingers], atol=1e-12)


@settings(max_examples=20)
@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_the_best_rotation_of_rotated_vectors_is_that_rotation(seed: int, count: int):
    random = np.random.default_rng(seed)
    rotation, vectors = quat_normalise(random.normal(size=(4, 4))), random.normal(size=(4, count, 3))
    turned = quat_rotate(rotation[:, None], vectors)
    assert np.abs(quat_rotate(best_rotation(vectors, turned)[:, None], vectors) - turned).max() < 1e-7


@pytest.mark.parametrize("begin, end", [(0, 60), (0, 30), (30, 60), (25, 35)])
def test_a_vector_turned_past_its_opposite_does_not_flip(begin: int, end: int):
    angle = np.deg2rad(np.linspace(100.0, 260.0, 60))[begin:end]
    have = np.broadcast_to((0.0, 1.0, 0.0), (len(angle), 3))
    want = np.stack([np.sin(angle), np.cos(angle), np.full(len(angle), 0.02)], axis=-1)
    arcs = steady_arcs(have, want)
    assert np.abs(quat_rotate(arcs, have) - want / np.linalg.norm(want, axis=-1, keepdims=True)).max() < EXACT
    assert angles(arcs[1:], arcs[:-1]).max() < OPPOSITE_STEP
