"""Laws of rows: what they hold, how they decode, and that they match the released representation."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.motion.body_points import POINT_NAMES, POINT_PARENTS
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut, resample
from pfnn_jax.motion.ground import turn
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise
from pfnn_jax.transfer.clip_rows import (
    FEET,
    clip_points,
    clip_root,
    cut_windows,
    decode_rows,
    encode_clip,
    floor_height,
    pad_rows,
    prepare_clip,
)
from pfnn_jax.transfer.layout import CLIP_LAYOUTS, HOLDEN2016, HOLDEN2017, LAYOUT_FPS, ClipLayout
from tests.motion.retargeting import SOURCES, example, moved
from tests.raising import assert_refused

EXACT = 1e-9
"""Metres, radians: rounding of sums over hundreds of frames."""

LAYOUTS = list(CLIP_LAYOUTS.values())
GOLDEN = ("neutral_01_000", "angry_13_000", "depressed_18_000")


def walk(frames: int = 120, turning: float = 0.4) -> MotionClip:
    return synthesise("neutral", np.full(frames, turning), np.full(frames, 1.2))[0]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
def test_the_blocks_of_a_layout_cover_its_columns_once(layout: ClipLayout):
    blocks = [layout.joint_position, layout.root_velocity, layout.root_yaw_rate, layout.foot_contacts]
    columns = np.concatenate([np.arange(layout.size)[block] for block in blocks])
    assert columns.tolist() == list(range(layout.size))
    assert layout.size == {"holden2017": 66, "holden2016": 73}[layout.name]


def test_every_point_hangs_from_one_before_it():
    assert len(POINT_NAMES) == len(POINT_PARENTS) == 21
    assert all(above < point for point, above in enumerate(POINT_PARENTS))


@pytest.mark.parametrize("name", GOLDEN)
def test_rows_of_the_released_layout_match_the_golden_rows(mocap: Path, reference: Path, name: str):
    """They differ by the facing: the released code, and ours, makes the line across the body a unit vector before it is
    smoothed, and measures velocity in the next frame's root; the golden rows do neither, and turn the other way."""
    golden = np.load(reference / "holden2016" / "golden_dev.npz")[f"{name}_x"].T
    clip = resample(read_bvh(mocap / "xia-test" / f"{name}.bvh"), LAYOUT_FPS)
    rows = encode_clip(clip, HOLDEN2016)[: len(golden)]
    apart = np.abs(rows - golden)
    heights = slice(1, 66, 3)
    assert apart[:, heights].max() < 0.003  # units: 0.2 mm of floor in one clip; none in the others
    assert apart[:, HOLDEN2016.joint_position].max() < 0.11  # units of 5.6 cm: 0.01 radians of facing at arm's length
    assert apart[:, HOLDEN2016.root_velocity].max() < 0.012  # units per frame; strides are 1
    assert np.abs(rows + golden)[:, HOLDEN2016.root_yaw_rate].max() < 5e-4  # radians per frame
    assert apart[:, HOLDEN2016.foot_contacts].max() == 0.0


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
@pytest.mark.parametrize("name", SOURCES)
def test_decoding_gives_back_positions_and_path(mocap: Path, name: str, layout: ClipLayout):
    clip = resample(example(mocap, name), LAYOUT_FPS)
    positions, root = decode_rows(encode_clip(clip, layout), layout, clip_root(clip))
    positions[..., 1] += floor_height(clip)
    assert np.abs(positions - clip_points(clip)).max() < EXACT
    assert np.abs(root.positions - clip_root(clip).positions).max() < EXACT


@pytest.mark.parametrize("file", ["makehuman_walk_pairs", "rokoko_dance", "wham", "olaf_walk_24fps", "univrm"])
def test_clips_of_any_producer_decode(mocap: Path, file: str):
    clip = resample(read_bvh(mocap / "field" / f"{file}.bvh"), LAYOUT_FPS)
    positions, _ = decode_rows(encode_clip(clip, HOLDEN2017), HOLDEN2017, clip_root(clip))
    positions[..., 1] += floor_height(clip)
    assert np.abs(positions - clip_points(clip)).max() < EXACT


@settings(max_examples=10)
@given(st.floats(-3.0, 3.0), st.floats(-50.0, 50.0), st.floats(-1.0, 1.0), st.floats(-50.0, 50.0))
def test_rows_do_not_depend_on_where_the_clip_is(yaw: float, x: float, y: float, z: float):
    clip = walk()
    there = moved(clip, yaw, np.array([x, y, z]))
    assert np.abs(encode_clip(there, HOLDEN2016) - encode_clip(clip, HOLDEN2016)).max() < EXACT


def test_a_point_that_stays_in_the_world_has_no_velocity_in_rows():
    """The formula that the layout states: p' - R(r) p + v."""
    clip = walk()
    rows, world = encode_clip(clip, HOLDEN2017), clip_points(clip)
    local = rows[:, HOLDEN2017.joint_position].reshape(len(rows), 21, 3)
    rate, step = rows[:-1, HOLDEN2017.root_yaw_rate][:, 0], np.zeros((len(rows) - 1, 1, 3))
    step[:, 0, [0, 2]] = rows[:-1, HOLDEN2017.root_velocity]
    movement = local[1:] - turn(local[:-1], rate) + step
    assert np.abs(np.linalg.norm(movement, axis=-1) - np.linalg.norm(np.diff(world, axis=0), axis=-1)).max() < EXACT


def test_a_turn_to_the_left_has_a_negative_rate():
    rows = encode_clip(walk(turning=0.5), HOLDEN2017)
    assert (rows[:, HOLDEN2017.root_yaw_rate] < 0).all()


def test_the_lowest_foot_stands_on_the_floor():
    points = encode_clip(walk(), HOLDEN2017)[:, HOLDEN2017.joint_position].reshape(-1, 21, 3)
    assert points[:, FEET, 1].min() == 0.0


@settings(max_examples=20)
@given(st.integers(1, 300), st.integers(10, 120), st.integers(5, 60))
def test_windows_hold_every_row_in_order(frames: int, size: int, step: int):
    rows = np.repeat(np.arange(1.0, frames + 1)[:, None], HOLDEN2017.size, axis=1)
    windows = cut_windows(rows, HOLDEN2017, size, min(step, size))
    assert windows.shape[1:] == (size, HOLDEN2017.size)
    assert set(windows[..., 0].ravel()) == set(rows[:, 0])
    assert (np.diff(windows[..., 0], axis=1) >= 0).all()


def test_padding_holds_the_pose_and_stands_still():
    rows = encode_clip(walk(), HOLDEN2017)
    padded = pad_rows(rows, HOLDEN2017, 3, 2)
    assert np.array_equal(padded[3:-2], rows)
    assert np.array_equal(padded[:3, :63], np.repeat(rows[:1, :63], 3, axis=0))
    assert not padded[[0, 1, 2, -2, -1], 63:66].any()


def test_preparing_a_clip_takes_it_to_sixty_frames_per_second_on_the_run_skeleton(mocap: Path):
    clip, skeleton = cut(example(mocap, "bandai"), 0, 30), walk().skeleton
    prepared = prepare_clip(clip, skeleton)
    assert (prepared.fps, prepared.num_frames, prepared.skeleton) == (60.0, 59, skeleton)


def test_bad_clips_are_refused():
    clip = walk()
    assert_refused(lambda: encode_clip(replace(clip, fps=30.0), HOLDEN2017), place="frame rate", value=30.0)
    assert_refused(lambda: encode_clip(cut(clip, 0, 1), HOLDEN2017), place="frames", value=1)
    broken = replace(clip, root_positions=np.full_like(clip.root_positions, np.nan))
    assert_refused(lambda: encode_clip(broken, HOLDEN2017), place="positions")


@pytest.mark.parametrize("style", STYLES)
def test_synthetic_walkers_have_rows_that_decode(style: str):
    clip = synthesise(style, np.full(60, -0.2), np.full(60, 1.0))[0]
    positions, _ = decode_rows(encode_clip(clip, HOLDEN2016), HOLDEN2016, clip_root(clip))
    positions[..., 1] += floor_height(clip)
    assert np.abs(positions - clip_points(clip)).max() < EXACT
