"""BVH files read and written: any channel order, real files, every kind of bad file, and any text at all."""

from __future__ import annotations

import errno
import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_yaw
from pfnn_jax.motion.length_unit import CENTIMETRE, CMU, INCH, METRE, MILLIMETRE
from pfnn_jax.motion.skeleton import need_roles
from tests.motion.skeletons import body_clip, bvh_text, random_clip
from tests.raising import assert_refused

FLOAT64 = 1e-9  # degrees of up to 1e3 and a few products of matrices
WRITTEN = 1e-6  # metres: 6 decimals of a degree along limbs of some metres

SIMPLE = bvh_text(
    [
        ("Hips", -1, (0, 0, 0), "Xposition Yposition Zposition Zrotation Yrotation Xrotation"),
        ("Leg", 0, (0, -1, 0), "Zrotation Yrotation Xrotation"),
    ],
    np.arange(18.0).reshape(2, 9),
)


def positions(clip: MotionClip) -> np.ndarray:
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def save(folder: Path, text: str | bytes) -> Path:
    path = folder / "take.bvh"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@st.composite
def bvh_files(draw):
    """A random tree with random channels, its rows, and its text in random formatting."""
    count = draw(st.integers(1, 5))
    parents = [-1]
    for joint in range(1, count):  # depth first: the parent is the last joint or one of its ancestors
        above = [joint - 1]
        while parents[above[-1]] >= 0:
            above.append(parents[above[-1]])
        parents.append(draw(st.sampled_from(above)))
    numbers = st.floats(-1e3, 1e3).map(lambda value: round(value, 6))
    far_from_zero = numbers.filter(lambda value: abs(value) >= 1)  # zero positions leave OFFSET as it is
    joints, columns, frames = [], [], draw(st.integers(1, 3))
    for joint in range(count):
        kinds = [f"{axis}rotation" for axis in "XYZ"][: draw(st.sampled_from([3, 3, 3, 2, 1, 0]))]
        if draw(st.booleans()) or (joint == 0 and not kinds):
            kinds += [f"{axis}position" for axis in "XYZ"][: draw(st.integers(1, 3))]
        channels = draw(st.permutations(kinds))
        offset = tuple(draw(st.tuples(numbers, numbers, numbers)))
        joints.append((f"Hips {joint}" if joint else "Hips", parents[joint], offset, " ".join(channels)))
        for channel in channels:
            still = joint > 0 and channel.endswith("position")  # bones are rigid
            values = (
                [draw(far_from_zero)] * frames if still else draw(st.lists(numbers, min_size=frames, max_size=frames))
            )
            columns.append(values)
    rows = np.array(columns).T
    text = bvh_text(joints, rows)
    dress = draw(st.sampled_from([str, str.lower, lambda t: t.replace("rotation", "ROTATION")]))
    blank = draw(st.sampled_from([" ", "\t", "  "]))
    return joints, rows, dress(text).replace(" ", blank).replace("\n", draw(st.sampled_from(["\n", "\r\n", "\n\n"])))


def matrices(joints: list, row: np.ndarray) -> np.ndarray:
    """[J, 3] positions by products of 4 x 4 matrices, channel by channel."""
    world, column = [], 0
    for _, parent, offset, channels in joints:
        local, turn = np.eye(4), np.eye(4)
        local[:3, 3] = offset
        for channel in channels.split():
            axis = "XYZ".index(channel[0].upper())
            if channel.lower().endswith("position"):
                local[axis, 3] = row[column]
            else:
                turn[:3, :3] = turn[:3, :3] @ Rotation.from_euler("XYZ"[axis], row[column], degrees=True).as_matrix()
            column += 1
        world.append((world[parent] if parent >= 0 else np.eye(4)) @ local @ turn)
    return np.array(world)[:, :3, 3]


@settings(max_examples=60, deadline=None)
@given(case=bvh_files())
def test_any_channel_order_equals_the_product_of_its_transforms(tmp_path_factory, case):
    joints, rows, text = case
    clip = read_bvh(save(tmp_path_factory.getbasetemp(), text), unit=1.0)
    assert (clip.fps, clip.num_frames, clip.skeleton.num_joints) == (30.0, len(rows), len(joints))
    expected = np.array([matrices(joints, row) for row in rows])
    np.testing.assert_allclose(positions(clip), expected, atol=FLOAT64)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), joints=st.integers(1, 12), frames=st.integers(1, 4))
def test_writing_and_reading_is_identity(tmp_path_factory, seed, joints, frames):
    clip = random_clip(np.random.default_rng(seed), joints, frames)
    path = tmp_path_factory.getbasetemp() / "written.bvh"
    write_bvh(path, clip, overwrite=True)
    back = read_bvh(path, unit=CENTIMETRE)
    order = [back.skeleton.names.index(name) for name in clip.skeleton.names]  # written depth first
    assert back.fps == clip.fps
    np.testing.assert_allclose(positions(back)[:, order], positions(clip), atol=WRITTEN)
    sites = {back.skeleton.names[joint]: site for joint, site in back.skeleton.end_sites}
    for joint, site in clip.skeleton.end_sites:
        np.testing.assert_allclose(sites[clip.skeleton.names[joint]], site, atol=WRITTEN)


def refused_or_read(path: Path) -> None:
    try:
        clip = read_bvh(path)
    except InputError as error:
        assert "\n" not in str(error) and str(error).startswith(f"{path}: ")
    else:
        assert np.all(np.isfinite(positions(clip)))


@settings(max_examples=150, deadline=None)
@given(text=st.one_of(st.text(), st.binary(), st.text().map(lambda tail: "HIERARCHY ROOT a { " + tail)))
def test_any_text_is_read_or_raises_input_error(tmp_path_factory, text):
    raw = text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass")
    refused_or_read(save(tmp_path_factory.getbasetemp(), raw))


WORDS = ["{", "}", "JOINT", "End Site", "OFFSET", "CHANNELS", "nan", "-inf", "1e400", "9" * 5000, "-1", "0", "7", "\0"]


@settings(max_examples=200, deadline=None)
@given(start=st.integers(0, len(SIMPLE)), length=st.integers(0, 30), new=st.one_of(st.sampled_from(WORDS), st.text()))
def test_any_damage_is_read_or_raises_input_error(tmp_path_factory, start, length, new):
    damaged = SIMPLE[:start] + new + SIMPLE[start + length :]
    refused_or_read(save(tmp_path_factory.getbasetemp(), damaged.encode("utf-8", "surrogatepass")))


@pytest.mark.parametrize("cut", range(0, len(SIMPLE) - 2, 7))
def test_every_truncation_is_refused(tmp_path, cut):
    with pytest.raises(InputError):
        read_bvh(save(tmp_path, SIMPLE[:cut]), unit=1.0)


@pytest.mark.parametrize(
    ("old", "new", "place", "value"),
    [
        ("HIERARCHY", "HIERARCHIES", "line 1", "HIERARCHIES"),
        ("OFFSET 0 -1 0", "OFFSET 0 -1", "line 9", "CHANNELS"),
        ("OFFSET 0 -1 0", "OFFSET 0 nan 0", "line 8", "nan"),
        ("OFFSET 0 -1 0\n", "", "line 13", "joint Leg without OFFSET"),
        ("CHANNELS 3 Z", "CHANNELS 4 Z", "line 10", "End"),
        ("CHANNELS 3 Zrot", "CHANNELS 3 Wrot", "line 9", "Wrotation"),
        ("CHANNELS 3 Zrotation Yrotation Xrotation", "CHANNELS 2 Zrotation Yrotation", "line 19", "9 numbers"),
        ("CHANNELS 3 Z", "CHANNELS -3 Z", "line 9", "-3"),
        ("JOINT Leg", "JOINT Hips", "line 6", "Hips"),
        ("JOINT Leg", "JOINT", "line 6", "no name"),
        ("MOTION", "NOTION", "line 21", "end of file"),
        ("Frames: 2", "Frames: 0", "line 17", "Frames: 0"),
        ("Frames: 2", "Frames: two", "line 17", "Frames: two"),
        ("Frames: 2", "Frames: 3", "line 20", "2 frames"),
        ("Time: 0.0333333", "Time: 0", "line 18", "Frame Time: 0"),
        ("Time: 0.0333333", "Time: -0.01", "line 18", "Frame Time: -0.01"),
        ("Time: 0.0333333", "Time: nan", "line 18", "Frame Time: nan"),
        ("Time: 0.0333333", "Time: fast", "line 18", "Frame Time: fast"),
        ("Frame Time", "Time of a frame", "line 16", None),
        ("13.0", "x13", "line 20", "value 5 is x13"),
        ("13.0", "nan", "line 20", "value 5 is nan"),
        ("13.0", "-inf", "line 20", "value 5 is -inf"),
        ("13.0", "1e300", "line 20", "value 5 is 1e300"),
        ("13.0 ", "", "line 20", "8 numbers"),
        ("13.0", "13 13", "line 20", "10 numbers"),
    ],
)
def test_each_fault_is_named_with_its_line(tmp_path, old, new, place, value):
    assert old in SIMPLE
    path = save(tmp_path, SIMPLE.replace(old, new, 1))
    assert_refused(lambda: read_bvh(path, unit=1.0), file=path, place=place, value=value)


def test_messages_have_one_line(tmp_path):
    path = save(tmp_path, SIMPLE.replace("Frames: 2", "Frames: two"))
    with pytest.raises(InputError) as caught:
        read_bvh(path, unit=1.0)
    assert str(caught.value) == f"{path}: line 17: Frames: two; must be a whole number"


def test_absent_files_folders_and_binary_files_are_refused(tmp_path):
    assert_refused(lambda: read_bvh(tmp_path / "none.bvh"), file="none.bvh", value="No such file or directory")
    assert_refused(lambda: read_bvh(tmp_path), file=tmp_path, value="Is a directory")
    assert_refused(lambda: read_bvh(save(tmp_path, os.urandom(4096))), place="line 1")
    assert_refused(lambda: read_bvh(save(tmp_path, SIMPLE), unit=0.0), place="unit", value=0.0)


def test_a_stretching_bone_is_refused_by_joint(tmp_path):
    rows = np.zeros((3, 9))
    rows[:, 7] = (1.0, 1.0, 1.1)
    joints = [("Hips", -1, (0, 0, 0), "Xposition Yposition Zposition Zrotation Yrotation Xrotation")]
    joints += [("Leg", 0, (0, 1, 0), "Xposition Yposition Zposition")]
    stretching = save(tmp_path, bvh_text(joints, rows))
    assert_refused(lambda: read_bvh(stretching, unit=1.0), place="joint Leg", value="moves by 0.1")
    rows[2, 7] = 1.005  # noise of marker-based solvers
    clip = read_bvh(save(tmp_path, bvh_text(joints, rows)), unit=1.0)
    np.testing.assert_allclose(clip.skeleton.offsets[1], [0.0, 1.0, 0.0])


def test_joints_above_the_hips_are_merged_into_joint_0(tmp_path):
    six = "Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    joints = [("world", -1, (0, 0, 0), six), ("root", 0, (0, 0, 0), six), ("a", 1, (0, 9, 0), six)]
    joints += [("b", 2, (1, 2, 3), "Zrotation"), ("c", 2, (-1, 2, 3), "Yrotation")]
    rows = np.random.default_rng(0).normal(0, 30, (4, 20))
    clip = read_bvh(save(tmp_path, bvh_text(joints, rows)), unit=1.0)
    assert clip.skeleton.names == ("a", "b", "c")
    np.testing.assert_array_equal(clip.skeleton.parents, [-1, 0, 0])
    expected = np.array([matrices(joints, row)[2:] for row in rows])
    np.testing.assert_allclose(positions(clip), expected, atol=FLOAT64)


@pytest.mark.parametrize(
    ("seconds", "fps"),
    [("0.008333", 120.0), ("0.016667", 60.0), ("0.0333333", 30.0), ("0.041667", 24.0), ("0.0333667", 29.97)],
)
def test_rounded_frame_times_give_whole_frame_rates(tmp_path, seconds, fps):
    clip = read_bvh(save(tmp_path, SIMPLE.replace("0.0333333", seconds)), unit=1.0)
    assert clip.fps == pytest.approx(fps, abs=1e-12 if fps == round(fps) else 1e-4)


@pytest.mark.parametrize("unit", [METRE, CENTIMETRE, INCH, CMU, MILLIMETRE])
def test_the_unit_of_an_adult_is_guessed(tmp_path, unit):
    write_bvh(tmp_path / "adult.bvh", body_clip(spread=0.1), unit=unit)
    offsets = read_bvh(tmp_path / "adult.bvh").skeleton.offsets
    np.testing.assert_allclose(offsets, body_clip().skeleton.offsets, atol=1e-6)


@pytest.mark.parametrize("unit", [METRE, CENTIMETRE, MILLIMETRE])
def test_the_unit_of_a_child_of_one_metre_is_guessed(tmp_path, unit):
    child = body_clip(spread=0.1, scale=1.0 / 1.75)  # 1.75 m from head to toe
    write_bvh(tmp_path / "child.bvh", child, unit=unit)
    np.testing.assert_allclose(read_bvh(tmp_path / "child.bvh").skeleton.offsets, child.skeleton.offsets, atol=1e-6)


def test_a_given_unit_overrides_the_guess(tmp_path):
    write_bvh(tmp_path / "adult.bvh", body_clip())
    clip = read_bvh(tmp_path / "adult.bvh", unit=0.02)
    np.testing.assert_allclose(clip.skeleton.offsets, 2.0 * body_clip().skeleton.offsets, atol=1e-6)


def test_a_roles_file_sets_the_roles(tmp_path):
    write_bvh(tmp_path / "adult.bvh", body_clip())
    (tmp_path / "roles.json").write_text('{"head": "neck"}')
    clip = read_bvh(tmp_path / "adult.bvh", roles_file=tmp_path / "roles.json")
    assert clip.skeleton.names[need_roles(clip.skeleton).head] == "neck"


@pytest.mark.parametrize("name", ["bandai-namco-2/dataset-2_walk_normal_001.bvh", "made"])
def test_a_roles_file_may_name_a_joint_that_is_merged_into_the_hips(mocap, tmp_path, name):
    path = mocap / name
    if name == "made":
        path = tmp_path / "adult.bvh"
        write_bvh(path, body_clip())
        hips = path.read_text()
        above = "HIERARCHY\nROOT joint_Root\n{\nOFFSET 0 0 0\nCHANNELS 0\n"
        path.write_text(hips.replace("HIERARCHY\nROOT", f"{above}JOINT").replace("MOTION", "}\nMOTION"))
    plain = read_bvh(path)
    assert "joint_Root" not in plain.skeleton.names
    file = tmp_path / "roles.json"
    file.write_text('{"hips": "joint_Root"}')
    named = read_bvh(path, roles_file=file)
    assert named.skeleton.roles == plain.skeleton.roles and named.skeleton.names == plain.skeleton.names
    file.write_text(json.dumps({"hips": "joint_Root", "spine": [plain.skeleton.names[0]]}))
    assert_refused(lambda: read_bvh(path, roles_file=file), file=file, place="bone spine", rule_mentions="is also hips")


def test_an_existing_file_is_replaced_only_with_overwrite(tmp_path):
    path = tmp_path / "out.bvh"
    path.write_text("precious")
    assert_refused(lambda: write_bvh(path, body_clip()), file=path, place="output", value="exists")
    assert path.read_text() == "precious"
    write_bvh(path, body_clip(), overwrite=True)
    assert read_bvh(path).num_frames == 5


@pytest.mark.parametrize("broken", ["write_bytes", "replace"])
def test_a_full_disk_leaves_no_partial_file(tmp_path, monkeypatch, broken):
    def full(*_args, **_options):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(*((os, "replace", full) if broken == "replace" else (Path, "write_bytes", full)))
    assert_refused(lambda: write_bvh(tmp_path / "out.bvh", body_clip()), file="out.bvh", place="disk")
    assert list(tmp_path.iterdir()) == []


def test_motion_that_is_not_finite_is_not_written(tmp_path):
    clip = body_clip()
    clip.rotations[3, 2, 1] = np.nan
    with pytest.raises(InputError, match="frame 3: non-finite rotations"):
        write_bvh(tmp_path / "out.bvh", clip)
    assert list(tmp_path.iterdir()) == []


REAL = {
    "bandai-namco-1/dataset-1_walk_normal_001.bvh": (30.0, 21),
    "bandai-namco-1/dataset-1_walk_old_001.bvh": (30.0, 21),
    "bandai-namco-2/dataset-2_run_active_001.bvh": (30.0, 21),
    "100style/Neutral_FW.bvh": (60.0, 23),
    "xia/sexy_01_000.bvh": (120.0, 31),
    "pfnn/LocomotionFlat04_000.bvh": (120.0, 31),
}


@pytest.mark.parametrize("name", REAL)
def test_real_files_load_at_human_size_with_roles(mocap, name):
    clip = read_bvh(mocap / name)
    assert (clip.fps, clip.skeleton.num_joints) == REAL[name]
    roles, joints = need_roles(clip.skeleton), positions(clip)
    toes = joints[:, [roles.left_foot[1], roles.right_foot[1]], 1].min(axis=1)
    assert 1.2 < np.median(joints[:, roles.head, 1] - toes) < 1.8  # metres, toe to base of the head
    assert 0.7 < np.median(joints[:, roles.hips, 1] - toes) < 1.1
    assert np.abs(np.median(toes)) < 0.1
    swing = clip.skeleton.names[roles.left_hand], clip.skeleton.names[roles.right_hand]
    assert clip.skeleton.mirror[roles.left_hand] == roles.right_hand, swing
    across = joints[:, roles.left_hip] - joints[:, roles.right_hip]
    ahead = sum(joints[:, toe] - joints[:, heel] for heel, toe in (roles.left_foot, roles.right_foot))
    assert np.sum(np.cross([0.0, 1.0, 0.0], ahead) * across) > 0  # left is to the left of where the toes point


@pytest.mark.parametrize("name", REAL)
def test_geometry_agrees_with_the_names_of_real_files(mocap, tmp_path, name):
    text = (mocap / name).read_text()
    names = read_bvh(mocap / name).skeleton.names
    for index, joint in enumerate(names):
        text = re.sub(rf"(JOINT|ROOT) {joint}\b", rf"\1 part{chr(97 + index // 26)}{chr(97 + index % 26)}", text)
    by_names, by_geometry = (need_roles(read_bvh(path).skeleton) for path in (mocap / name, save(tmp_path, text)))
    feet = [by_names.left_hip, by_names.left_foot, by_names.right_hip, by_names.right_foot]
    assert feet == [by_geometry.left_hip, by_geometry.left_foot, by_geometry.right_hip, by_geometry.right_foot]
    assert (by_names.left_shoulder, by_names.right_hand) == (by_geometry.left_shoulder, by_geometry.right_hand)


def test_root_motion_above_the_hips_is_kept(mocap):
    """In a few Bandai-Namco clips joint_Root moves and Hips is still; the walk must be kept."""
    clip = read_bvh(mocap / "bandai-namco-1/dataset-1_walk_normal_001.bvh")
    assert clip.skeleton.names[0] == "Hips"
    walked = np.linalg.norm((clip.root_positions[-1] - clip.root_positions[0])[[0, 2]])
    seconds = (clip.num_frames - 1) / clip.fps
    assert 0.5 < walked / seconds < 2.0


def test_writing_and_reading_a_real_file_keeps_its_motion(mocap, tmp_path):
    clip = read_bvh(mocap / "bandai-namco-2/dataset-2_run_active_001.bvh")
    write_bvh(tmp_path / "copy.bvh", clip)
    back = read_bvh(tmp_path / "copy.bvh")
    assert (back.skeleton.names, back.fps, back.skeleton.roles) == (clip.skeleton.names, 30.0, clip.skeleton.roles)
    np.testing.assert_allclose(positions(back), positions(clip), atol=WRITTEN)


def test_writing_and_reading_keeps_yaw(tmp_path):
    clip = body_clip(spread=0.0)
    clip.rotations[:, 0] = quat_from_yaw(np.linspace(-3.0, 3.0, 5))
    write_bvh(tmp_path / "turn.bvh", clip)
    back = read_bvh(tmp_path / "turn.bvh")
    np.testing.assert_allclose(positions(back), positions(clip), atol=WRITTEN)
