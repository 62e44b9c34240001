"""Clips of glTF files are sampled as the file says, and read as BVH files are."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.motion.clip_files import is_clip_file, read_any_skeleton, read_clip, read_rig, read_whole_clip
from pfnn_jax.motion.datasets.labelled import load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.datasets.target_skeleton import find_target
from pfnn_jax.motion.features.layout import LAYOUTS
from pfnn_jax.motion.gltf.animations import RATES
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_axis_angle, quat_multiply, quat_to_matrix
from pfnn_jax.motion.reading import ReadOptions
from tests.gltf.rigs import NAMES, make_rig, places
from tests.raising import assert_refused

ROOT, HIPS, LEG, ARM = (NAMES.index(name) for name in ("Root", "Hips", "LeftLeg", "LeftArm"))

ROUNDING = 2e-6
"""Metres and components of quaternions; files hold float32."""

X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])

SECONDS_A_STEP = (0.3, 1.0)
"""Seconds from one step to the next in walks of game characters."""


def about(axis, angles):
    """Returns rotations [K, 4] xyzw about an axis by angles in radians."""
    return np.roll(quat_from_axis_angle(axis, np.asarray(angles, float)), -1, axis=-1)


def read(rig, tmp_path, **options):
    return read_whole_clip(rig.write(tmp_path / "a.glb"), ReadOptions(**options))


def knee(clip):
    """Returns how far the left knee bends [T], in radians."""
    joint = clip.skeleton.names.index("LeftLeg")
    return 2 * np.arctan2(clip.rotations[:, joint, 1], clip.rotations[:, joint, 0])


def test_keys_at_a_rate_are_read_as_they_are(tmp_path):
    rig, angles = make_rig(), np.linspace(0, 1, 31)
    rig.animate({(LEG, "rotation"): (np.arange(31) / 30, about(X, angles))})
    clip = read(rig, tmp_path)
    assert clip.fps == 30.0 and clip.num_frames == 31
    assert np.allclose(knee(clip), angles, atol=ROUNDING)
    assert np.allclose(clip.rotations[0, 0], [1, 0, 0, 0], atol=ROUNDING)


@pytest.mark.parametrize("rate", RATES)
def test_the_rate_of_the_keys_is_found(tmp_path, rate):
    rig = make_rig()
    times = (np.arange(41) + 1) / rate  # the first key is not at zero, as exporters have it
    rig.animate({(LEG, "rotation"): (times, about(X, np.linspace(0, 1, 41)))})
    clip = read(rig, tmp_path)
    assert rate % clip.fps == 0 and clip.fps <= rate and clip.num_frames == 1 + round(40 * clip.fps / rate)


def test_an_even_rate_that_is_not_usual_is_kept(tmp_path):
    rig = make_rig()
    rig.animate({(LEG, "rotation"): (np.arange(41) / 35.0, about(X, np.linspace(0, 1, 41)))})
    clip = read(rig, tmp_path)
    assert clip.fps == 35.0 and clip.num_frames == 41


def test_keys_without_a_rate_are_interpolated_and_noted(tmp_path):
    rig = make_rig()
    times = np.array([0, 0.1234, 0.4567, 1.0])
    rig.animate({(LEG, "rotation"): (times, about(X, times))})
    clip = read(rig, tmp_path)
    assert clip.fps == 60.0 and any("no common frame rate" in note for note in clip.notes)
    assert np.allclose(knee(clip), np.arange(61) / 60, atol=1e-5)  # the angle is the time


def test_steps_hold_their_value(tmp_path):
    rig = make_rig()
    rig.animate({(LEG, "rotation"): ([0, 0.5, 1.0], about(X, [0.0, 0.5, 1.0]))}, interpolation="STEP")
    clip = read(rig, tmp_path)
    half = clip.num_frames // 2
    assert np.allclose(knee(clip)[:half], 0.0, atol=ROUNDING) and np.allclose(knee(clip)[half:-1], 0.5, atol=ROUNDING)


def test_cubic_splines_are_hermite_splines(tmp_path):
    """The height of the hips is t³ - t², whose Hermite spline between two keys is itself."""
    times = np.array([0.0, 1.0])
    values = np.zeros((2, 3, 3))
    values[:, 1, 1] = 0.9 + times**3 - times**2
    slope = 3 * times**2 - 2 * times
    values[:, 0, 1] = values[:, 2, 1] = slope
    rig = make_rig()
    rig.animate({(HIPS, "translation"): (times, values)}, interpolation="CUBICSPLINE")
    clip = read(rig, tmp_path)
    t = np.arange(clip.num_frames) / clip.fps
    assert np.allclose(clip.root_positions[:, 1], 0.9 + t**3 - t**2, atol=ROUNDING)


def test_what_moves_above_the_hips_moves_them(tmp_path):
    """An armature that travels, a root that turns, and hips that rise, as against their product."""
    times = np.arange(31) / 30
    travel = np.stack((np.zeros(31), np.zeros(31), times), axis=1)
    rise = np.stack((np.zeros(31), 0.9 + 0.1 * times, np.zeros(31)), axis=1)
    rig = make_rig(lambda data: data["nodes"].append({"name": "Armature", "children": [0]}))
    armature = len(NAMES) + 1
    rig.animate(
        {
            (armature, "translation"): (times, travel),
            (ROOT, "rotation"): (times, about(Y, times)),
            (HIPS, "translation"): (times, rise),
            (HIPS, "rotation"): (times, about(X, 0.5 * times)),
        }
    )
    clip = read(rig, tmp_path)
    assert clip.skeleton.names[0] == "Hips"
    assert np.allclose(clip.root_positions, travel + rise, atol=ROUNDING)
    wanted = quat_multiply(quat_from_axis_angle(Y, times), quat_from_axis_angle(X, 0.5 * times))
    assert np.allclose(quat_to_matrix(clip.rotations[:, 0]), quat_to_matrix(wanted), atol=10 * ROUNDING)


def test_a_pose_of_the_nodes_other_than_the_bind_pose_is_no_motion(tmp_path):
    """Bones of a file that was saved with a bent knee: zero rotations are still the bind pose."""
    rig = make_rig()
    rig.json["nodes"][LEG]["rotation"] = about(X, [0.8])[0].tolist()
    rig.animate({(ARM, "rotation"): ([0, 1.0], about(Y, [0.0, 0.3]))})
    clip = read(rig, tmp_path)
    assert np.allclose(knee(clip), 0.8, atol=ROUNDING)
    bind = dict(zip(NAMES, places(), strict=True))
    still = np.tile([1.0, 0, 0, 0], (1, clip.skeleton.num_joints, 1))
    rest, _ = forward_kinematics(clip.skeleton, bind["Hips"][None], still)
    assert np.allclose(rest[0], [bind[name] for name in clip.skeleton.names], atol=ROUNDING)


def test_the_plain_walk_of_several_clips_is_read_and_others_by_name(tmp_path):
    rig = make_rig()
    for number, name in enumerate(("Idle", "Walk_Gun", "Character|WalkCycle", "T-Pose")):
        keys = 1 if name == "T-Pose" else 31
        rig.animate({(LEG, "rotation"): (np.arange(keys) / 30, about(X, [0.1 * number] * keys))}, name)
    assert np.allclose(knee(read(rig, tmp_path)), 0.2, atol=ROUNDING)
    assert any("--clip-name" in note for note in read(rig, tmp_path).notes)
    assert np.allclose(knee(read(rig, tmp_path, clip_name="idle")), 0.0, atol=ROUNDING)
    assert_refused(lambda: read(rig, tmp_path, clip_name="jump"), value="'jump'", rule_mentions="'Walk_Gun'")
    rig.json["animations"] = [rig.json["animations"][0], {**rig.json["animations"][1], "name": "Idle"}]
    assert_refused(lambda: read(rig, tmp_path), place="animations", rule_mentions="'Idle', 'Idle (1)'")
    rig.json["animations"] = rig.json["animations"][:1]
    del rig.json["animations"][0]["name"]
    assert read(rig, tmp_path).notes == ()


def test_a_character_without_motion_is_a_skeleton_but_no_clip(tmp_path):
    path = make_rig().write(tmp_path / "a.glb")
    assert_refused(lambda: read_clip(path), place="animations", value="none")
    assert read_any_skeleton(path).names[0] == "Hips" and read_rig(path, ReadOptions()).num_frames == 1


def test_a_character_without_motion_can_be_the_skeleton_of_a_data_set(tmp_path):
    path = make_rig().write(tmp_path / "a.glb")
    target = find_target(path, [], LAYOUTS["mason2018"](1))
    assert target.names[0] == "Hips" and target.resting_heights is not None


def test_a_clip_without_a_mesh_has_the_joints_that_it_turns(tmp_path):
    rig = make_rig()
    del rig.json["skins"], rig.json["meshes"], rig.json["nodes"][-1]
    times = np.arange(31) / 30
    still = {(node, "rotation"): (times, about(X, np.zeros(31))) for node in range(1, len(NAMES))}
    rig.animate({**still, (LEG, "rotation"): (times, about(X, times))})
    clip = read(rig, tmp_path)
    assert set(clip.skeleton.names) == set(NAMES[1:]) and np.allclose(knee(clip), times, atol=ROUNDING)


def test_a_vrm_animation_is_read_by_its_map(tmp_path):
    bones = {"hips": "Hips", "spine": "Spine", "head": "Head"}
    for side in ("Left", "Right"):
        for bone, joint in (("UpperLeg", "UpLeg"), ("LowerLeg", "Leg"), ("Foot", "Foot"), ("Toes", "ToeBase")):
            bones[side.lower() + bone] = side + joint
        for bone, joint in (("UpperArm", "Arm"), ("LowerArm", "ForeArm"), ("Hand", "Hand")):
            bones[side.lower() + bone] = side + joint
    rig = make_rig()
    del rig.json["skins"], rig.json["meshes"], rig.json["nodes"][-1]
    human = {bone: {"node": NAMES.index(joint)} for bone, joint in bones.items()}
    rig.json["extensions"] = {"VRMC_vrm_animation": {"humanoid": {"humanBones": human}}}
    for number, node in enumerate(rig.json["nodes"]):
        node["name"] = f"n{number}"
    rig.animate({(LEG, "rotation"): (np.arange(31) / 30, about(X, np.linspace(0, 1, 31)))})
    clip = read_whole_clip(rig.write(tmp_path / "a.vrma"), ReadOptions())
    names = need_humanoid(clip.skeleton).names(clip.skeleton.names)
    assert names["left_shin"] == f"n{LEG}" and names["hips"] == f"n{HIPS}"


def test_files_of_every_suffix_are_listed_as_clips(tmp_path):
    rig = make_rig()
    rig.animate({(LEG, "rotation"): (np.arange(31) / 30, about(X, np.linspace(0, 1, 31)))})
    for name in ("old/a.glb", "old/b.VRM", "old/c.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        rig.write(tmp_path / name)
    assert [clip.path.name for clip in list_clips(tmp_path)] == ["a.glb", "b.VRM"]
    assert not is_clip_file("c.txt") and is_clip_file("d.BVH")


@pytest.mark.parametrize(
    "name", ["kaykit_mage", "quaternius_adventurer", "quaternius_platformer", "cesiumman", "mixamo_hunter"]
)
def test_walks_of_game_characters_are_learned_from_as_recorded_ones(characters, name):
    """They are loops on the spot of a second or two: they travel, and their steps are labelled from end to end."""
    labelled = load_labelled(ClipFile(characters / f"{name}.glb", name))
    steps = len(labelled.labels.contacts_left) + len(labelled.labels.contacts_right)
    seconds = labelled.clip.num_frames / labelled.clip.fps
    assert "rebuilt" in labelled.note and "a loop of" in labelled.note
    assert SECONDS_A_STEP[0] < seconds / steps < SECONDS_A_STEP[1]
    assert labelled.labels.labelled.mean() > 0.95
    moved = labelled.clip.root_positions[-1] - labelled.clip.root_positions[0]
    assert moved[2] > 0.5 * seconds and abs(moved[0]) < 0.1 * moved[2]  # forwards, which is +Z
