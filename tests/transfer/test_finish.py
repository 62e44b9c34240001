"""Laws of finishing: from rows back to the content's own skeleton."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.evaluation.metrics import contact_sliding, jitter
from pfnn_jax.motion.blending import PARTS, Parts, part_weights
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.labels.contacts import foot_contacts, foot_joints
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.clip_rows import encode_clip, prepare_clip
from pfnn_jax.transfer.finish import MAX_JITTER, finish_clip
from pfnn_jax.transfer.layout import HOLDEN2016, HOLDEN2017
from tests.motion.retargeting import SOURCES, angles, example, moved, world
from tests.raising import assert_refused

EXACT = 1e-9  # metres
HELD = 0.02
"""Metres by which holding the feet of a real clip moves its joints on average: captured feet slide and hover."""
TURNED = 1.0  # degrees, likewise
RIGID = 0.08
"""Metres by which points miss rows that raise arms by more than their clavicles allow."""
SKELETON = synthetic_skeleton()


def rows_of(clip: MotionClip) -> np.ndarray:
    return encode_clip(prepare_clip(clip, SKELETON), HOLDEN2017)


def finish(rows: np.ndarray, clip: MotionClip, **settings) -> MotionClip:
    return finish_clip(rows, clip, SKELETON, HOLDEN2017, **settings)


def restyled(clip: MotionClip) -> np.ndarray:
    """Returns rows of a clip whose arms are raised and which is bent and slower."""
    rows = rows_of(clip)
    time = np.arange(len(rows)) / 60.0
    points = rows[:, :63].reshape(-1, 21, 3)
    points[:, 9:13, 2] += np.array([0.02, 0.05, 0.1, 0.12])
    points[:, 13:, 1] += (0.05 + 0.05 * np.sin(5.0 * time))[:, None]
    points[:, 13:, 2] += 0.08
    points[:, :, 1] -= 0.02
    rows[:, HOLDEN2017.root_velocity] *= 0.9
    return rows


@pytest.fixture(scope="module")
def content() -> MotionClip:
    return synthesise("neutral", np.full(150, 0.2), np.full(150, 1.3))[0]


@pytest.mark.parametrize("name", SOURCES)
def test_a_clips_own_rows_give_back_the_clip(mocap: Path, name: str):
    clip = example(mocap, name)
    finished = finish(rows_of(clip), clip, foot_ik=False)
    assert np.abs(world(finished)[0] - world(clip)[0]).max() < EXACT
    assert (finished.fps, finished.num_frames, finished.skeleton) == (clip.fps, clip.num_frames, clip.skeleton)


@pytest.mark.parametrize("name", SOURCES)
def test_holding_feet_hardly_changes_a_real_clip(mocap: Path, name: str):
    clip = example(mocap, name)
    finished = finish(rows_of(clip), clip)
    assert np.linalg.norm(world(finished)[0] - world(clip)[0], axis=-1).mean() < HELD
    assert angles(finished.rotations, clip.rotations).mean() < TURNED


@pytest.mark.parametrize("file", ["makehuman_walk_pairs", "rokoko_dance", "wham", "olaf_walk_24fps", "cgspeed_daz"])
def test_clips_of_any_producer_come_back(mocap: Path, file: str):
    clip = read_bvh(mocap / "field" / f"{file}.bvh")
    clip = cut(clip, 0, min(clip.num_frames, 200))
    finished = finish(rows_of(clip), clip, foot_ik=False)
    assert np.abs(world(finished)[0] - world(clip)[0]).max() < EXACT


def test_strength_zero_is_the_content_to_the_last_bit(content: MotionClip):
    finished = finish(restyled(content), content, strength=0.0)
    assert np.array_equal(finished.rotations, content.rotations)
    assert np.array_equal(finished.root_positions, content.root_positions)


@settings(max_examples=5, deadline=None)
@given(strength=st.floats(0.1, 1.5))
def test_strength_scales_every_rotation(strength: float):
    clip = synthesise("neutral", np.full(60, 0.2), np.full(60, 1.3))[0]
    rows = restyled(clip)
    one, other = (finish(rows, clip, strength=s, foot_ik=False) for s in (1.0, strength))
    whole, part = angles(clip.rotations, one.rotations), angles(clip.rotations, other.rotations)
    assert np.abs(part - strength * whole).max() < 1e-4


def test_beyond_one_the_path_stays_that_of_one(content: MotionClip):
    rows = restyled(content)
    one, more = (finish(rows, content, strength=s, foot_ik=False) for s in (1.0, 1.5))
    assert np.array_equal(one.root_positions, more.root_positions)


@pytest.mark.parametrize("parts", PARTS)
def test_other_parts_keep_the_contents_rotations(content: MotionClip, parts: Parts):
    finished = finish(restyled(content), content, parts=parts)
    weights, root = part_weights(content.skeleton, parts)
    assert np.array_equal(finished.rotations[:, weights == 0], content.rotations[:, weights == 0])
    assert angles(finished.rotations, content.rotations)[:, weights == 1].max() > 5.0
    assert root == 1.0 or np.array_equal(finished.root_positions, content.root_positions)


def test_fingers_and_joints_of_no_part_keep_the_contents_rotations(mocap: Path):
    clip = example(mocap, "xia")
    finished = finish(restyled(clip), clip)
    thumb = clip.skeleton.names.index("LThumb")
    assert np.array_equal(finished.rotations[:, thumb], clip.rotations[:, thumb])


@pytest.mark.parametrize("name", ["procedural", "bandai", "100style", "xia"])
def test_feet_do_not_slide_and_nothing_jerks(mocap: Path, name: str):
    clip = example(mocap, name)
    finished = finish(restyled(clip), clip)
    roles = need_roles(clip.skeleton)
    contacts = foot_contacts(world(clip)[0], roles, clip.fps)
    sliding = [contact_sliding(world(c)[0][:, foot_joints(roles)], contacts, clip.fps) for c in (clip, finished)]
    assert sliding[1] < max(sliding[0], 0.04)
    assert jitter(world(finished)[0], clip.fps) < 1.2 * jitter(world(clip)[0], clip.fps)


def test_noise_of_a_network_is_smoothed_away(content: MotionClip):
    rows = rows_of(content)
    noise = np.random.default_rng(0).normal(scale=0.004, size=rows[:, :63].shape)
    rows[:, :63] += noise
    finished = finish(rows, content, foot_ik=False)
    bound = max(MAX_JITTER, 1.2) * jitter(world(content)[0], content.fps)
    assert jitter(world(finished)[0], content.fps) < bound


def test_a_smooth_change_is_not_smoothed(content: MotionClip):
    """Its points on the run's skeleton are those of the rows."""
    rows = rows_of(content)
    sway = gaussian_filter(np.random.default_rng(0).normal(size=len(rows)), 20.0)
    rows[:, 3 * 17 + 1 : 63 : 3] += 0.3 * sway[:, None]
    finished = finish(rows, content, foot_ik=False)
    apart = encode_clip(prepare_clip(finished, SKELETON), HOLDEN2017)[:, :63] - rows[:, :63]
    assert np.abs(apart).max() < RIGID


def test_the_result_does_not_depend_on_where_the_content_is(content: MotionClip):
    shift = np.array([2.0, 0.5, -3.0])
    here, there = finish(restyled(content), content), finish(restyled(content), moved(content, 0.7, shift))
    assert np.abs(world(there)[0] - world(moved(here, 0.7, shift))[0]).max() < 1e-6


def test_more_rows_than_frames_are_cut_off(content: MotionClip):
    rows = restyled(content)
    longer = np.concatenate([rows, rows[-1:] + 1.0])
    assert np.array_equal(finish(longer, content).rotations, finish(rows, content).rotations)


def test_rows_of_the_released_layout_finish_alike(content: MotionClip):
    rows = encode_clip(prepare_clip(content, SKELETON), HOLDEN2016)
    finished = finish_clip(rows, content, SKELETON, HOLDEN2016, foot_ik=False)
    assert np.abs(world(finished)[0] - world(content)[0]).max() < EXACT


def test_a_body_without_arms_is_finished(mocap: Path):
    clip = read_bvh(mocap / "field" / "slimevr_head_root.bvh")
    finished = finish(restyled(clip), clip)
    assert np.isfinite(finished.rotations).all() and finished.num_frames == clip.num_frames


@pytest.mark.parametrize("frames", [2, 3, 5])
def test_the_shortest_clips_are_finished(content: MotionClip, frames: int):
    clip = cut(content, 0, frames)
    assert np.isfinite(finish(restyled(clip), clip).rotations).all()


def test_bad_input_is_refused(content: MotionClip):
    rows = rows_of(content)
    assert_refused(lambda: finish(rows, content, strength=1.6), place="strength", value=1.6)
    assert_refused(lambda: finish(rows, content, strength=-0.1), place="strength", value=-0.1)
    assert_refused(lambda: finish(rows, content, parts="head"), place="parts", value="head")
    assert_refused(lambda: finish(rows[:-1], content), place="rows", rule_mentions="at least")
    broken = rows.copy()
    broken[3, 4] = np.nan
    assert_refused(lambda: finish(broken, content), place="rows", rule_mentions="finite")
    assert finish(rows, replace(content, root_positions=content.root_positions)).num_frames == content.num_frames
