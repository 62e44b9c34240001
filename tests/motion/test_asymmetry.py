"""Asymmetry of a clip: 0 for a symmetric gait, unchanged by mirroring, and measured on real clips of both kinds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.clip import cut, mirror_clip
from pfnn_jax.motion.datasets.labelled import load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.kinematics import quat_exp, quat_multiply
from pfnn_jax.motion.labels.asymmetry import MOST_SYMMETRIC, asymmetry, find_phase
from pfnn_jax.motion.labels.phase import cut_phase, mirror_phase
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise

ROUNDING = 1e-9


def walk(style="neutral", frames=300):
    return synthesise(style, np.zeros(frames), np.full(frames, STYLES[style].speed))


def raise_arm(clip):
    """Returns the clip with the left upper arm turned by 60°."""
    rotations = clip.rotations.copy()
    joint = clip.skeleton.roles.left_shoulder
    rotations[:, joint] = quat_multiply(rotations[:, joint], quat_exp(np.array([0.0, 0.0, np.pi / 6])))
    return replace(clip, rotations=rotations)


@pytest.mark.parametrize("style", STYLES)
def test_symmetric_walks_have_little_whatever_their_names(style):
    measured = asymmetry(*walk(style))
    assert measured is not None and measured < 0.1


def test_an_arm_held_up_is_asymmetric():
    clip, labels = walk()
    measured = asymmetry(raise_arm(clip), labels)
    assert measured is not None and measured > MOST_SYMMETRIC


def test_mirroring_does_not_change_it():
    clip, labels = walk()
    clip = raise_arm(clip)
    assert asymmetry(mirror_clip(clip), mirror_phase(labels)) == pytest.approx(asymmetry(clip, labels), rel=1e-6)


def test_place_and_direction_in_the_world_do_not_matter():
    clip, labels = walk()
    turn = quat_exp(np.array([0.0, 0.4, 0.0]))
    c, s = np.cos(0.8), np.sin(0.8)
    positions = clip.root_positions @ np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]]) + [3.0, 0.0, -2.0]
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    moved = replace(clip, root_positions=positions, rotations=rotations)
    assert asymmetry(moved, labels) == pytest.approx(asymmetry(clip, labels), abs=ROUNDING)


def test_less_than_a_cycle_and_still_clips_have_none():
    clip, labels = walk()
    assert asymmetry(cut(clip, 0, 20), cut_phase(labels, 0, 20)) is None
    still = replace(
        clip, root_positions=np.repeat(clip.root_positions[:1], 300, 0), rotations=np.repeat(clip.rotations[:1], 300, 0)
    )
    assert asymmetry(still, None) is None


@pytest.mark.parametrize(
    ("file", "symmetric"),
    [
        ("bandai-namco-1/dataset-1_walk_old_001.bvh", True),
        ("bandai-namco-1/dataset-1_walk_tired_002.bvh", True),
        ("bandai-namco-2/dataset-2_walk-turn-left_elderly_001.bvh", True),
        ("xia-test/old_01_000.bvh", True),
        ("bandai-namco-1/dataset-1_run_old_001.bvh", False),
        ("bandai-namco-1/dataset-1_walk-right_tired_001.bvh", False),
        ("xia-test/proud_18_000.bvh", False),
    ],
)
def test_real_clips_are_apart(mocap, file, symmetric):
    labelled = load_labelled(ClipFile(mocap / file, "any"), phase=False)
    world = labelled.world
    assert world is not None
    measured = asymmetry(world, find_phase(world, labelled.labels))
    assert measured is not None and (measured <= MOST_SYMMETRIC) == symmetric
