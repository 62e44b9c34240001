"""The shipped autoencoder and the experiment that trains it: bodies stay whole, and the run is complete."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.base_autoencoder import (
    GESTURE_ANGLES,
    Config,
    add_gestures,
    change_speed,
    main,
    pulses,
    smooth_noise,
    training_windows,
)
from pfnn_jax.io.files import read_json
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.autoencoder import config_of
from pfnn_jax.transfer.clip_rows import encode_clip
from pfnn_jax.transfer.config import AutoencoderConfig, AutoencoderTrainingConfig
from pfnn_jax.transfer.predict import reconstruct
from pfnn_jax.transfer.run import BASE_AUTOENCODER, list_transformations, load_transfer_run

SKELETON = synthetic_skeleton()

LARGEST = 2.5e6
"""Bytes that the shipped run may take in the package."""

WALK_ERROR = 0.03
"""Metres: mean reconstruction error of a procedural walk; 0.01 to 0.02 were measured."""

KNEE_BEHIND = 1e-9
"""Radians: rounding of a knee's rotation."""


@pytest.fixture(scope="module")
def walk():
    return synthesise("neutral", np.zeros(240), np.full(240, 1.2))[0]


def positions(clip):
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def test_the_shipped_run_is_the_papers_autoencoder_and_small():
    run = load_transfer_run(BASE_AUTOENCODER, "holden2017")
    assert config_of(run.autoencoder) == AutoencoderConfig()
    assert run.skeleton.names == SKELETON.names
    files = [path for path in BASE_AUTOENCODER.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < LARGEST
    assert list_transformations(BASE_AUTOENCODER) == ()
    assert not [path for path in files if b"/work" in path.read_bytes() or b"/tmp" in path.read_bytes()]


def test_the_shipped_autoencoder_reconstructs_a_walk(walk):
    run = load_transfer_run(BASE_AUTOENCODER)
    rows = encode_clip(walk, run.layout)
    apart = (reconstruct(run, rows).y - rows)[:, run.layout.joint_position].reshape(len(rows), -1, 3)
    assert run.layout.length_unit * np.linalg.norm(apart, axis=-1).mean() < WALK_ERROR


def test_its_card_says_what_it_was_trained_on():
    card = (BASE_AUTOENCODER / "CARD.md").read_text(encoding="utf-8")
    assert "CC BY 4.0" in card and "100STYLE" in card and "procedural" in card
    training = read_json(BASE_AUTOENCODER / "config.json", "")["training"]
    assert f"{training['windows']:,} windows" in card and f"{training['steps']:,} steps" in card


def test_gestures_keep_bones_and_the_path(walk):
    moved = add_gestures(walk, np.random.default_rng(0))
    bones = [
        np.linalg.norm(positions(clip)[:, 1:] - positions(clip)[:, SKELETON.parents[1:]], axis=-1)
        for clip in (walk, moved)
    ]
    np.testing.assert_allclose(*bones, atol=1e-9)
    np.testing.assert_array_equal(moved.root_positions[:, [0, 2]], walk.root_positions[:, [0, 2]])
    assert np.abs(positions(moved) - positions(walk)).max() > 0.1


def test_gestures_only_flex_knees(walk):
    still = replace(walk, rotations=np.broadcast_to([1.0, 0, 0, 0], walk.rotations.shape).copy())
    moved = add_gestures(still, np.random.default_rng(1))
    knees = moved.rotations[:, [SKELETON.names.index(f"{side}Leg") for side in ("Left", "Right")]]
    assert (knees[..., 1] >= -KNEE_BEHIND).all() and np.abs(knees[..., 2:]).max() <= KNEE_BEHIND


def test_every_part_that_gestures_move_is_a_joint():
    assert set(GESTURE_ANGLES) <= {name.removeprefix("Left").removeprefix("Right") for name in SKELETON.names}


def test_a_change_of_speed_changes_duration_and_nothing_else(walk):
    faster = change_speed(walk, 2.0)
    assert faster.fps == walk.fps and faster.num_frames == walk.num_frames // 2
    np.testing.assert_allclose(faster.root_positions, walk.root_positions[::2], atol=1e-9)


def test_noise_is_smooth_and_of_unit_variance():
    noise = smooth_noise(np.random.default_rng(0), (2000, 3), 0.2)
    np.testing.assert_allclose(noise.std(), 1.0, rtol=1e-6)
    assert np.diff(noise, axis=0).std() < 0.2
    raised = pulses(np.random.default_rng(0), 2000, 0.2)
    assert raised.min() == 0.0 < raised.max() <= 1.5


@pytest.mark.slow
def test_a_small_version_of_the_experiment_writes_a_run(tmp_path: Path):
    training = AutoencoderTrainingConfig(AutoencoderConfig(8, 5), steps=4, batch_size=2, steps_per_dispatch=2)
    config = Config(out=tmp_path, random_styles=1, seconds=4.0, training=training)
    main(config)
    run = load_transfer_run(tmp_path / "run", "holden2017")
    count = len(training_windows(config))
    assert run.config.training["windows"] == count
    assert f"{count:,} windows" in (tmp_path / "run" / "CARD.md").read_text(encoding="utf-8")
