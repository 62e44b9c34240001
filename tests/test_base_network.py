"""The experiment that trains the shipped network: random styles can walk, variants keep legs and names stay apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.base_network import (
    POSE_ANGLES,
    RANGES,
    STEP_LENGTH,
    Variation,
    random_style,
    random_variation,
    vary,
)
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_log
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise

ROUNDING = 1e-9
"""Of float64 kinematics, in metres and radians."""

SKELETON = synthetic_skeleton()


@pytest.fixture(scope="module")
def walk():
    return synthesise("neutral", np.zeros(120), np.full(120, 1.2))[0]


def positions(clip):
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


@pytest.mark.parametrize("number", range(0, 32, 5))
def test_random_styles_walk_with_steps_of_the_stated_length(number):
    style = random_style(number, seed=0)
    assert STEP_LENGTH[0] <= style.speed / (2 * style.cadence) <= STEP_LENGTH[1]
    clip, labels = synthesise(style, np.zeros(60), np.full(60, style.speed))
    assert np.isfinite(clip.rotations).all() and labels.labelled.all()


def test_random_styles_are_drawn_again_by_the_same_seed_only():
    assert random_style(3, seed=1) == random_style(3, seed=1) != random_style(3, seed=2)
    assert set(RANGES) <= set(vars(random_style(0, seed=0)))


def test_no_variation_is_the_identity(walk):
    still = np.zeros((SKELETON.num_joints, 4))
    still[:, 0] = 1.0
    same = vary(walk, Variation(still, np.ones(SKELETON.num_joints)))
    np.testing.assert_array_equal(same.rotations, walk.rotations)


def test_a_variation_moves_neither_hips_nor_ankles(walk):
    varied = vary(walk, random_variation(np.random.default_rng(0)))
    kept = [SKELETON.names.index(name) for name in ("Hips", "LeftUpLeg", "RightLeg", "LeftFoot", "RightFoot")]
    apart = np.abs(positions(varied) - positions(walk)).max(axis=(0, 2))
    assert apart[kept].max() <= ROUNDING < apart[SKELETON.names.index("LeftHand")]


def test_less_swing_brings_every_joint_nearer_to_its_mean(walk):
    still = np.zeros((SKELETON.num_joints, 4))
    still[:, 0] = 1.0
    held = vary(walk, Variation(still, np.zeros(SKELETON.num_joints)))
    np.testing.assert_allclose(np.ptp(held.rotations, axis=0), 0.0, atol=ROUNDING)


def test_variations_are_nearly_mirror_images_of_themselves():
    variation = random_variation(np.random.default_rng(3))
    at_rest = synthesise("neutral", np.zeros(2), np.zeros(2))[0]
    posed = replace(at_rest, root_positions=np.zeros((2, 3)), rotations=np.repeat(variation.turns[None], 2, axis=0))
    apart = quat_log(mirror_clip(posed).rotations[0]) - quat_log(posed.rotations[0])
    sided = [joint for joint, partner in enumerate(SKELETON.mirror) if joint != partner]
    angles = np.linalg.norm(quat_log(posed.rotations[0])[sided], axis=-1)
    assert np.linalg.norm(apart[sided], axis=-1).mean() < 0.6 * angles.mean()
    assert set(POSE_ANGLES) <= {name.removeprefix("Left").removeprefix("Right") for name in SKELETON.names}
