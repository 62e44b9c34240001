"""Joints in the world: computed once, and mirrored without forward kinematics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, mirror_clip, resample
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import layout_for
from pfnn_jax.motion.hands import extend_hands
from pfnn_jax.motion.kinematics import forward_kinematics, quat_to_matrix
from pfnn_jax.motion.labels.phase import label_phase
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

EXACT = 1e-11  # float64: chains of 15 rotations at positions of up to 100 m
FLOAT32 = 2e-5  # rows in layout units: a last digit of float32 at values of up to 100 cm


@pytest.fixture(scope="module")
def walk() -> MotionClip:
    return synthesise("proud", np.full(240, 0.4), np.full(240, 1.2), seed=3)[0]


def assert_same(found: WorldMotion, wanted: WorldMotion) -> None:
    np.testing.assert_allclose(found.positions, wanted.positions, atol=EXACT)
    np.testing.assert_allclose(quat_to_matrix(found.rotations), quat_to_matrix(wanted.rotations), atol=EXACT)


def lopsided(clip: MotionClip) -> MotionClip:
    """The clip on a skeleton whose left and right bones differ by a few per cent."""
    offsets = clip.skeleton.offsets * np.random.default_rng(0).uniform(0.97, 1.03, clip.skeleton.offsets.shape)
    return replace(clip, skeleton=replace(clip.skeleton, offsets=offsets))


def test_world_motion_is_forward_kinematics(walk):
    motion = world_motion(walk)
    positions, rotations = forward_kinematics(walk.skeleton, walk.root_positions, walk.rotations)
    np.testing.assert_array_equal(motion.positions, positions)
    np.testing.assert_array_equal(motion.rotations, rotations)
    assert world_motion(motion) is motion


def test_mirrored_motion_is_the_motion_of_the_mirrored_clip(walk):
    for clip in (walk, lopsided(walk), extend_hands(walk)):
        assert_same(world_motion(clip).mirror(), world_motion(mirror_clip(clip)))


@pytest.mark.parametrize("corpus", ["100style", "bandai-namco-1", "xia"])
def test_mirrored_motion_is_the_motion_of_the_mirrored_clip_on_recorded_skeletons(corpus, mocap):
    for file in list_clips(mocap / corpus)[:2]:
        clip = load_clip(file)
        assert_same(world_motion(clip).mirror(), world_motion(mirror_clip(clip)))


def test_mirroring_twice_is_identity(walk):
    motion = world_motion(walk)
    assert_same(motion.mirror().mirror(), motion)


def test_mirroring_needs_no_partners_that_share_parents(walk):
    """Exchanging partners of one foot alone breaks the symmetry of the tree; the clip still has a mirror image."""
    skeleton = walk.skeleton
    mirror = skeleton.mirror.copy()
    left, right = skeleton.names.index("LeftLeg"), skeleton.names.index("RightLeg")
    mirror[[left, right]] = left, right
    clip = replace(walk, skeleton=replace(skeleton, mirror=mirror))
    assert_same(world_motion(clip).mirror(), world_motion(mirror_clip(clip)))


@pytest.mark.parametrize("name", ["mason2018", "pfnn2017", "mason2022", "mason2022_mann", "mason2022_pfnn"])
def test_features_of_a_clip_are_those_of_its_world_motion(walk, name):
    clip = extend_hands(walk)
    motion, layout = world_motion(clip), layout_for(name, clip.skeleton)
    for of_clip, of_motion in ((clip, motion), (mirror_clip(clip), motion.mirror())):
        wanted, found = clip_features(of_clip, layout), clip_features(of_motion, layout)
        np.testing.assert_allclose(found.x, wanted.x, atol=FLOAT32)
        np.testing.assert_allclose(found.y, wanted.y, atol=FLOAT32)
        np.testing.assert_array_equal(found.frames, wanted.frames)


def test_labels_of_a_clip_are_those_of_its_world_motion(walk):
    np.testing.assert_array_equal(label_phase(world_motion(walk)).phase, label_phase(walk).phase)


def test_a_skeleton_without_roles_is_refused(walk):
    bare = replace(walk, skeleton=replace(walk.skeleton, roles=None), source="a.bvh")
    with pytest.raises(InputError) as caught:
        _ = world_motion(resample(bare, 30.0)).roles
    assert (str(caught.value.file), caught.value.place) == ("a.bvh", "skeleton")
