"""The experiment that trains the shipped network: random styles can walk, variants keep legs and names stay apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from experiments.base_network import (
    CAPTURED,
    POSE_ANGLES,
    RANGES,
    STEP_LENGTH,
    Config,
    Variation,
    random_style,
    random_variation,
    ship,
    train,
    vary,
)
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.motion.kinematics import forward_kinematics, quat_log
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.styles import PRETRAINING_STYLES
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_clips
from pfnn_jax.run import load_run
from pfnn_jax.training.config import RESTYLED_FEW_SHOT
from pfnn_jax.training.restyling import load_differences
from pfnn_jax.workflows.base import BASE_NETWORK
from pfnn_jax.workflows.learn import default_config
from pfnn_jax.workflows.pretrain import dataset_differences

ROUNDING = 1e-9
"""Of float64 kinematics, in metres and radians."""

SKELETON = synthetic_skeleton()


MOST_DIFFERENCES = 1_500_000
"""Bytes of differences in the package."""


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    """Returns the shipped folder of a tiny network whose captured clips are procedural ones of another name."""
    config = Config(tmp_path_factory.mktemp("base"), Path("captured"), 1, 1, seconds=5.0, hidden=8, steps=2)
    captured = [replace(clip, clip=replace(clip.clip, style=CAPTURED[0])) for clip in synthetic_clips("old", 5.0)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("experiments.base_network.captured_clips", lambda folder: captured)
        return config, ship(train(config), config)


@pytest.mark.slow
def test_shipped_differences_are_of_procedural_styles_alone(shipped):
    config, out = shipped
    dataset = load_dataset(config.out / "data")
    procedural = [style for style in dataset.styles if not style.startswith("100style")]
    assert len(procedural) == len(PRETRAINING_STYLES) + 1 < len(dataset.styles)
    found, wanted = load_differences(out, dataset.layout), dataset_differences(dataset, config.seed, procedural)
    for one, other in zip(jax.tree.leaves(found), jax.tree.leaves(wanted), strict=True):
        np.testing.assert_array_equal(one, np.asarray(other, np.float16))


@pytest.mark.slow
def test_shipped_run_holds_the_named_styles_and_no_state_of_training(shipped):
    config, out = shipped
    assert set(load_run(out).config.styles) == {*PRETRAINING_STYLES, CAPTURED[0]}
    assert not (out / "train_state").exists() and "procedural walkers alone" in (out / "CARD.md").read_text()


def test_packaged_base_network_learns_from_restyled_turns_and_stays_small():
    run = load_run(BASE_NETWORK)
    assert default_config(run) == replace(RESTYLED_FEW_SHOT, rank=run.config.adapter.rank)
    size = sum(path.stat().st_size for path in (BASE_NETWORK / "differences").rglob("*") if path.is_file())
    assert size <= MOST_DIFFERENCES


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
