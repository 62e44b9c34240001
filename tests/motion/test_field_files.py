"""Files as they come from the field: every kind of fault on a real file with its right value, and made on purpose."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.errors import BadFilesError
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.labelled import load_labelled, read_cut_clip
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.shared_unit import share_units
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips, unlisted_files
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.joint_order import match_joints
from pfnn_jax.motion.kinematics import quat_multiply, quat_rotate
from pfnn_jax.motion.labels.footsteps import NoGaitError, find_steps
from pfnn_jax.motion.labels.phase import CYCLE, PhaseLabels, label_phase, pad_phase
from pfnn_jax.motion.length_unit import CMU, DECIMETRE, FOOT, INCH, UNITS, guess_unit
from pfnn_jax.motion.reading import AXES, Axis, Reading, ReadOptions
from pfnn_jax.motion.skeleton import check_same_topology, need_roles, plain_names, rest_directions_differ
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise
from pfnn_jax.motion.world_motion import world_motion
from tests.motion.skeletons import body_clip, tipped
from tests.raising import assert_refused

FLOAT64 = 1e-9  # metres after products of a few rotations
WRITTEN = 1e-5  # metres: files hold 6 decimals of degrees and of centimetres
TRAVEL = 0.08  # share of a walk's length by which rebuilt travel may differ: feet roll from heel to toe
RUN_TRAVEL = 0.25  # ... and of a run's, whose feet stand for a fifth of a second
FILE_DECIMALS = 1e-6  # of `Frame Time`


def walk(style: str = "neutral", frames: int = 240, speed: float = 1.2, fps: float = 60.0) -> MotionClip:
    return synthesise(style, np.zeros(frames), np.full(frames, speed), fps=fps)[0]


def saved(folder: Path, clip: MotionClip, name: str = "clip", unit: float = 0.01) -> Path:
    path = folder / f"{name}.bvh"
    write_bvh(path, clip, unit=unit, overwrite=True)
    return path


def reading(clip: MotionClip) -> Reading:
    assert clip.reading is not None
    return clip.reading


def head_above_ankles(clip: MotionClip) -> float:
    roles, positions = need_roles(clip.skeleton), world_motion(clip).positions
    ankles = (positions[:, roles.left_foot[0]] + positions[:, roles.right_foot[0]]) / 2
    return float(np.median(positions[:, roles.head] - ankles, axis=0)[1])


def leg(clip: MotionClip) -> float:
    return leg_length_of(clip.skeleton, need_humanoid(clip.skeleton))


def steps(labels: PhaseLabels) -> int:
    return len(labels.contacts_left) + len(labels.contacts_right)


def path_length(clip: MotionClip) -> float:
    """Metres from the first to the last place of the hips on the ground."""
    ground = clip.root_positions[:, [0, 2]]
    return float(np.linalg.norm(ground[-1] - ground[0]))


def frozen(clip: MotionClip, at: int, frames: int) -> tuple[MotionClip, np.ndarray]:
    """The clip with one frame held, and the frame of the clip at each of its frames."""
    index = np.concatenate([np.arange(at), np.full(frames, at), np.arange(at, clip.num_frames)])
    return dataclasses.replace(clip, root_positions=clip.root_positions[index], rotations=clip.rotations[index]), index


# files that were read before any of this

SAME = {
    "bandai-namco-1/dataset-1_walk_normal_001.bvh": (195, 163.401509209, 5542.798858883293, 3.8934071655310905),
    "bandai-namco-2/dataset-2_run_active_001.bvh": (68, 136.0218312, 2014.766325423779, 3.8934071700000006),
    "100style/Neutral_FW.bvh": (1200, -1451.98634558, 32230.31928943946, 4.84106931),
    "xia/sexy_01_000.bvh": (258, 346.464347554568, 9292.42526447838, 4.99001140604),
    "pfnn/LocomotionFlat04_000.bvh": (2428, 3958.997860406596, 99135.80571916718, 4.99001140604),
}
"""Frames, and the sums of root positions, of absolute quaternions and of absolute offsets, recorded before."""


@pytest.mark.parametrize("name", SAME)
def test_published_data_sets_read_as_before(mocap, name):
    clip = read_bvh(mocap / name)
    sums = clip.root_positions.sum(), np.abs(clip.rotations).sum(), np.abs(clip.skeleton.offsets).sum()
    assert clip.num_frames == SAME[name][0]
    np.testing.assert_allclose(sums, SAME[name][1:], rtol=1e-12)


@pytest.mark.parametrize(
    ("name", "fps", "wanted"),
    [
        ("cgspeed_daz", 120.0, (5, 299)),
        ("olaf_walk_24fps", 24.0, (7, 101)),
        ("univrm", 120.0, (6, 600)),
        ("rokoko_dance", 100.0, None),
        ("noitom_like_desk", 60.0, None),
        ("dfki_walk", 72.0, None),
        ("axis_neuron", 125.0, (0, 0)),
    ],
)
def test_files_that_are_right_stay_so(mocap, name, fps, wanted):
    clip = read_bvh(mocap / "field" / f"{name}.bvh")
    assert clip.fps == pytest.approx(fps, rel=FILE_DECIMALS) and 0.75 < leg(clip) < 1.0
    assert reading(clip).up == "y"
    if wanted == (0, 0):
        with pytest.raises(NoGaitError):
            label_phase(clip)
    elif wanted is not None:
        labels = label_phase(clip)
        assert (steps(labels), labels.labelled.sum()) == wanted


# up axis


def test_a_z_up_walk_stands_up(mocap):
    clip = read_bvh(mocap / "field" / "sway.bvh")
    assert head_above_ankles(clip) == pytest.approx(1.50, abs=0.02)
    assert np.linalg.norm(np.diff(clip.root_positions[:, [0, 2]], axis=0), axis=1).sum() > 5.0
    assert reading(clip).up == "z" and any("along z" in note for note in clip.notes)


@pytest.mark.parametrize("up", AXES)
def test_any_axis_that_points_up_is_found(tmp_path, up):
    clip = walk()
    path = saved(tmp_path, tipped(clip, up))
    for options in ({}, {"up": up}):
        found = read_bvh(path, **options)
        assert reading(found).up == up
        np.testing.assert_allclose(world_motion(found).positions, world_motion(clip).positions, atol=WRITTEN)


def test_the_given_axis_is_taken(tmp_path):
    path = saved(tmp_path, tipped(walk(), "z"))
    lying = read_bvh(path, up="y")
    assert head_above_ankles(lying) < 0.2
    assert reading(read_cut_clip(ClipFile(path, "walk", reading=ReadOptions(up="z"))).clip).up == "z"
    north: Any = "north"
    assert_refused(lambda: read_bvh(path, up=north), place="up", value="north")


def test_a_camera_that_looks_down_does_not_hide_the_axis(tmp_path):
    tilt = np.array([np.cos(np.pi / 18), np.sin(np.pi / 18), 0.0, 0.0])  # 20 degrees
    clip = tipped(walk(), "-y")
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(tilt, rotations[:, 0])
    clip = dataclasses.replace(clip, rotations=rotations, root_positions=quat_rotate(tilt, clip.root_positions))
    assert reading(read_bvh(saved(tmp_path, clip))).up == "-y"


# unit


def test_a_child_in_inches_has_the_size_of_a_child(mocap):
    clip = read_bvh(mocap / "field" / "child5_inches.bvh")
    assert reading(clip).unit == INCH
    assert leg(clip) == pytest.approx(0.52, abs=0.01)
    assert path_length(clip) / (clip.num_frames / clip.fps) == pytest.approx(0.9, abs=0.05)  # metres per second
    assert any("CMU" in note for note in clip.notes)


def test_decimetres_are_found(mocap):
    clip = read_bvh(mocap / "field" / "makehuman_walk_decimetres.bvh")
    assert reading(clip).unit == DECIMETRE
    assert head_above_ankles(clip) == pytest.approx(1.33, abs=0.02)


@pytest.mark.parametrize("connector", ["__UpLeg", "UpLeg0", "Thigh", "Hip"])
def test_hip_joints_are_apart(mocap, tmp_path, connector):
    """Both legs begin at one place, 0.1 m from the hip joints; with that bone they would be 0.92 m long, not 0.82 m."""
    path = tmp_path / "clip.bvh"
    path.write_text((mocap / "field" / "makehuman_walk_decimetres.bvh").read_text().replace("__UpLeg", connector))
    clip = read_bvh(path)
    roles = need_roles(clip.skeleton)
    assert [clip.skeleton.names[joint] for joint in (roles.left_hip, roles.right_hip)] == ["UpLeg_L", "UpLeg_R"]
    assert reading(clip).unit == DECIMETRE and leg(clip) == pytest.approx(0.82, abs=0.01)
    adult = walk()
    assert leg(clip) / head_above_ankles(clip) == pytest.approx(leg(adult) / head_above_ankles(adult), abs=0.02)


def test_zero_positions_leave_the_offsets(mocap):
    clip = read_bvh(mocap / "field" / "makehuman_tpose_zero_positions.bvh")
    assert 0.75 < leg(clip) < 0.95 and head_above_ankles(clip) == pytest.approx(1.48, abs=0.02)
    assert any("OFFSET is used" in note for note in clip.notes)


def test_zero_positions_are_told_from_positions(tmp_path):
    six = "Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    text = saved(tmp_path, walk(frames=20)).read_text()
    head, motion = text.split("MOTION")
    wide = re.sub(r"CHANNELS 3 .*", f"CHANNELS 6 {six}", head)
    lines = motion.strip().split("\n")
    rows = np.array([line.split() for line in lines[2:]], float)
    zeros = np.zeros((len(rows), 3))
    parts = [rows[:, :6], *(np.hstack([zeros, rows[:, at : at + 3]]) for at in range(6, rows.shape[1], 3))]
    order = [0, 1, 2, 3, 5, 4]  # Z Y X as written, Z X Y as declared: only the offsets are compared
    body = "\n".join(" ".join(map(str, row)) for row in np.hstack([parts[0][:, order], *parts[1:]]))
    (tmp_path / "six.bvh").write_text(wide + "MOTION\n" + "\n".join(lines[:2]) + "\n" + body + "\n")
    np.testing.assert_allclose(read_bvh(tmp_path / "six.bvh").skeleton.offsets, walk().skeleton.offsets, atol=WRITTEN)


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("height", [1.6, 1.75, 1.9])
def test_the_unit_of_adults_is_guessed(unit, height):
    metres = 0.48 * height  # a leg is about 0.48 of the height
    assert guess_unit(metres / UNITS[unit])[0] == UNITS[unit]


@pytest.mark.parametrize("unit", ["metre", "centimetre", "millimetre", "inch", "foot"])
def test_the_unit_of_a_child_of_five_is_guessed(unit):
    assert guess_unit(0.5 / UNITS[unit])[0] == UNITS[unit]


@given(leg=st.floats(0.35, 1.15), unit=st.sampled_from(sorted(UNITS)))
def test_guesses_are_the_likeliest_person(leg, unit):
    found, _ = guess_unit(leg / UNITS[unit])
    assert 0.3 < leg / UNITS[unit] * found < 1.2


def test_legs_of_no_person_are_refused_and_those_of_few_noted(tmp_path):
    path = saved(tmp_path, walk())
    assert_refused(lambda: read_bvh(path, unit=0.035), file=path, place="unit", rule_mentions="--unit")
    assert_refused(lambda: read_bvh(path, unit="cubit"), place="unit", value="cubit")
    tall = read_bvh(path, unit=0.016)
    assert any("legs of 1." in note for note in tall.notes)
    assert read_bvh(path, unit="centimetre").notes == read_bvh(path).notes == ()
    feet = saved(tmp_path, walk(), unit=FOOT)  # a leg of 2.9 units was taken for metres
    assert reading(read_bvh(feet)).unit == FOOT


def test_files_of_one_skeleton_share_a_unit(tmp_path):
    for name, size in (("child", 0.56), ("man", 1.0), ("woman", 0.95)):
        clip = walk()
        skeleton = dataclasses.replace(clip.skeleton, offsets=clip.skeleton.offsets * size)
        saved(tmp_path, dataclasses.replace(clip, skeleton=skeleton), name, INCH)
    small = walk()
    skeleton = dataclasses.replace(small.skeleton, offsets=small.skeleton.offsets * 0.52)
    alone = saved(tmp_path, dataclasses.replace(small, skeleton=skeleton), "toddler", INCH)
    clips = share_units([ClipFile(path, "walk") for path in sorted(tmp_path.glob("*.bvh"))])
    found = [reading(read_cut_clip(clip).clip).unit for clip in clips]
    assert found == [INCH] * 4 and alone.is_file()


# text


def test_chains_without_end_site_end_in_themselves(mocap):
    clip = read_bvh(mocap / "field" / "kimodo_soma_elderly.bvh")
    labels = label_phase(clip)
    assert clip.num_frames == 180 and steps(labels) == 10
    names = [clip.skeleton.names[joint] for joint in need_roles(clip.skeleton).left_foot]
    assert all("Left" in name for name in names)
    assert all(not offset.any() for joint, offset in clip.skeleton.end_sites if clip.skeleton.names[joint] == "HeadEnd")


def test_any_file_reads_the_same_without_end_sites(tmp_path):
    path = saved(tmp_path, walk())
    bare = tmp_path / "bare.bvh"
    bare.write_text(re.sub(r"End Site\s*\{[^}]*\}", "", path.read_text()))
    whole, read = read_bvh(path), read_bvh(bare)
    np.testing.assert_array_equal(read.rotations, whole.rotations)
    assert read.skeleton.roles == whole.skeleton.roles


def test_an_uncounted_row_is_taken_and_noted(mocap):
    clip = read_bvh(mocap / "field" / "boxing_plus_one.bvh")
    assert clip.num_frames == 120 and any("Frames: 119" in note for note in clip.notes)


def test_too_few_rows_and_a_broken_last_row_are_refused(tmp_path):
    path = saved(tmp_path, walk(frames=30))
    text = path.read_text()
    path.write_text(text.replace("Frames: 30", "Frames: 31"))
    assert_refused(lambda: read_bvh(path), value="30 frames")
    path.write_text(text.replace("Frames: 30", "Frames: 29"))
    assert read_bvh(path).num_frames == 30
    path.write_text(text.replace("Frames: 30", "Frames: 29").rstrip()[:-12] + "\n")
    assert_refused(lambda: read_bvh(path))


# names and rest pose


def test_namespaces_make_no_other_skeleton(mocap):
    one, other = (read_bvh(mocap / "field" / f"{name}.bvh") for name in ("mixamorig_colon", "no_namespace"))
    matched = match_joints(other, one.skeleton.names)
    check_same_topology(one.skeleton, matched.skeleton, "clip")
    positions, own = world_motion(matched).positions, world_motion(other).positions
    for joint, name in enumerate(plain_names(one.skeleton.names)):
        np.testing.assert_allclose(positions[:, joint], own[:, other.skeleton.names.index(name)], atol=FLOAT64)
    assert plain_names(tuple(matched.skeleton.names[j] for j in need_roles(matched.skeleton).left_foot)) == tuple(
        other.skeleton.names[j] for j in need_roles(other.skeleton).left_foot
    )


@pytest.mark.parametrize("form", ["rig:{}", "Character1_{}", "mixamorig_{}", "{}_07"])
def test_what_exporters_add_to_names_is_ignored(form):
    names = body_clip().skeleton.names
    assert plain_names(tuple(form.format(name) for name in names)) == plain_names(names)


def test_files_with_and_without_namespace_are_prepared_together(mocap, tmp_path):
    names = ("mixamorig_colon", "no_namespace")
    files = [ClipFile(mocap / "field" / f"{name}.bvh", name) for name in names]
    dataset = prepare(files, tmp_path / "data", PrepareConfig("mason2022"))
    assert dataset.styles == names and all(entry["reading"]["up"] == "y" for entry in dataset.clips)


def test_another_rest_pose_is_found_by_joint_and_angle(mocap):
    skeleton = read_bvh(mocap / "field" / "momask_walk.bvh").skeleton
    assert rest_directions_differ(skeleton, skeleton) is None
    along_x = np.linalg.norm(skeleton.offsets, axis=1)[:, None] * np.array([1.0, 0.0, 0.0])
    other = dataclasses.replace(skeleton, offsets=along_x)
    joint, degrees = rest_directions_differ(skeleton, other) or (0, 0.0)
    assert joint > 0 and degrees > 80
    assert_refused(lambda: check_same_topology(skeleton, other, "clip"), place=f"joint {skeleton.names[joint]}")


# frame time


def test_the_rate_can_be_given(mocap):
    path = mocap / "field" / "stylised_24fps.bvh"
    with pytest.raises(NoGaitError, match=r"327 frames \(13.6 s\).*24 frames per second.*--source-fps"):
        label_phase(read_bvh(path))
    clip = read_bvh(path, source_fps=60)
    assert clip.fps == 60.0 and steps(label_phase(clip)) == 4


@pytest.mark.parametrize(("word", "advice"), [("33.33", "0.03333"), ("16.667", "0.016667"), ("120", "0.008333")])
def test_frame_times_that_are_no_seconds_are_refused_with_advice(tmp_path, word, advice):
    path = saved(tmp_path, walk(frames=30))
    path.write_text(re.sub(r"Frame Time: \S+", f"Frame Time: {word}", path.read_text()))
    assert_refused(lambda: read_bvh(path), value=f"Frame Time: {word}", rule_mentions="--source-fps")
    assert advice in assert_refused(lambda: read_bvh(path), place=None).rule
    assert read_bvh(path, source_fps=30).fps == 30.0
    assert_refused(lambda: read_bvh(path, source_fps=-1), place="source_fps")


# jumps


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0, 120.0])
@pytest.mark.parametrize("held", [1, 12])
def test_a_t_pose_before_the_motion_is_cut(tmp_path, fps, held):
    clip = walk(frames=round(4 * fps), fps=fps)
    zeros = np.zeros((held, *clip.rotations.shape[1:]))
    zeros[..., 0] = 1.0
    posed = dataclasses.replace(
        clip,
        root_positions=np.concatenate([np.zeros((held, 3)), clip.root_positions]),
        rotations=np.concatenate([zeros, clip.rotations]),
    )
    path = saved(tmp_path, posed)
    found = read_bvh(path)
    assert reading(found).first_frame == held and len(found.notes) == 1
    np.testing.assert_allclose(found.root_positions, clip.root_positions, atol=WRITTEN)
    labels = pad_phase(label_phase(found), held, posed.num_frames)
    assert labels.num_frames == posed.num_frames and not labels.labelled[:held].any()
    part = load_labelled(ClipFile(path, "walk"), fps=fps)
    assert part.clip.num_frames == clip.num_frames and "jumps" in part.note


def test_a_t_pose_on_the_same_place_is_cut(tmp_path):
    clip = walk()
    rotations = clip.rotations.copy()
    rotations[0, 1:] = (1.0, 0.0, 0.0, 0.0)
    assert reading(read_bvh(saved(tmp_path, dataclasses.replace(clip, rotations=rotations)))).first_frame == 1


@pytest.mark.parametrize("metres", [1.0, 3.0, 20.0])
def test_of_a_clip_that_teleports_the_longest_part_is_kept(tmp_path, metres):
    clip = walk()
    positions = clip.root_positions.copy()
    positions[150:] += [metres, 0.0, 0.0]
    found = read_bvh(saved(tmp_path, dataclasses.replace(clip, root_positions=positions)))
    assert found.num_frames == 150 and "frame 150" in found.notes[0]


def test_cuts_by_the_user_come_before_jumps(tmp_path):
    clip = walk()
    positions = clip.root_positions.copy()
    positions[150:] += [5.0, 0.0, 0.0]
    path = saved(tmp_path, dataclasses.replace(clip, root_positions=positions))
    part = read_cut_clip(ClipFile(path, "walk", start=160))
    assert (part.start, part.clip.num_frames, part.note) == (160, 80, "")
    part = read_cut_clip(ClipFile(path, "walk", start=130, stop=200))
    assert (part.start, part.clip.num_frames) == (150, 50)


@settings(max_examples=10)
@given(style=st.sampled_from(sorted(STYLES)), seed=st.integers(0, 100), fps=st.sampled_from([24.0, 30.0, 60.0, 120.0]))
def test_walks_do_not_jump(tmp_path_factory, style, seed, fps):
    frames = round(3 * fps)
    rng = np.random.default_rng(seed)
    clip = synthesise(style, rng.normal(0, 0.5, frames), np.full(frames, 1.5), fps=fps, seed=seed)[0]
    found = read_bvh(saved(tmp_path_factory.getbasetemp(), clip))
    assert found.num_frames == frames and found.notes == ()


def test_a_speed_that_no_person_has_is_refused(tmp_path):
    path = saved(tmp_path, walk())
    assert_refused(lambda: read_bvh(path, source_fps=1200), place="speed", rule_mentions="--source-fps")


def test_hand_labelled_clips_keep_their_frames(mocap):
    clip = read_bvh(mocap / "pfnn" / "LocomotionFlat04_000.bvh")  # its last 96 frames lie 2 m away
    assert clip.num_frames == 2428 and "kept" in clip.notes[0]


# walks on the spot


def on_the_spot(clip: MotionClip, sway: bool) -> MotionClip:
    positions = clip.root_positions.copy()
    ground = positions[:, [0, 2]]
    line = np.linspace(0, 1, len(ground))[:, None] * (ground[-1] - ground[0]) + ground[0]
    positions[:, [0, 2]] = ground - line if sway else 0.0
    return dataclasses.replace(clip, root_positions=positions)


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [
        ("bandai-namco-2/dataset-2_walk_masculine_001", TRAVEL),
        ("bandai-namco-1/dataset-1_walk_tired_002", TRAVEL),
        ("bandai-namco-1/dataset-1_walk-left_angry_001", TRAVEL),
        ("bandai-namco-1/dataset-1_walk-back_masculinity_001", TRAVEL),
        ("xia/neutral_01_000", TRAVEL),
        ("bandai-namco-2/dataset-2_run_active_001", RUN_TRAVEL),
    ],
)
@pytest.mark.parametrize("sway", [False, True])
def test_the_travel_of_a_walk_on_the_spot_is_rebuilt(mocap, tmp_path, name, tolerance, sway):
    clip = read_bvh(mocap / f"{name}.bvh")
    path = saved(tmp_path, on_the_spot(clip, sway))
    found = read_bvh(path)
    assert path_length(found) == pytest.approx(path_length(clip), rel=tolerance)
    assert any("on the spot" in note for note in found.notes)
    assert path_length(read_bvh(path, travel="keep")) < 0.5
    if "run" not in name:
        assert steps(label_phase(found)) == pytest.approx(steps(label_phase(clip)), abs=1)


@pytest.mark.parametrize("name", ["rokoko_dance", "univrm", "wham", "boxing_plus_one", "axis_neuron"])
def test_dances_and_idling_stay_in_place(mocap, name):
    assert not any("on the spot" in note for note in read_bvh(mocap / "field" / f"{name}.bvh").notes)


# phase


def test_frames_around_an_unseen_contact_have_no_label(mocap):
    clip = read_bvh(mocap / "field" / "skating_steps_missed.bvh")
    labels = label_phase(clip)
    # about 10 frames for each half cycle in this clip
    together = labels.labelled[1:] & labels.labelled[:-1]
    half_cycle = np.pi / wrap_angle(np.diff(labels.phase))[together]
    assert half_cycle.min() > 7 and half_cycle.max() < 14
    assert not labels.labelled[28:37].any() and not labels.labelled[88:97].any()


def test_contacts_of_runs_that_touch_are_all_kept(mocap):
    clip = read_bvh(mocap / "field" / "runs_touch.bvh")
    assert steps(label_phase(clip)) == sum(len(run.times) for run in find_steps(clip)) == 31


STOP = 0.04
"""Cycles by which the phase of moving frames may change where a stop is inserted."""


@settings(max_examples=25)
@given(
    style=st.sampled_from(sorted(STYLES)),
    at=st.integers(180, 320),
    seconds=st.floats(0.3, 4.0),
)
def test_a_stop_changes_no_phase_and_has_none(style, at, seconds):
    clip = walk(style, 500, STYLES[style].speed)
    without = label_phase(clip)
    stopped, index = frozen(clip, at, round(60 * seconds))
    labels = label_phase(stopped)
    moving = index != at
    both = labels.labelled & without.labelled[index] & moving
    assert both.sum() >= 0.95 * moving.sum()
    off = np.abs(wrap_angle(labels.phase - without.phase[index]))[both] / CYCLE
    assert off.max() < STOP
    inside = np.flatnonzero(~moving)[6:-6]  # filters reach a few frames into the stop
    assert not labels.labelled[inside].any()


# folders and tables


def test_files_below_a_style_are_found_and_others_named(tmp_path):
    for place in ("old", "old/day 1", "young/a/b"):
        (tmp_path / place).mkdir(parents=True, exist_ok=True)
        saved(tmp_path / place, body_clip())
    clips = list_clips(tmp_path)
    assert sorted(clip.style for clip in clips) == ["old", "old", "young"] and not unlisted_files(tmp_path, clips)
    stray = saved(tmp_path, body_clip(), "stray")
    assert unlisted_files(tmp_path, list_clips(tmp_path, "folders")) == [stray]


def test_all_bad_files_are_refused_together_or_skipped(tmp_path):
    for style in ("old", "young"):
        (tmp_path / "clips" / style).mkdir(parents=True)
        saved(tmp_path / "clips" / style, walk(), "good")
        (tmp_path / "clips" / style / "bad.bvh").write_text("HIERARCHY")
    with pytest.raises(BadFilesError) as caught:
        prepare(tmp_path / "clips", tmp_path / "data")
    assert [Path(error.file).parent.name for error in caught.value.errors] == ["old", "young"]
    assert len(str(caught.value).splitlines()) == 3 and "skip_bad" in caught.value.rule
    dataset = prepare(tmp_path / "clips", tmp_path / "data", skip_bad=True)
    assert [Path(skipped["file"]).name for skipped in dataset.skipped] == ["bad.bvh", "bad.bvh"]


def test_a_table_says_how_files_are_read(tmp_path):
    kinds: tuple[tuple[str, Axis, float], ...] = (("old", "z", INCH), ("young", "y", CMU))
    for style, up, unit in kinds:
        (tmp_path / "clips" / style).mkdir(parents=True)
        for name in ("a", "b"):
            saved(tmp_path / "clips" / style, tipped(walk(), up), name, unit)
    table = tmp_path / "clips" / "clips.csv"
    table.write_text("files,unit,up,source_fps\n*,,y,\nold/*,inch,z,\nold/b.bvh,,,30\n")
    clips = list_clips(tmp_path / "clips", reading=ReadOptions(unit="CMU"))
    found = [(clip.reading.metres, clip.reading.up, clip.reading.source_fps) for clip in clips]
    assert found == [(INCH, "z", None), (INCH, "z", 30.0), (CMU, "y", None), (CMU, "y", None)]
    dataset = prepare(clips, tmp_path / "data", PrepareConfig("mason2022"))
    assert [entry["reading"]["unit"] for entry in dataset.clips if not entry["mirrored"]] == [INCH, INCH, CMU, CMU]


def test_a_table_names_the_joints_of_each_folder(tmp_path):
    clips = tmp_path / "clips"
    for style in ("old", "young"):
        (clips / style).mkdir(parents=True)
        saved(clips / style, walk())
    (clips / "old" / "roles.json").write_text('{"head": "Neck"}')
    (clips / "clips.csv").write_text("files,unit,roles\nold/*,,old/roles.json\n*,centimetre,\n")
    (tmp_path / "all.json").write_text('{"head": "Spine"}')
    heads = [
        part.skeleton.names[need_roles(part.skeleton).head]
        for part in (read_cut_clip(clip, tmp_path / "all.json").clip for clip in list_clips(clips))
    ]
    assert heads == ["Neck", "Spine"]  # the table's file comes before that of the call
    dataset = prepare(list_clips(clips), tmp_path / "data", PrepareConfig("mason2022"))
    files = {entry["style"]: entry["reading"].get("roles_file", "") for entry in dataset.clips}
    assert files["old"].endswith("roles.json") and files["young"] == ""
    (clips / "old" / "roles.json").write_text("{")
    assert_refused(lambda: list_clips(clips), file="roles.json", place="file")


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("", "line 1"),
        ("files,colour\nold/*,red\n", "line 1"),
        ("files,unit\nold/*\n", "line 2"),
        ("files,unit\nold/*,cubit\n", "line 2, unit"),
        ("files,up\n\nold/*,north\n", "line 3, up"),
        ("files,source_fps\nold/*,fast\n", "line 2, source_fps"),
        ("files,up\nnone/*,z\n", "line 2"),
        ("files,roles\nold/*,none.json\n", "line 2, roles"),
        ("files,roles\nold/*,old\n", "line 2, roles"),
    ],
)
def test_faults_of_a_table_are_named_by_line(tmp_path, text, place):
    (tmp_path / "old").mkdir()
    saved(tmp_path / "old", body_clip())
    (tmp_path / "clips.csv").write_text(text)
    assert_refused(lambda: list_clips(tmp_path), file="clips.csv", place=place)
