"""Features: golden frames of the authors' pipeline, laws of invariance and symmetry, and decoding back to a clip."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut, mirror_clip, resample
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.decode import clip_from_outputs
from pfnn_jax.motion.features.encode import Features, clip_features
from pfnn_jax.motion.features.layout import NOW, mason2018, pfnn2017
from pfnn_jax.motion.ground import facing_of, to_world, wrap_angle
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.labels.contacts import estimate_gait, flat_crouch, read_gait
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import PhaseLabels, cut_phase, mirror_phase, read_phase, resample_phase
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import mixed_schedule, synthesise
from pfnn_jax.motion.trajectory import root_motion
from tests.raising import assert_refused

GOLDEN = 1e-3  # standard deviations: the golden file's own rounding is float32
GOLDEN_UNIT = 0.05644  # metres per file unit: the golden frames were made with 5.644 cm, four digits of CMU's scale
MASKED = 1e6  # inputs that the authors disabled have stds far above this
STEM = "LocomotionFlat04_000"


@pytest.fixture(scope="module")
def flat(mocap: Path) -> tuple[MotionClip, PhaseLabels]:
    """The flat clip and its hand-made labels at 60 fps."""
    clip = read_bvh(mocap / "pfnn" / f"{STEM}.bvh", unit=GOLDEN_UNIT)
    labels = read_phase(mocap / "pfnn" / f"{STEM}.phase", clip.num_frames)
    clip = resample(clip, 60.0)
    return clip, resample_phase(labels, 120.0, 60.0, clip.num_frames)


@pytest.fixture(scope="module")
def golden_frames(flat) -> np.ndarray:
    """Frames of the golden file: every fifth from 60 on, of those whose phase is not exactly 0."""
    _, labels = flat
    return np.flatnonzero(labels.phase[60:] > 0)[::5][:200] + 60


@pytest.fixture(scope="module")
def golden_rows(flat, golden_frames, mocap) -> Features:
    clip, labels = flat
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    gait = read_gait(mocap / "pfnn" / f"{STEM}.gait")[::2]
    gait = flat_crouch(gait, positions[:, need_roles(clip.skeleton).head, 1])
    features = clip_features(clip, pfnn2017(), labels, gait)
    rows = np.searchsorted(features.frames, golden_frames)
    assert (features.frames[rows] == golden_frames).all()
    return Features(features.x[rows], features.y[rows], features.phase[rows], golden_frames)


def test_inputs_equal_the_golden_frames(golden_rows, reference):
    golden = np.load(reference / f"pfnn_real_{STEM}.npz")
    std = np.fromfile(reference / "pfnn" / "Xstd.bin", "<f4").astype(np.float64)
    used = std < MASKED
    assert used.sum() == 342 - 72
    off = np.abs(golden_rows.x - golden["x"])[:, used] / std[used]
    assert off.max() < GOLDEN
    np.testing.assert_allclose(golden_rows.phase, golden["phase"], atol=1e-6)


def test_outputs_equal_the_golden_frames_up_to_quaternion_sign(golden_rows, reference):
    golden = np.load(reference / f"pfnn_real_{STEM}.npz")["y_true"]
    mean, std = (np.fromfile(reference / "pfnn" / f"Y{n}.bin", "<f4").astype(np.float64) for n in ("mean", "std"))
    layout = pfnn2017()
    block = layout.output_slice("joint_rotation")
    y = golden_rows.y.astype(np.float64)
    y[:, block] = _nearest_pole(y[:, block], mean[block])
    assert (np.abs(y - golden) / std).max() < GOLDEN


def _nearest_pole(logs: np.ndarray, mean: np.ndarray) -> np.ndarray:
    """Returns the logarithm of q or -q, whichever is nearer to the mean, as the golden file does."""
    logs = logs.reshape(len(logs), -1, 3)
    half = np.linalg.norm(logs, axis=-1, keepdims=True)
    other = logs * (half - np.pi) / np.maximum(half, 1e-12)
    centre = mean.reshape(-1, 3)
    nearer = np.linalg.norm(logs - centre, axis=-1) <= np.linalg.norm(other - centre, axis=-1)
    return np.where(nearer[..., None], logs, other).reshape(len(logs), -1)


# laws

WORLD = 2e-5  # metres, radians per second: float32 of numbers up to ten, differentiated at 60 frames a second
BONES = 1e-5  # metres: float32 of positions, and of the rotations that follow them
POSE_LAYOUTS = [mason2018(21), pfnn2017(21)]


@pytest.fixture(scope="module")
def walk() -> tuple[MotionClip, PhaseLabels]:
    return synthesise("proud", *mixed_schedule("proud", 6, 2), seed=3)


def moved(clip: MotionClip, yaw: float, shift: tuple[float, float, float]) -> MotionClip:
    """The clip turned about the world's +Y and then moved."""
    turn = quat_from_yaw(np.array(yaw))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    return dataclasses.replace(
        clip, rotations=rotations, root_positions=quat_rotate(turn, clip.root_positions) + np.array(shift)
    )


@pytest.mark.parametrize("layout", POSE_LAYOUTS, ids=lambda layout: layout.name)
def test_features_are_invariant_under_rigid_motion_on_the_ground(walk, layout):
    clip, labels = walk
    there = clip_features(moved(clip, 2.1, (4.0, 0.0, -7.0)), layout, labels)
    here = clip_features(clip, layout, labels)
    np.testing.assert_allclose(there.x, here.x, atol=WORLD / layout.length_unit)
    np.testing.assert_allclose(there.y, here.y, atol=WORLD / layout.length_unit)
    assert (there.phase == here.phase).all()


@pytest.mark.parametrize("layout", POSE_LAYOUTS, ids=lambda layout: layout.name)
def test_joints_of_an_input_equal_those_of_the_previous_output(walk, layout):
    features = clip_features(walk[0], layout, walk[1])
    assert (np.diff(features.frames) == 1).all()
    for block in ("joint_position", "joint_velocity"):
        after, before = features.x[1:, layout.input_slice(block)], features.y[:-1, layout.output_slice(block)]
        np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize("layout", POSE_LAYOUTS, ids=lambda layout: layout.name)
def test_outputs_hold_the_trajectory_of_the_next_input(walk, layout):
    features = clip_features(walk[0], layout, walk[1])
    for block in ("position_x", "position_z", "direction_x", "direction_z"):
        future = features.x[1:, layout.input_slice(f"trajectory_{block}")][:, NOW:]
        np.testing.assert_array_equal(features.y[:-1, layout.output_slice(f"trajectory_{block}")], future)


def test_every_frame_but_the_ends_is_used(walk):
    features = clip_features(walk[0], mason2018(21), walk[1])
    assert (features.frames == np.arange(1, walk[0].num_frames - 1)).all()


def test_only_pairs_of_labelled_frames_are_used(walk):
    clip, labels = walk
    labelled = np.ones(clip.num_frames, bool)
    labelled[[100, 200, 201]] = False
    features = clip_features(clip, mason2018(21), dataclasses.replace(labels, labelled=labelled))
    missing = sorted(set(range(1, clip.num_frames - 1)) - set(features.frames.tolist()))
    assert missing == [99, 100, 199, 200, 201]


@pytest.mark.parametrize("layout", POSE_LAYOUTS, ids=lambda layout: layout.name)
def test_units_are_those_of_the_layout(walk, layout):
    clip, labels = walk
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root = root_motion(positions, need_roles(clip.skeleton), 60.0)
    y = clip_features(clip, layout, labels).y.astype(np.float64)
    speed = np.linalg.norm(y[:, layout.output_slice("root_velocity")], axis=-1) * layout.length_unit / layout.time_unit
    np.testing.assert_allclose(speed, np.linalg.norm(np.diff(root.positions, axis=0)[1:], axis=-1) * 60, atol=WORLD)
    turn = y[:, layout.output_slice("root_yaw_rate")][:, 0] * layout.yaw_unit / layout.time_unit
    np.testing.assert_allclose(turn, wrap_angle(np.diff(root.yaw))[1:] * 60, atol=WORLD)
    advance = y[:, layout.output_slice("phase_change")][:, 0] * layout.phase_unit / layout.time_unit
    np.testing.assert_allclose(advance, wrap_angle(np.diff(labels.phase))[1:] * 60, atol=WORLD)


def mirror_rows(rows: np.ndarray, blocks, mirror: np.ndarray) -> np.ndarray:
    """Returns the rows of the mirrored motion: x changes sign, joints and their partners are exchanged."""
    parts, start = [], 0
    for name, size in blocks:
        block = rows[:, start : start + size].copy()
        start += size
        if name.startswith("joint"):
            sign = [1.0, -1.0, -1.0] if name == "joint_rotation" else [-1.0, 1.0, 1.0]
            block = (block.reshape(len(rows), -1, 3)[:, mirror] * sign).reshape(len(rows), -1)
        elif name.endswith("_x") or name == "root_yaw_rate":
            block = -block
        elif name == "root_velocity":
            block = block * [-1.0, 1.0]
        elif name == "contacts":
            block = block[:, [2, 3, 0, 1]]
        parts.append(block)
    return np.concatenate(parts, axis=1)


@pytest.mark.parametrize("layout", POSE_LAYOUTS, ids=lambda layout: layout.name)
def test_features_of_the_mirrored_clip_are_the_mirrored_features(walk, layout):
    clip, labels = walk
    here = clip_features(clip, layout, labels)
    there = clip_features(mirror_clip(clip), layout, mirror_phase(labels))
    mirror = clip.skeleton.mirror
    np.testing.assert_allclose(there.x, mirror_rows(here.x, layout.inputs, mirror), atol=WORLD / layout.length_unit)
    np.testing.assert_allclose(there.y, mirror_rows(here.y, layout.outputs, mirror), atol=WORLD / layout.length_unit)
    np.testing.assert_allclose(wrap_angle(there.phase - here.phase - np.pi), 0.0, atol=1e-5)


# and back


@pytest.mark.parametrize("layout", POSE_LAYOUTS, ids=lambda layout: layout.name)
def test_decoding_outputs_restores_the_clip(walk, layout):
    clip, labels = walk
    features = clip_features(clip, layout, labels)
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root = root_motion(positions, need_roles(clip.skeleton), clip.fps)
    frames = features.frames
    back = clip_from_outputs(clip.skeleton, layout, features.y, root.positions[frames], root.yaw[frames])
    found, _ = forward_kinematics(back.skeleton, back.root_positions, back.rotations)
    error = found - positions[frames]
    # pfnn2017 measures height from a ground of its own: a constant
    error[..., 1] -= error[..., 1].mean() if layout.name == "pfnn2017" else 0.0
    assert np.abs(error).max() < BONES
    assert back.fps == 60.0 and back.skeleton is clip.skeleton


def test_decoding_outputs_restores_recorded_motion(mocap):
    clip = load_clip(list_clips(mocap / "bandai-namco-2")[200])
    layout = mason2018(21)
    features = clip_features(clip, layout)
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root, frames = root_motion(positions, need_roles(clip.skeleton), clip.fps), features.frames
    back = clip_from_outputs(clip.skeleton, layout, features.y, root.positions[frames], root.yaw[frames])
    found, _ = forward_kinematics(back.skeleton, back.root_positions, back.rotations)
    assert np.abs(found - positions[frames]).max() < BONES


def test_integrating_root_velocity_and_yaw_rate_gives_the_path(walk):
    clip, labels = walk
    layout = mason2018(21)
    features = clip_features(clip, layout, labels)
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root = root_motion(positions, need_roles(clip.skeleton), clip.fps)
    rate = features.y[:, layout.output_slice("root_yaw_rate")][:, 0].astype(np.float64) / 60
    yaw = root.yaw[1] + np.concatenate([[0.0], np.cumsum(rate)])
    steps = to_world(features.y[:, layout.output_slice("root_velocity")].astype(np.float64) / 60, facing_of(yaw[:-1]))
    path = root.positions[1] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    drift = 1e-4  # metres and radians over 6 s, from float32 rates
    np.testing.assert_allclose(path, root.positions[1:], atol=drift)
    np.testing.assert_allclose(wrap_angle(yaw - root.yaw[1:]), 0.0, atol=drift)


# gaits


def test_gait_files_merge_eight_columns_into_six(tmp_path):
    path = tmp_path / "a.gait"
    path.write_text("0 0 .25 .75 0 0 0 0\n0 0 0 0 .5 0 .5 1\n")
    np.testing.assert_allclose(read_gait(path, 2), [[0, 0, 1, 0, 0, 0], [0, 0, 0, 1, 0, 1]])
    with pytest.raises(InputError, match="lines: 2"):
        read_gait(path, 3)
    path.write_text("0 0 1\n")
    with pytest.raises(InputError, match="line 1: 3 values"):
        read_gait(path)


def test_crouching_on_flat_ground_is_measured_from_the_head():
    gait = flat_crouch(np.zeros((4, 6)), np.array([0.5, 0.8, 1.05, 1.6]))
    np.testing.assert_allclose(gait[:, 3], [1.0, 1.0, 0.5, 0.0])
    assert not gait[:, [0, 1, 2, 4, 5]].any()


@pytest.mark.parametrize(("speed", "gait"), [(0.0, 0), (1.3, 1), (3.5, 2)])
def test_gait_is_estimated_from_speed(speed, gait):
    path = np.arange(120)[:, None] * [0.0, speed / 60]
    np.testing.assert_allclose(estimate_gait(path, 0.85, 60.0), np.tile(np.eye(6)[gait], (120, 1)), atol=1e-9)


def test_gait_windows_repeat_the_outermost_labels_beyond_the_clip(walk):
    clip, labels = walk
    layout = pfnn2017(21)
    gait = np.zeros((clip.num_frames, 6))
    gait[:, 1] = np.arange(clip.num_frames)
    rows = clip_features(clip, layout, labels, gait).x[:, layout.input_slice("gait")].reshape(-1, 6, 12)
    wanted = np.clip(1 + np.arange(-60, 60, 10), 0, clip.num_frames - 1)
    np.testing.assert_array_equal(rows[0, 1], wanted)
    assert not rows[:, [0, 2, 3, 4, 5]].any()


# refusals


@pytest.mark.parametrize(
    ("change", "place", "value"),
    [
        (lambda c: dataclasses.replace(c, fps=30.0), "frame rate", "30 fps"),
        (lambda c: cut(c, 0, 29), "frames", 29),
        (lambda c: spoil(c, "root_positions"), "frame 7, root position", np.nan),
        (lambda c: spoil(c, "rotations"), "frame 7, rotation", np.nan),
    ],
)
def test_bad_clips_are_refused(walk, change, place, value):
    clip = change(dataclasses.replace(walk[0], source="a.bvh"))
    assert_refused(lambda: clip_features(clip, mason2018(21), walk[1]), file="a.bvh", place=place, value=value)


def spoil(clip: MotionClip, field: str) -> MotionClip:
    values = getattr(clip, field).copy()
    values[7] = np.nan
    return dataclasses.replace(clip, **{field: values})


def test_labels_gaits_and_joints_must_fit_the_clip(walk):
    clip, labels = walk
    layout, short = mason2018(21), cut_phase(labels, 0, 359)
    none = dataclasses.replace(labels, labelled=np.zeros(clip.num_frames, bool))
    gait = np.zeros((2, 6))
    assert_refused(lambda: clip_features(clip, mason2018(31), labels), place="skeleton", value="21 joints")
    assert_refused(lambda: clip_features(clip, layout, short), place="phase", value="359 frames")
    assert_refused(lambda: clip_features(clip, pfnn2017(21), labels, gait), place="gait", value="2 frames")
    assert isinstance(assert_refused(lambda: clip_features(clip, layout, none), place="phase"), NoGaitError)


def test_outputs_must_fit_the_layout(walk):
    clip, _ = walk
    layout = mason2018(21)
    y = np.zeros((3, layout.output_size))
    roots, yaw = np.zeros((3, 2)), np.zeros(3)
    narrow = lambda: clip_from_outputs(clip.skeleton, layout, y[:, 1:], roots, yaw)  # noqa: E731
    assert_refused(narrow, file="outputs", place="array", rule_mentions="280")
    y[1, layout.output_slice("joint_up")] = np.inf
    with pytest.raises(InputError, match="y row 1, joint_up: inf"):
        clip_from_outputs(clip.skeleton, layout, y, np.zeros((3, 2)), np.zeros(3))
