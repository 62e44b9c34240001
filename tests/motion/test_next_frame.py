"""Rows of the next frame in the current root: against positions in the world, laws of invariance and symmetry, and the
way back to a clip."""

from __future__ import annotations

import dataclasses
from functools import partial

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip, cut, mirror_clip
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.decode import clip_from_outputs, root_steps
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import NOW, FrameLayout, layout_for, mason2018, mason2022
from pfnn_jax.motion.ground import facing_of, to_local, to_world, wrap_angle
from pfnn_jax.motion.hands import extend_hands
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.labels.local_phase import clip_local_phases, mirror_local_phases, toe_contacts
from pfnn_jax.motion.labels.phase import PhaseLabels, mirror_phase
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import mixed_schedule, synthesise
from pfnn_jax.motion.trajectory import Root, hips_root, layout_root
from tests.raising import assert_refused

WORLD = 2e-5  # metres, metres per second: float32 of numbers up to ten, differentiated at 60 frames a second
BONES = 1e-5  # metres: float32 of positions, and of the rotations that follow them
NAMES = ("mason2022", "mason2022_mann", "mason2022_pfnn")
KINDS = ("position", "direction")

Walk = tuple[MotionClip, PhaseLabels, np.ndarray]


@pytest.fixture(scope="module")
def walk() -> Walk:
    """A walk with turns, its labels, and its local phases."""
    clip, labels = synthesise("proud", *mixed_schedule("proud", 6, 2), seed=3)
    clip = extend_hands(clip)
    return clip, labels, clip_local_phases(clip)


def rows_of(walk: Walk, name: str, clip: MotionClip | None = None):
    clip = clip or walk[0]
    layout = layout_for(name, clip.skeleton)
    return layout, clip_features(clip, layout, walk[1], local_phases=walk[2])


def seen(clip: MotionClip) -> tuple[np.ndarray, np.ndarray, Root]:
    """Positions and rotations in the world, and the root."""
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    return positions, rotations, hips_root(positions, need_roles(clip.skeleton))


def joints(layout: FrameLayout, rows: np.ndarray, block: str, side: str) -> np.ndarray:
    columns = layout.input_slice(block) if side == "x" else layout.output_slice(block)
    return rows[:, columns].reshape(len(rows), -1, 3).astype(np.float64)


@pytest.mark.parametrize("name", NAMES)
def test_joints_of_this_and_the_next_frame_are_relative_to_this_root(walk, name):
    clip = walk[0]
    layout, rows = rows_of(walk, name)
    positions, rotations, root = seen(clip)
    steps = np.diff(positions, axis=0) * 60.0
    for side, later in (("x", 0), ("y", 1)):
        i, f = rows.frames, rows.frames + later
        offset = positions[f].copy()
        offset[..., [0, 2]] -= root.positions[i][:, None]
        wanted = {
            "joint_position": offset,
            "joint_velocity": steps[f - 1],  # from the frame before
            "joint_forward": quat_rotate(rotations[f], [0.0, 0.0, 1.0]),
            "joint_up": quat_rotate(rotations[f], [0.0, 1.0, 0.0]),
        }
        for block, world in wanted.items():
            found = joints(layout, getattr(rows, side), block, side)
            np.testing.assert_allclose(found, to_local(world, root.facing[i]), atol=WORLD, err_msg=f"{side} {block}")


def test_trajectories_are_every_tenth_frame_around_this_frame_and_the_next(walk):
    clip = walk[0]
    layout, rows = rows_of(walk, "mason2022")
    root = seen(clip)[2]
    inside = (rows.frames >= 60) & (rows.frames + 51 < clip.num_frames)
    i = rows.frames[inside]
    for matrix, find, frames in (
        (rows.x, layout.input_slice, i[:, None] + np.arange(-60, 60, 10)),
        (rows.y, layout.output_slice, i[:, None] + 1 + np.arange(0, 60, 10)),
    ):
        wanted = {"position": root.positions[frames] - root.positions[i][:, None], "direction": root.directions[frames]}
        for kind in KINDS:
            found = np.stack([matrix[inside][:, find(f"trajectory_{kind}_{axis}")] for axis in "xz"], axis=-1)
            np.testing.assert_allclose(found, to_local(wanted[kind], root.facing[i]), atol=WORLD)
    now = [rows.x[:, layout.input_slice(f"trajectory_{kind}_{axis}")][:, NOW] for kind in KINDS for axis in "xz"]
    np.testing.assert_allclose(np.stack(now, axis=-1) - [0.0, 0.0, 0.0, 1.0], 0.0, atol=1e-7)


def test_phases_contacts_and_their_changes(walk):
    clip, labels, phases = walk
    flat, contacts = phases.reshape(len(phases), 8), toe_contacts(clip)
    layout, rows = rows_of(walk, "mason2022")
    i = rows.frames
    assert (i == np.arange(1, clip.num_frames - 1)).all()
    np.testing.assert_array_equal(rows.phase, flat[i].astype(np.float32))
    np.testing.assert_array_equal(rows.y[:, layout.output_slice("local_phase")], flat[i + 1].astype(np.float32))
    change = (flat[i + 1] - flat[i]).astype(np.float32)
    np.testing.assert_array_equal(rows.y[:, layout.output_slice("local_phase_change")], change)
    np.testing.assert_array_equal(rows.y[:, layout.output_slice("foot_contacts")], contacts[i + 1])

    layout, rows = rows_of(walk, "mason2022_pfnn")
    rate = wrap_angle(labels.phase[rows.frames + 1] - labels.phase[rows.frames]) * 60.0  # radians per second
    np.testing.assert_allclose(rows.y[:, layout.output_slice("phase_change")][:, 0], rate, atol=WORLD)
    np.testing.assert_array_equal(rows.phase, labels.phase[rows.frames].astype(np.float32))

    layout, rows = rows_of(walk, "mason2022_mann")
    velocities = joints(layout, rows.x, "joint_velocity", "x")[:, list(layout.ends)]
    np.testing.assert_array_equal(rows.phase, velocities.reshape(len(rows.x), 12))


def test_right_foot_comes_first_among_contacts(walk):
    layout, rows = rows_of(walk, "mason2022")
    contacts = rows.y[:, layout.output_slice("foot_contacts")] > 0.5
    speed = np.linalg.norm(joints(layout, rows.y, "joint_velocity", "y"), axis=-1)
    for column, foot in enumerate((layout.ends[3], layout.ends[2])):
        stands = contacts[:, column]
        assert 0.1 < stands.mean() < 0.9 and speed[stands, foot].mean() < 0.2 * speed[~stands, foot].mean()


def test_local_phases_are_computed_if_not_given(walk):
    layout, rows = rows_of(walk, "mason2022")
    np.testing.assert_array_equal(clip_features(walk[0], layout).phase, rows.phase)


def test_layouts_with_a_global_phase_use_only_labelled_frames(walk):
    clip, labels, _ = walk
    labelled = np.ones(clip.num_frames, bool)
    labelled[[100, 200, 201]] = False
    labels = dataclasses.replace(labels, labelled=labelled)
    frames = rows_of((clip, labels, walk[2]), "mason2022_pfnn")[1].frames
    assert sorted(set(range(1, clip.num_frames - 1)) - set(frames.tolist())) == [99, 100, 199, 200, 201]
    assert len(rows_of((clip, labels, walk[2]), "mason2022")[1].frames) == clip.num_frames - 2


# laws


@pytest.mark.parametrize("name", NAMES)
def test_features_are_invariant_under_rigid_motion_on_the_ground(walk, name):
    clip = walk[0]
    turn = quat_from_yaw(np.array(2.1))
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    positions = quat_rotate(turn, clip.root_positions) + np.array([4.0, 0.0, -7.0])
    moved = dataclasses.replace(clip, rotations=rotations, root_positions=positions)
    layout, here = rows_of(walk, name)
    there = clip_features(moved, layout, walk[1])  # local phases are computed again
    for side in ("x", "y", "phase"):
        np.testing.assert_allclose(getattr(there, side), getattr(here, side), atol=WORLD)


def mirror_columns(layout: FrameLayout, rows: np.ndarray, side: str, mirror: np.ndarray) -> np.ndarray:
    """Returns the rows of the mirrored motion: x changes sign, joints and their partners are exchanged."""
    found = np.empty_like(rows)
    for block in layout.input_blocks if side == "x" else layout.output_blocks:
        columns = layout.input_slice(block) if side == "x" else layout.output_slice(block)
        values = rows[:, columns]
        if block.startswith("joint"):
            values = (values.reshape(len(rows), -1, 3)[:, mirror] * [-1, 1, 1]).reshape(len(rows), -1)
        elif block.startswith("local_phase"):
            values = mirror_local_phases(values.reshape(len(rows), 4, 2)).reshape(len(rows), 8)
        elif block == "foot_contacts":
            values = values[:, ::-1]
        elif block.endswith("_x"):
            values = -values
        found[:, columns] = values
    return found


@pytest.mark.parametrize("name", NAMES)
def test_features_of_the_mirrored_clip_are_the_mirrored_features(walk, name):
    clip, labels, phases = walk
    layout, here = rows_of(walk, name)
    there = rows_of((mirror_clip(clip), mirror_phase(labels), mirror_local_phases(phases)), name)[1]
    for side in ("x", "y"):
        mirrored = mirror_columns(layout, getattr(here, side), side, clip.skeleton.mirror)
        np.testing.assert_allclose(getattr(there, side), mirrored, atol=WORLD)


# and back


def assert_comes_back(clip: MotionClip, layout: FrameLayout, labels: PhaseLabels | None = None) -> None:
    rows = clip_features(clip, layout, labels)
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root, i = layout_root(positions, need_roles(clip.skeleton), layout), rows.frames
    back = clip_from_outputs(clip.skeleton, layout, rows.y, root.positions[i], root.yaw[i])
    found, _ = forward_kinematics(back.skeleton, back.root_positions, back.rotations)
    assert np.abs(found - positions[i + layout.next_frame]).max() < BONES


@pytest.mark.parametrize("name", (*NAMES, "mason2018"))
def test_decoding_outputs_restores_the_clip(walk, name):
    assert_comes_back(walk[0], layout_for(name, walk[0].skeleton), walk[1])


def test_decoding_outputs_restores_recorded_motion(mocap):
    clip = extend_hands(load_clip(list_clips(mocap / "bandai-namco-2")[200]))
    assert clip.skeleton.num_joints == 21
    for name in NAMES[:2]:
        assert_comes_back(clip, layout_for(name, clip.skeleton))
    style100 = next(c for c in list_clips(mocap / "100style") if c.path.stem == "Neutral_FW")
    clip = extend_hands(load_clip(style100))
    assert clip.skeleton.num_joints == 25
    assert_comes_back(clip, mason2022())


@pytest.mark.parametrize("name", (*NAMES, "mason2018", "pfnn2017"))
def test_integrating_root_steps_gives_the_path(walk, name):
    clip = walk[0]
    layout, rows = rows_of(walk, name)
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root = layout_root(positions, need_roles(clip.skeleton), layout)
    velocity, rate = root_steps(layout, rows.y.astype(np.float64))
    yaw = root.yaw[1] + np.concatenate([[0.0], np.cumsum(rate / 60)])
    steps = to_world(velocity / 60, facing_of(yaw[:-1]))
    path = root.positions[1] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    drift = 1e-4  # metres and radians over 6 s, from float32 rates
    np.testing.assert_allclose(path, root.positions[1:], atol=drift)
    np.testing.assert_allclose(wrap_angle(yaw - root.yaw[1:]), 0.0, atol=drift)


# refusals


def test_phases_and_end_effectors_must_fit_the_clip(walk):
    clip, _, phases = walk
    layout = layout_for("mason2022", clip.skeleton)
    short = phases[1:]
    assert_refused(
        lambda: clip_features(clip, layout, local_phases=short), place="local phases", value="shape (359, 4, 2)"
    )
    for ends in ((), (1, 2, 3, 4)):
        other = dataclasses.replace(layout_for("mason2022_mann", clip.skeleton), ends=ends)
        assert_refused(
            partial(clip_features, clip, other), place="layout mason2022_mann", value=f"end effectors {ends}"
        )
    named = dataclasses.replace(clip, source="a.bvh")
    assert_refused(lambda: clip_features(named, mason2022()), file="a.bvh", place="skeleton", rule_mentions="25")
    assert_refused(lambda: clip_features(cut(clip, 0, 29), layout), place="frames", value=29, rule_mentions="30")


def test_a_standing_clip_has_finite_rows(walk):
    clip = cut(walk[0], 0, 90)
    still = dataclasses.replace(
        clip,
        root_positions=np.repeat(clip.root_positions[:1], 90, 0),
        rotations=np.repeat(clip.rotations[:1], 90, 0),
    )
    rows = clip_features(still, layout_for("mason2022", clip.skeleton))
    assert not rows.phase.any() and np.isfinite(rows.y).all()


def test_layouts_before_2022_use_the_smoothed_root(walk):
    positions = seen(walk[0])[0]
    roles = need_roles(walk[0].skeleton)
    smooth, hips = (layout_root(positions, roles, layout) for layout in (mason2018(23), mason2022(23)))
    np.testing.assert_array_equal(smooth.positions, hips.positions)
    assert np.abs(wrap_angle(smooth.yaw - hips.yaw)).max() > 0.01
