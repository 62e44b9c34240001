"""Laws of the humanoid map: what must not change it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.motion.humanoid.find import find_humanoid
from pfnn_jax.motion.humanoid.pairs import find_mirror
from pfnn_jax.motion.kinematics import (
    quat_conjugate,
    quat_from_euler,
    quat_from_yaw,
    quat_multiply,
    quat_normalise,
    quat_rotate,
)
from pfnn_jax.motion.skeleton import Skeleton, rest_pose
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.up_axis import TURNS
from tests.motion.retargeting import skeleton_with_rest
from tests.motion.rigs import bvh_skeleton, without_names
from tests.motion.skeletons import body

SEEDS = st.integers(0, 2**32 - 1)
SOURCES = ("synthetic", "body", "100style/Neutral_FW.bvh", "xia/neutral_01_000.bvh", "field/mixamorig_colon.bvh")
HELPERS = ("UpLegTwist", "armTwist_01", "Foot_end", "IK_foot", "Pole", "Hips_Ctrl", "LeafBone", "Torso_RIGMESH")
HELPERS += ("Hand_Tip", "footRoll", "KneeHelper", "HeadNub")


@pytest.fixture(scope="module")
def skeletons(mocap) -> dict[str, Skeleton]:
    files = {name: bvh_skeleton(mocap / name) for name in SOURCES if name.endswith(".bvh")}
    return {"synthetic": synthetic_skeleton(), "body": body(), **files}


def named(skeleton: Skeleton, poses: np.ndarray | None = None) -> dict:
    return find_humanoid(skeleton, poses=poses).names(skeleton.names)


def reordered(skeleton: Skeleton, random: np.random.Generator) -> tuple[Skeleton, np.ndarray]:
    """The skeleton with the children of every joint in another order, and the new index of each old joint."""
    children = {joint: list(np.flatnonzero(skeleton.parents == joint)) for joint in range(-1, skeleton.num_joints)}
    order, waiting = [], [0]
    while waiting:
        order.append(waiting.pop())
        waiting += list(random.permutation(children[order[-1]]).astype(int))
    place = np.argsort(order)
    parents = np.array([place[p] if (p := skeleton.parents[joint]) >= 0 else -1 for joint in order])
    names = tuple(skeleton.names[joint] for joint in order)
    sites = tuple((int(place[joint]), site) for joint, site in skeleton.end_sites)
    return Skeleton(names, parents, skeleton.offsets[order], sites, np.arange(len(order))), place


def padded(skeleton: Skeleton, random: np.random.Generator) -> Skeleton:
    """The skeleton with helper joints as leaves, and twist joints within its limbs."""
    names, parents = list(skeleton.names), [int(parent) for parent in skeleton.parents]
    offsets = [np.array(offset) for offset in skeleton.offsets]
    for number in range(int(random.integers(1, 12))):
        side = ("Left", "Right", "")[int(random.integers(3))]
        names.append(f"{side}{HELPERS[int(random.integers(len(HELPERS)))]}{number}")
        parents.append(int(random.integers(skeleton.num_joints)))
        offsets.append(random.normal(size=3) * np.abs(skeleton.offsets).max())
    return Skeleton(tuple(names), np.array(parents), np.array(offsets), skeleton.end_sites, np.arange(len(names)))


def with_twist_joints(skeleton: Skeleton, random: np.random.Generator) -> Skeleton:
    """The skeleton with a twist joint in the middle of some bones, on the way to the child."""
    names: list[str] = []
    parents: list[int] = []
    offsets: list[np.ndarray] = []
    place: dict[int, int] = {-1: -1}
    for joint in range(skeleton.num_joints):
        parent, offset = place[int(skeleton.parents[joint])], skeleton.offsets[joint]
        if parent >= 0 and np.linalg.norm(offset) > 0 and random.random() < 0.3:
            names.append(f"{skeleton.names[joint]}_twist")
            parents.append(parent)
            offsets.append(offset / 2)
            parent, offset = len(names) - 1, offset / 2
        place[joint] = len(names)
        names.append(skeleton.names[joint])
        parents.append(parent)
        offsets.append(offset)
    sites = tuple((place[joint], site) for joint, site in skeleton.end_sites)
    return Skeleton(tuple(names), np.array(parents), np.array(offsets), sites, np.arange(len(names)))


@pytest.mark.parametrize("source", SOURCES)
@settings(max_examples=30)
@given(seed=SEEDS)
def test_the_order_of_siblings_does_not_change_the_map(skeletons, source, seed):
    skeleton = skeletons[source]
    mixed, place = reordered(skeleton, np.random.default_rng(seed))
    assert named(mixed) == named(skeleton)
    mirror = find_mirror(skeleton, find_humanoid(skeleton))
    np.testing.assert_array_equal(find_mirror(mixed, find_humanoid(mixed))[place], place[mirror])


@pytest.mark.parametrize("source", SOURCES)
@settings(max_examples=30)
@given(seed=SEEDS)
def test_helper_joints_do_not_change_the_map(skeletons, source, seed):
    random = np.random.default_rng(seed)
    skeleton = skeletons[source]
    assert named(padded(skeleton, random)) == named(skeleton)
    assert named(with_twist_joints(skeleton, random)) == named(skeleton)


@pytest.mark.parametrize("source", SOURCES)
@settings(max_examples=30)
@given(seed=SEEDS, scale=st.floats(0.001, 1000.0), yaw=st.floats(-np.pi, np.pi))
def test_names_and_places_give_the_same_map(skeletons, source, seed, scale, yaw):
    """Joints without telling names are mapped by geometry, wherever the body stands, faces, and whatever its size."""
    skeleton = skeletons[source]
    random = np.random.default_rng(seed)
    mute = without_names(skeleton)
    turn = quat_from_yaw(yaw)
    poses = scale * quat_rotate(turn, rest_pose(skeleton) + random.normal(size=3))[None]
    found = find_humanoid(replace(mute, offsets=scale * skeleton.offsets), poses=poses)
    humanoid = find_humanoid(skeleton)
    expected = humanoid.joints()
    # joints at one place, as the lower back and the hips of CMU, cannot be told apart by their places
    assert {bone: joint for bone, joint in found.joints().items() if bone not in ("spine", "neck")} == {
        bone: joint for bone, joint in expected.items() if bone not in ("spine", "neck")
    }
    assert set(found.spine + found.neck) <= set(humanoid.spine + humanoid.neck)


SIDES = ("{side}_{part}", "{part}_{side}", "{part}.{side}", "{side} {part}", "{side}-{part}")
SIDE_WORDS = (("l", "r"), ("L", "R"), ("left", "right"), ("Left", "Right"), ("Lft", "Rgt"))
PREFIXES = ("", "mixamorig:", "hero:rig:", "Bip01 ", "Character1_", "DEF-", "Armature|")
SUFFIXES = ("", "_jnt", "_bind_{at:03d}", "_{at:02d}")


@settings(max_examples=100)
@given(
    form=st.sampled_from(SIDES),
    words=st.sampled_from(SIDE_WORDS),
    prefix=st.sampled_from(PREFIXES),
    suffix=st.sampled_from(SUFFIXES),
    case=st.sampled_from([str, str.upper, str.title]),
)
def test_spellings_do_not_change_the_map(form, words, prefix, suffix, case):
    skeleton = body()
    names = []
    for at, name in enumerate(skeleton.names):
        side, _, part = name.rpartition("_")
        plain = form.format(side=words["lr".index(side)], part=case(part)) if side else case(part)
        names.append(prefix + plain + suffix.format(at=at))
    other = replace(skeleton, names=tuple(names))
    found, expected = find_humanoid(other), find_humanoid(skeleton)
    assert (found.joints(), found.confidence) == (expected.joints(), expected.confidence)
    np.testing.assert_array_equal(find_mirror(other, found), find_mirror(skeleton, expected))


@pytest.mark.parametrize("source", SOURCES)
@settings(max_examples=30)
@given(seed=SEEDS, some=st.booleans())
def test_the_rest_pose_does_not_change_the_map(skeletons, source, seed, some):
    """The zero pose may be any, in all joints or in some, if other poses show how the body stands."""
    skeleton, random = skeletons[source], np.random.default_rng(seed)
    pose = quat_normalise(random.normal(size=(skeleton.num_joints, 4)))
    if some:
        pose = np.where(random.random(skeleton.num_joints)[:, None] < 0.3, pose, [1.0, 0.0, 0.0, 0.0])
    other = skeleton_with_rest(skeleton, pose)
    poses, expected = rest_pose(skeleton)[None], find_humanoid(skeleton)
    found = find_humanoid(other, poses=poses)
    assert found.joints() == expected.joints()
    np.testing.assert_array_equal(find_mirror(other, found), find_mirror(skeleton, expected))
    mute = find_humanoid(without_names(other), poses=poses)
    assert (mute.left_thigh, mute.right_hand) == (expected.left_thigh, expected.right_hand)


@pytest.mark.parametrize("source", ["synthetic", "body", "100style/Neutral_FW.bvh"])
@settings(max_examples=30)
@given(axis=st.sampled_from(sorted(TURNS)), yaw=st.floats(-np.pi, np.pi), lean=st.floats(-25, 25))
def test_no_rotation_changes_the_map(skeletons, source, axis, yaw, lean):
    """Any axis may point up, whatever the body faces and however it leans."""
    skeleton = skeletons[source]
    tilt = quat_from_euler(np.array([np.radians(lean), 0.0, 0.0]), "XYZ")
    turn = quat_multiply(quat_conjugate(TURNS[axis]), quat_multiply(quat_from_yaw(yaw), tilt))
    poses = quat_rotate(turn, rest_pose(skeleton))[None]
    assert find_humanoid(skeleton, poses=poses).joints() == find_humanoid(skeleton).joints()


@pytest.mark.parametrize("source", ["synthetic", "body", "100style/Neutral_FW.bvh"])
@pytest.mark.parametrize("up", [(0, 0, 90), (0, 0, -90), (90, 0, 0), (-90, 0, 0), (180, 0, 0)])
def test_the_axis_that_is_up_does_not_change_the_map(skeletons, source, up):
    skeleton = skeletons[source]
    turn = quat_from_euler(np.radians(up), "XYZ")
    poses = quat_rotate(turn, rest_pose(skeleton))[None]
    expected = find_humanoid(skeleton).joints()
    assert find_humanoid(skeleton, poses=poses).joints() == expected
    assert find_humanoid(without_names(skeleton), poses=poses).joints() == expected


@settings(max_examples=30)
@given(seed=SEEDS)
def test_partners_are_each_others_partners_and_so_are_their_parents(seed):
    skeleton, _ = reordered(padded(body(), np.random.default_rng(seed)), np.random.default_rng(seed))
    mirror = find_mirror(skeleton, find_humanoid(skeleton))
    np.testing.assert_array_equal(mirror[mirror], np.arange(len(mirror)))
    paired = np.flatnonzero(mirror != np.arange(len(mirror)))
    np.testing.assert_array_equal(skeleton.parents[mirror[paired]], mirror[skeleton.parents[paired]])
