"""The humanoid map of the skeletons that people use, of none, and of animals."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import find_humanoid, need_humanoid
from pfnn_jax.motion.humanoid.map import BONES, LEG, HumanoidMap, map_from_json, map_to_json
from pfnn_jax.motion.humanoid.names import plain_names, read_names
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_axis_angle
from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton, need_roles, rest_pose, skeleton_from_json, skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from tests.motion.expected_maps import CHARACTERS, MOCAP, NO_NAMES
from tests.motion.rigs import bvh_skeleton, character, crab, quadruped, tree, without_names
from tests.motion.skeletons import body
from tests.raising import assert_refused

CRAWLING = (
    "Hips Spine0 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand RightShoulder RightArm RightForeArm RightHand "
    "LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase"
)
"""Joints of a quadruped in the places of the body's."""

CLEAR = 0.9
"""Confidence of a map on which names and geometry agree."""


@pytest.mark.parametrize("name", MOCAP)
def test_the_map_of_recorded_skeletons(mocap, name):
    skeleton = bvh_skeleton(mocap / name)
    found = find_humanoid(skeleton)
    assert found.names(skeleton.names) == MOCAP[name]


@pytest.mark.parametrize("name", CHARACTERS)
def test_the_map_of_characters(characters, name):
    skeleton, poses, _ = character(characters, name)
    found = find_humanoid(skeleton, poses=poses)
    assert found.names(skeleton.names) == CHARACTERS[name]
    assert found.confidence > CLEAR


def test_of_joints_with_the_same_name_the_outermost_are_taken(characters):
    """A rig whose hips, thighs and head each have a child of their own name."""
    skeleton, poses, order = character(characters, "mixamo_hunter")
    found = find_humanoid(skeleton, poses=poses)
    assert [order[joint] for joint in (found.hips, found.left_thigh, found.right_thigh)] == [56, 54, 55]
    assert found.head is not None and order[found.head] == 57


def test_a_skeleton_without_names_is_mapped_by_geometry(characters):
    skeleton, poses, order = character(characters, "derived_noname")
    assert not any(skeleton.names)
    found = find_humanoid(skeleton, poses=poses)
    assert found.names(tuple(map(str, order))) == NO_NAMES
    assert 0.5 < found.confidence < CLEAR
    assert any("not by names" in line for line in found.explanation)


def test_of_two_chains_like_legs_the_one_that_moves_is_taken():
    """A rig without names has stiff copies of its legs under the root, which reach lower."""
    adult = body()
    legs = np.arange(12, 20)
    parents = np.concatenate((adult.parents, [0 if adult.parents[j] == 0 else adult.parents[j] + 8 for j in legs]))
    offsets = np.concatenate((adult.offsets, adult.offsets[legs] - [0.0, 0.01, 0.0]))
    names = tuple(f"k{joint}" for joint in range(28))
    skeleton = Skeleton(names, parents, offsets, (), np.arange(28))
    rotations = np.tile([1.0, 0.0, 0.0, 0.0], (20, 28, 1))
    swing = np.sin(np.arange(20) / 3)
    for thigh, sign in ((12, 1), (16, -1)):
        rotations[:, thigh] = quat_from_axis_angle([1.0, 0.0, 0.0], 0.3 * sign * swing)
        rotations[:, thigh + 1] = quat_from_axis_angle([1.0, 0.0, 0.0], 0.8 * np.abs(swing))
    poses = forward_kinematics(skeleton, np.zeros((20, 3)), rotations)[0]
    found = find_humanoid(skeleton, poses=poses)
    assert found.limb("left", LEG) == (12, 13, 14, 15) and found.limb("right", LEG) == (16, 17, 18, 19)
    assert find_humanoid(skeleton, poses=poses[:1]).left_thigh != 12  # one pose cannot tell


def test_feet_that_hang_under_the_root_are_found(characters):
    skeleton, poses, _ = character(characters, "quaternius_platformer")
    found = assign_roles(skeleton, poses=poses)
    roles, humanoid = need_roles(found), need_humanoid(found)
    assert any("Foot.L is not under the leg" in line for line in humanoid.explanation)
    assert found.mirror[roles.left_foot[0]] == roles.right_foot[0]
    hip, knee, ankle = poses[0, [roles.left_hip, humanoid.left_shin, roles.left_foot[0]]]
    distance = np.linalg.norm(knee - hip) + np.linalg.norm(ankle - knee)
    assert leg_length_of(found, need_humanoid(found)) == pytest.approx(distance)


@pytest.mark.parametrize("name", ["vrm0_cryptovoxels", "vrm0_godette", "vrm1_example"])
def test_a_vrm_humanoid_overrides_to_the_same_map(characters, name):
    skeleton, poses, _ = character(characters, name)
    bones = json.loads((characters / "joints.json").read_text())["files"][name]["vrm_humanoid"]
    joints = {bone: joint for bone, joint in bones.items() if joint in skeleton.names}
    found = find_humanoid(skeleton, poses=poses, overrides=joints)
    assert found.names(skeleton.names) == CHARACTERS[name]


@pytest.mark.parametrize("name", ["cgspeed_daz", "dfki_walk", "mass_walk", "mixamorig_colon", "sway", "wham"])
def test_the_reader_finds_the_same_map_from_poses(mocap, name):
    clip = read_bvh(mocap / "field" / f"{name}.bvh")
    humanoid = need_humanoid(clip.skeleton)
    assert humanoid.names(clip.skeleton.names) == MOCAP[f"field/{name}.bvh"]
    assert humanoid.confidence > CLEAR


def test_a_skeleton_rooted_at_the_headset_keeps_its_head(mocap):
    clip = read_bvh(mocap / "field" / "slimevr_head_root.bvh")
    humanoid = need_humanoid(clip.skeleton)
    assert humanoid.names(clip.skeleton.names) == MOCAP["field/slimevr_head_root.bvh"]
    # a body without arms has a map but not all roles
    assert clip.skeleton.roles is None
    assert_refused(lambda: need_roles(clip.skeleton), place="skeleton", rule_mentions="left_shoulder")


def test_a_joint_above_the_hips_can_be_named(mocap, tmp_path):
    (tmp_path / "roles.json").write_text('{"head": "HMD", "neck": ["Neck", "Head"]}')
    clip = read_bvh(mocap / "field" / "slimevr_head_root.bvh", roles_file=tmp_path / "roles.json")
    named = need_humanoid(clip.skeleton).names(clip.skeleton.names)
    assert (named["head"], named["neck"], named["spine"]) == ("HMD", ["Neck", "Head"], ["Waist", "Chest"])


def test_roles_are_a_view_of_the_map():
    skeleton = synthetic_skeleton()
    humanoid, roles = need_humanoid(skeleton), need_roles(skeleton)
    assert (roles.hips, roles.head) == (humanoid.hips, humanoid.head)
    assert (roles.left_hip, roles.left_foot) == (humanoid.left_thigh, (humanoid.left_foot, humanoid.left_toe))
    assert (roles.right_shoulder, roles.right_hand) == (humanoid.right_upper_arm, humanoid.right_hand)


def test_a_map_and_its_skeleton_survive_json():
    skeleton = synthetic_skeleton()
    humanoid = need_humanoid(skeleton)
    assert map_from_json(json.loads(json.dumps(map_to_json(humanoid)))) == humanoid
    assert skeleton_from_json(json.loads(json.dumps(skeleton_to_json(skeleton)))).humanoid == humanoid


def test_a_skeleton_of_an_earlier_version_loads_and_its_map_is_found():
    data = skeleton_to_json(synthetic_skeleton())
    del data["humanoid"]
    old = skeleton_from_json(data)
    assert old.humanoid is None and old.roles == synthetic_skeleton().roles
    assert need_humanoid(old) == synthetic_skeleton().humanoid


def test_a_damaged_map_is_refused_by_its_bone():
    data = skeleton_to_json(synthetic_skeleton())
    del data["humanoid"]["left_shin"]
    assert_refused(lambda: skeleton_from_json(data, "run.json"), file="run.json", value="no left_shin")


# names


@pytest.mark.parametrize(
    ("names", "plain"),
    [
        (("mixamorig:Hips", "mixamorig:LeftLeg"), ("Hips", "LeftLeg")),
        (("root", "Bip01 Pelvis", "Bip01 Spine", "Bip01 L Thigh"), ("root", "Pelvis", "Spine", "L Thigh")),
        (("CC_Base_Hip", "CC_Base_Head", "CC_Base_L_Calf", "Hair"), ("Hip", "Head", "L_Calf", "Hair")),
        (("hips_0", "spine_1", "head_2"), ("hips", "spine", "head")),
        # two joints have the same number, so these are no counters of an exporter
        (("spine_01", "spine_02", "neck_01"), ("spine_01", "spine_02", "neck_01")),
        (("leg_L_1", "leg_L_2", "torso"), ("leg_L_1", "leg_L_2", "torso")),
        (("Left_Hip", "Left_Knee", "Left_Foot", "Hips"), ("Left_Hip", "Left_Knee", "Left_Foot", "Hips")),
    ],
)
def test_what_exporters_add_to_names_is_removed(names, plain):
    assert plain_names(names) == plain


@pytest.mark.parametrize(
    ("left", "right"),
    [("LeftArm", "RightArm"), ("l_arm", "r_arm"), ("arm.L", "arm.R"), ("ArmL", "ArmR"), ("Left-Arm", "Right-Arm")]
    + [("larm", "rarm"), ("arm_lft", "arm_rgt"), ("Left arm", "Right arm"), ("LARM", "RARM"), ("arml", "armr")],
)
def test_sides_are_read_in_any_spelling(left, right):
    labels = read_names((left, right, "hips", "head"))
    assert [label.side for label in labels] == ["left", "right", "", ""]
    assert labels[0].part == labels[1].part == "arm"


# overrides


@pytest.mark.parametrize(
    ("overrides", "bones"),
    [
        ({"left_hip": "l_calf", "left_shin": "l_foot", "left_foot": "l_toe"}, {"left_thigh": 13, "left_toe": None}),
        ({"left_thigh": "l_calf", "left_shin": "l_foot", "left_foot": "l_toe"}, {"left_thigh": 13, "left_foot": 15}),
        ({"spine": [], "neck": ["spine", "neck"]}, {"spine": (), "neck": (1, 2)}),
        ({"left_clavicle": None, "head": "neck"}, {"left_clavicle": None, "head": 2}),
        ({"leftHand": "l_forearm", "leftLowerArm": "l_upperarm", "leftUpperArm": "l_clavicle"}, {"left_hand": 6}),
        ({"spine": "spine", "chest": "neck", "leftThumbDistal": "head"}, {"spine": (1, 2)}),
    ],
)
def test_overrides_name_bones_roles_or_vrm_bones(overrides, bones):
    if "leftHand" in overrides:
        overrides["left_clavicle"] = None
    found = find_humanoid(body(), overrides=overrides).joints()
    assert {bone: found[bone] for bone in bones} == bones


@pytest.mark.parametrize(
    ("overrides", "place", "value"),
    [
        ({"left_hip": "l_thigh", "left_thigh": "l_calf"}, "bone left_thigh", "'l_calf'"),
        ({"left_hand": "l_forearm", "left_lower_arm": "l_forearm"}, "bone left_lower_arm", "'l_forearm'"),
        ({"left_shin": None}, "bone left_shin", "None"),
        ({"spine": "chest"}, "bone spine", "'chest'"),
        ({"left_shin": "l_hand"}, "skeleton", "left: l_hand is not below l_thigh"),
        ({"hips": "l_foot"}, "skeleton", "left: l_thigh is not below l_foot"),
    ],
)
def test_contradicting_or_impossible_overrides_are_refused(overrides, place, value):
    assert_refused(lambda: find_humanoid(body(), overrides=overrides), place=place, value=value)


def test_the_ends_of_a_limb_are_enough():
    skeleton = without_names(body())
    names = skeleton.names
    overrides = {"left_hip": names[12], "left_foot": names[14], "right_hip": names[16], "right_foot": names[18]}
    flat = replace(skeleton, offsets=np.zeros_like(skeleton.offsets))  # nothing but the overrides can tell
    found = find_humanoid(flat, overrides=overrides)
    assert (found.left_shin, found.right_shin) == (13, 17)


# what is refused


@pytest.mark.parametrize(
    ("leg", "trunk"), [(0.2, 0.35), (0.5, 0.6), (0.6, 0.9), (2.2, 2.0)], ids=["cat", "dog", "wolf", "elephant"]
)
@pytest.mark.parametrize("named", [True, False], ids=["named", "unnamed"])
def test_animals_on_four_legs_are_refused(leg, trunk, named):
    skeleton = quadruped(leg, trunk, named=named)
    assert_refused(lambda: find_humanoid(skeleton), place="skeleton", rule_mentions="may not be a humanoid")
    assert assign_roles(skeleton).roles is None
    assert_refused(lambda: need_roles(assign_roles(skeleton)), rule_mentions="may not be a humanoid")


@pytest.mark.parametrize("legs", [3, 4])
def test_animals_on_more_legs_are_refused(legs):
    assert_refused(lambda: find_humanoid(crab(legs)), place="skeleton", rule_mentions="may not be a humanoid")


def test_a_user_may_insist_that_an_animal_is_a_humanoid():
    skeleton = quadruped(0.5, 0.6, named=True)
    found = find_humanoid(skeleton, overrides={"left_hip": "LeftUpLeg", "right_hip": "RightUpLeg"})
    assert found.confidence <= 0.5 and any(line.startswith("doubtful") for line in found.explanation)


def test_a_person_on_all_fours_is_a_person():
    """Who crawls through a whole clip still stands in the pose of zero rotations."""
    animal = quadruped(0.5, 0.6, named=True)
    crawling = rest_pose(animal)[[animal.names.index(name) for name in CRAWLING.split()]]
    found = find_humanoid(body(), poses=crawling[None])
    assert found.confidence > CLEAR
    # without names the poses are all there is
    assert_refused(lambda: find_humanoid(without_names(body()), poses=crawling[None]), rule_mentions="humanoid")


def test_an_animal_without_a_rest_pose_is_refused():
    animal = quadruped(0.5, 0.6, named=True)
    poses = rest_pose(animal)[None]
    flat = np.zeros_like(animal.offsets)
    flat[1:, 0] = np.linalg.norm(animal.offsets[1:], axis=1) * [
        -1 if n.startswith("R") else 1 for n in animal.names[1:]
    ]
    assert_refused(lambda: find_humanoid(replace(animal, offsets=flat), poses=poses), rule_mentions="humanoid")


@pytest.mark.parametrize("missing", ["r_thigh", "l_thigh"])
def test_one_leg_is_refused(missing):
    rows = [row for row in zip(body().names, body().parents, body().offsets, strict=True)]
    kept = [name for name, _, _ in rows if name[:2] != missing[:2] or name.split("_")[1] not in "thigh calf foot toe"]
    listed = [
        (name, rows[parent][0] if parent >= 0 else "", tuple(offset)) for name, parent, offset in rows if name in kept
    ]
    assert_refused(lambda: find_humanoid(tree(listed)), place="skeleton", rule_mentions="right_thigh")


def test_a_chain_is_refused():
    chain = Skeleton(tuple("abcdef"), np.arange(-1, 5), np.tile([0.0, 0.1, 0.0], (6, 1)), (), np.arange(6))
    assert_refused(lambda: find_humanoid(chain, source="snake.bvh"), file="snake.bvh", rule_mentions="left_thigh")


# what is doubtful


def test_legs_of_different_length_are_doubtful():
    skeleton = body()
    offsets = skeleton.offsets.copy()
    offsets[13] *= 1.6
    found = find_humanoid(replace(skeleton, offsets=offsets))
    assert found.confidence < CLEAR and any("differ in length" in line for line in found.explanation)


def test_sides_that_the_toes_contradict_are_doubtful():
    skeleton = body()
    offsets = skeleton.offsets * [-1.0, 1.0, 1.0]
    found = find_humanoid(replace(skeleton, offsets=offsets))
    assert found.left_thigh == 12  # names decide
    assert found.confidence <= 0.5 and any("toes" in line for line in found.explanation)


def test_every_bone_is_an_attribute_of_the_map():
    humanoid = synthetic_skeleton().humanoid
    assert isinstance(humanoid, HumanoidMap) and set(humanoid.joints()) == set(BONES)
