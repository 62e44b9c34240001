"""Joint roles from names in eight conventions, from geometry, and from a user's file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import find_humanoid
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_yaw
from pfnn_jax.motion.roles import assign_roles, find_mirror, find_roles, is_hips_name
from pfnn_jax.motion.skeleton import Roles, Skeleton
from tests.motion.skeletons import MIRROR, NAMES, OFFSETS, PARENTS, body
from tests.raising import assert_refused

EXPECTED = Roles(
    hips=0,
    left_hip=12,
    right_hip=16,
    left_shoulder=5,
    right_shoulder=9,
    left_foot=(14, 15),
    right_foot=(18, 19),
    left_hand=7,
    right_hand=11,
    head=3,
)


def sided(trunk: str, arm: str, leg: str, left: str, right: str, form: str) -> tuple[str, ...]:
    """Joint names in the order of the body, from the parts' names, the sides' marks and a form."""
    arms = [[form.format(side=side, part=part) for part in arm.split()] for side in (left, right)]
    legs = [[form.format(side=side, part=part) for part in leg.split()] for side in (left, right)]
    return (*trunk.split("|"), *arms[0], *arms[1], *legs[0], *legs[1])


CONVENTIONS = {
    "cmu": sided(
        "Hips|Spine|Neck1|Head",
        *("Shoulder Arm ForeArm Hand", "UpLeg Leg Foot ToeBase", "Left", "Right", "{side}{part}"),
    ),
    "100style": sided(
        "Hips|Chest|Neck|Head",
        *("Collar Shoulder Elbow Wrist", "Hip Knee Ankle Toe", "Left", "Right", "{side}{part}"),
    ),
    "bandai": sided(
        "Hips|Spine|Neck|Head",
        *("Shoulder UpperArm LowerArm Hand", "UpperLeg LowerLeg Foot Toes", "L", "R", "{part}_{side}"),
    ),
    "mixamo": sided(
        "mixamorig:Hips|mixamorig:Spine|mixamorig:Neck|mixamorig:Head",
        *("Shoulder Arm ForeArm Hand", "UpLeg Leg Foot ToeBase", "Left", "Right", "mixamorig:{side}{part}"),
    ),
    "biped": sided(
        "Bip01 Pelvis|Bip01 Spine|Bip01 Neck|Bip01 Head",
        *("Clavicle UpperArm Forearm Hand", "Thigh Calf Foot Toe0", "L", "R", "Bip01 {side} {part}"),
    ),
    "unreal": sided(
        "pelvis|spine_01|neck_01|head",
        *("clavicle upperarm lowerarm hand", "thigh calf foot ball", "l", "r", "{part}_{side}"),
    ),
    "blender": sided(
        "hips|spine|neck|head",
        *("shoulder upper_arm forearm hand", "thigh shin foot toe", "L", "R", "{part}.{side}"),
    ),
    "smpl": sided(
        "Pelvis|Spine1|Neck|Head",
        *("Collar Shoulder Elbow Wrist", "Hip Knee Ankle Foot", "L", "R", "{side}_{part}"),
    ),
    "lower-case": sided(
        "root|lowerback|neck|head",
        *("clavicle humerus radius wrist", "femur tibia foot toes", "l", "r", "{side}{part}"),
    ),
}


@pytest.mark.parametrize("convention", CONVENTIONS)
def test_names_give_roles_and_partners(convention):
    # offsets of zero: nothing but the names can tell
    skeleton = replace(body(CONVENTIONS[convention]), offsets=np.zeros_like(OFFSETS))
    assert find_roles(skeleton) == EXPECTED
    np.testing.assert_array_equal(find_mirror(skeleton), MIRROR)


@pytest.mark.parametrize("yaw", [0.0, 1.5, np.pi, -2.0])
def test_geometry_finds_roles_without_names(yaw):
    skeleton = body(tuple(f"joint{chr(97 + joint)}" for joint in range(len(NAMES))))
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (1, len(NAMES), 1))
    turns[:, 0] = quat_from_yaw(yaw)
    pose = forward_kinematics(skeleton, np.zeros((1, 3)), turns)[0]
    found = assign_roles(skeleton, poses=lambda: pose)
    assert found.roles == EXPECTED
    np.testing.assert_array_equal(found.mirror, MIRROR)


def test_geometry_skips_duplicates_of_zero_length():
    names = ("a", "b", "c", "d", "e", "f", "g", "h", "i", "j", "k", "m", "n", "o", "p", "q", "s", "t", "u", "v")
    parents, offsets = np.insert(PARENTS, 12, 0), np.insert(OFFSETS, 12, 0.0, axis=0)
    parents = np.where(parents >= 12, parents + 1, parents)
    parents[13] = 12  # the left thigh is a child of a duplicate of the hips, as with LHipJoint
    skeleton = Skeleton((*names[:12], "dummy", *names[12:]), parents, offsets, (), np.arange(21))
    roles = find_roles(skeleton)
    assert (roles.left_hip, roles.left_foot, roles.right_hip) == (13, (15, 16), 17)


def test_a_foot_without_toes_is_the_ankle_twice():
    kept = [joint for joint in range(len(NAMES)) if NAMES[joint] not in ("l_toe", "r_toe")]
    parents = np.array([kept.index(parent) if parent >= 0 else -1 for parent in PARENTS[kept]])
    names = tuple(NAMES[joint] for joint in kept)
    roles = find_roles(Skeleton(names, parents, OFFSETS[kept], (), np.arange(len(kept))))
    assert roles.left_foot == (names.index("l_foot"),) * 2


def test_hips_are_the_joint_above_both_legs_whatever_is_called_pelvis():
    names = tuple("body" if name == "hips" else "hips" if name == "spine" else name for name in NAMES)
    assert find_roles(body(names)).hips == 0


def test_leg_length_is_hip_to_ankle():
    skeleton = body()
    assert leg_length_of(skeleton, find_humanoid(skeleton)) == pytest.approx(0.42 + np.hypot(0.42, 0.02))


@pytest.mark.parametrize("name", ["Hips", "mixamorig:Hips", "Bip01 Pelvis", "CC_Base_Pelvis_01"])
def test_hips_are_recognised_by_name(name):
    assert is_hips_name(name) and not is_hips_name("joint_Root")


def test_a_roles_file_overrides_names(tmp_path):
    file = tmp_path / "roles.json"
    file.write_text(json.dumps({"head": "neck", "left_foot": "l_foot", "right_foot": ["r_foot", "r_toe"]}))
    roles = assign_roles(body(), file).roles
    assert roles is not None
    assert (roles.head, roles.left_foot, roles.right_foot, roles.hips) == (2, (14, 14), (18, 19), 0)


@pytest.mark.parametrize(
    ("content", "place", "value"),
    [
        ('{"tail": "hips"}', "bone", "'tail'"),
        ('{"hips": "Tail"}', "bone hips", "'Tail'"),
        ('{"hips": 3}', "bone hips", "3"),
        ('{"hips": ["hips", "spine"]}', "bone hips", "['hips', 'spine']"),
        ('{"left_foot": []}', "bone left_foot", "[]"),
        ('{"left_foot": [{}, "l_toe"]}', "bone left_foot", "{}"),
        ('{"left_foot": ["head", "l_toe"]}', "skeleton", "left: l_toe is not below head"),
        ('{"left_hip": "r_thigh", "left_foot": "r_foot"}', "skeleton", "r_thigh"),
        ("[]", "file", "list"),
        ("{", "file", None),
        ("\xff\xfe", "file", None),
    ],
)
def test_a_bad_roles_file_is_refused_by_name(tmp_path, content, place, value):
    file = tmp_path / "roles.json"
    file.write_bytes(content.encode("latin-1"))
    error = assert_refused(lambda: assign_roles(body(), file), file=file, place=place, value=value)
    assert "\n" not in str(error)


def test_an_absent_roles_file_is_refused(tmp_path):
    assert_refused(lambda: assign_roles(body(), tmp_path / "none.json"), file="none.json", place="file")


def test_a_skeleton_without_legs_has_no_roles():
    chain = Skeleton(("a", "b", "c"), np.array([-1, 0, 1]), np.eye(3), (), np.arange(3))
    assert assign_roles(chain).roles is None
    find = lambda: find_roles(chain, source="toy.bvh")  # noqa: E731
    assert_refused(find, file="toy.bvh", place="skeleton", value="joints a, b, c", rule_mentions="left_thigh")


def test_partners_have_partners_as_parents():
    # a left prop without a right one, and a pair whose parents are not a pair
    names = ("hips", "l_arm", "r_arm", "l_prop", "l_strap", "r_strap")
    skeleton = Skeleton(names, np.array([-1, 0, 0, 1, 1, 1]), np.zeros((6, 3)), (), np.arange(6))
    np.testing.assert_array_equal(find_mirror(skeleton), [0, 2, 1, 3, 4, 5])
