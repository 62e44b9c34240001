"""Laws of retargeting, between real skeletons and for bodies in any pose."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.kinematics import quat_from_axis_angle, quat_normalise
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.retargeting import retarget as retargeting
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.retargeting.chains import resample_chain
from pfnn_jax.motion.retargeting.feet import flat_foot, resting_foot, sole_heights
from pfnn_jax.motion.retargeting.reference import find_reference, reference_pose, stands
from pfnn_jax.motion.retargeting.resting import find_resting_heights
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton, need_roles, skeleton_from_json, skeleton_to_json
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise
from tests.motion.headsets import without_arms
from tests.motion.retargeting import (
    SOURCES,
    angles,
    called,
    example,
    known_heights,
    measured_heights,
    moved,
    padded,
    renamed,
    scaled,
    skeleton_with_rest,
    turned_at,
    with_rest,
    world,
)
from tests.motion.skeletons import body_clip
from tests.raising import assert_refused

EXACT = 1e-9
SAME_PATH = 1e-7  # metres: through an arccos near its steep end
MEAN_ANGLE = 1.5  # degrees, over the joints that both skeletons have
ANKLES = 0.01  # metres, mean over the frames
FLOOR = 0.01  # metres
RESTING = 0.005  # metres, mean over the frames in which a foot stands flat
STANDING = 0.2  # share of the frames in which it does
KNEES = 2e-3  # metres that a knee moves where the leg is straight: it bends by a quarter of a degree
SLIDE, STILL = 1.2, 0.02  # times as far as in the source, and leg lengths per second that no eye sees
LARGEST_STEP = 15.0  # degrees a frame at 120 fps
SIDEWAYS = 0.95  # cosine of the angle by which the two-bone legs may differ from the source's thighs
ANY_AXES = 0.06  # metres by which joints move where neither zero pose nor reference show how the body stands straight

ARMLESS = 0.02  # metres: without arms the reference pose of the trunk is found from hips and head alone
HANGS = 0.8  # cosine of the angle between a hanging arm and the vertical, on a body that leans

PAIRS = list(permutations(SOURCES, 2))


def ankles(clip: MotionClip) -> np.ndarray:
    roles = need_roles(clip.skeleton)
    return world(clip)[0][:, [roles.left_foot[0], roles.right_foot[0]]]


def counterparts(skeleton: Skeleton, other: Skeleton) -> list[int]:
    """Returns the joints of parts that both skeletons have; of a longer spine, those that the shorter one holds."""
    own, there = humanoid_of(skeleton).joints(), humanoid_of(other).joints()
    joints = []
    for part, joint in own.items():
        if isinstance(joint, tuple):
            other_joint = there[part]
            assert isinstance(other_joint, tuple)
            numbers = np.arange(len(joint) + 1)[:, None, None] * np.ones((1, 1, 4))
            count = len(other_joint)
            if part == "neck":  # whose last joint is the head
                numbers = np.arange(len(joint) + 2)[:, None, None] * np.ones((1, 1, 4))
                held = resample_chain(np.swapaxes(numbers, 0, 1), count + 1, lower=True)[0, :-1, 0]
            else:
                held = resample_chain(np.swapaxes(numbers, 0, 1), count)[0, :, 0]
            joints += [joint[k - 1] for k in held.astype(int)] if count < len(joint) else list(joint)
        elif joint is not None and there[part] is not None:
            joints.append(joint)
    return joints


@pytest.mark.parametrize("name", SOURCES)
def test_retargeting_onto_the_same_skeleton_is_the_identity(mocap, name):
    clip = example(mocap, name)
    same = retarget(clip, clip.skeleton)
    assert same.scale == 1.0
    np.testing.assert_array_equal(same.clip.rotations, clip.rotations)
    np.testing.assert_array_equal(same.clip.root_positions, clip.root_positions)


def test_the_identity_holds_without_its_shortcut(mocap, monkeypatch):
    monkeypatch.setattr(retargeting, "same_bones", lambda *_: False)
    for name in ("bandai", "100style", "procedural"):
        clip = example(mocap, name)
        body = humanoid_of(clip.skeleton)
        mapped = [joint for joint in body.joints().values() if isinstance(joint, int)]
        same = retarget(clip, clip.skeleton).clip
        np.testing.assert_allclose(world(same)[0][:, mapped], world(clip)[0][:, mapped], atol=KNEES, err_msg=name)


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_there_and_back_keeps_joint_angles_and_ankles(mocap, source, target):
    clip, skeleton = example(mocap, source), example(mocap, target).skeleton
    there = retarget(clip, skeleton)
    back = retarget(there.clip, clip.skeleton)
    joints = counterparts(clip.skeleton, skeleton)
    assert angles(world(clip)[1], world(back.clip)[1])[:, joints].mean() < MEAN_ANGLE
    error = there.scale * np.linalg.norm(ankles(clip) - ankles(back.clip), axis=-1)
    assert error.mean() < ANKLES
    assert back.scale == pytest.approx(1 / there.scale)


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_left_and_right_never_change(mocap, source, target):
    clip, skeleton = example(mocap, source), example(mocap, target).skeleton
    other = retarget(clip, skeleton).clip
    maps = humanoid_of(clip.skeleton), humanoid_of(skeleton)
    for side in ("left", "right"):
        for part, below, least in (("upper_arm", "lower_arm", 1 - EXACT), ("thigh", "shin", SIDEWAYS)):
            bones = []
            for body, motion in zip(maps, (clip, other), strict=True):
                positions = world(motion)[0]
                start, end = (getattr(body, f"{side}_{name}") for name in (part, below))
                bone = positions[:, end] - positions[:, start]
                bones.append(bone / np.linalg.norm(bone, axis=-1, keepdims=True))
            assert np.sum(bones[0] * bones[1], axis=-1).mean() > least, f"{side} {part}"


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_feet_stay_above_the_floor(mocap, source, target):
    clip, skeleton = example(mocap, source), example(mocap, target).skeleton
    moved_clip = retarget(clip, skeleton)
    floor = moved_clip.scale * soles(clip).min()
    assert soles(moved_clip.clip).min() > floor - FLOOR
    assert heights(moved_clip.clip).min() > floor + min(known_heights(skeleton).min(), 0.0) - FLOOR


@pytest.mark.parametrize("take", ("neutral_22_000", "proud_13_000"))
def test_a_kick_and_a_run_do_not_make_joints_jump(mocap, take):
    clip = read_bvh(mocap / "xia-test" / f"{take}.bvh")
    for target in ("bandai", "procedural"):
        rotations = retarget(clip, example(mocap, target).skeleton).clip.rotations
        assert angles(rotations[1:], rotations[:-1]).max() < LARGEST_STEP


def soles(clip: MotionClip) -> np.ndarray:
    """Returns the height [T] of the lower sole above the floor of the clip's skeleton."""
    body = humanoid_of(clip.skeleton)
    reference = reference_pose(clip.skeleton, body)
    feet = [flat_foot(clip.skeleton, body, reference, side) for side in ("left", "right")]
    return sole_heights(world(clip)[0], body, [*map(resting_foot, feet, known_heights(clip.skeleton))])


def heights(clip: MotionClip) -> np.ndarray:
    """Returns the heights [T, 2, 2] of ankle and toe (last axis) of the left and the right foot."""
    roles = need_roles(clip.skeleton)
    return world(clip)[0][:, [*roles.left_foot, *roles.right_foot], 1].reshape(-1, 2, 2)


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_standing_feet_rest_at_the_targets_own_heights_and_come_back_to_the_sources(mocap, source, target):
    clip, skeleton = example(mocap, source), example(mocap, target).skeleton
    there = retarget(clip, skeleton).clip
    back = retarget(there, clip.skeleton).clip
    own, other = known_heights(clip.skeleton), known_heights(skeleton)
    standing = find_standing(clip)
    for motion, rest in ((there, other), (back, own)):
        excess = np.where(standing, heights(motion) - rest, 0.0).sum(axis=0) / standing.sum(axis=0)
        assert np.abs(excess).max() < RESTING, motion.skeleton.names[:2]


@given(seed=st.integers(0, 99), yaw=st.floats(-3.1, 3.1), y=st.floats(-1, 1))
def test_where_the_sources_floor_lies_does_not_matter_if_the_targets_is_known(seed, yaw, y):
    clip = body_clip(seed, frames=60, spread=0.2)
    plain, other = retarget(clip, SYNTHETIC), retarget(moved(clip, yaw, np.array([0.0, y, 0.0])), SYNTHETIC)
    np.testing.assert_allclose(world(other.clip)[0], world(moved(plain.clip, yaw, np.zeros(3)))[0], atol=SAME_PATH)


def test_feet_of_a_symmetric_walk_rest_alike_where_only_a_motion_shows_the_reference(mocap):
    walk, _ = synthesise("neutral", np.zeros(360), np.full(360, 1.3))
    target = example(mocap, "bandai").skeleton
    known = measured_heights(retarget(walk, target).clip)
    np.testing.assert_allclose(known, known_heights(target), atol=RESTING)
    bare = replace(target, resting_heights=None)
    left, right = measured_heights(retarget(walk, bare).clip)
    np.testing.assert_allclose(left, right, atol=RESTING)


def test_procedural_walkers_rest_where_their_skeleton_says():
    for style in STYLES:
        walk, _ = synthesise(style, np.zeros(360), np.ones(360))
        found = measured_heights(walk)
        np.testing.assert_allclose(found, known_heights(SYNTHETIC), atol=RESTING, err_msg=style)


def test_a_body_on_tiptoe_would_rest_as_in_its_rest_pose():
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (60, SYNTHETIC.num_joints, 1))
    roles = need_roles(SYNTHETIC)
    turns[:, [roles.left_foot[0], roles.right_foot[0]]] = quat_from_axis_angle([1.0, 0.0, 0.0], np.radians(30.0))
    clip = MotionClip(SYNTHETIC, 60.0, np.zeros((60, 3)), turns)
    clip = moved(clip, 0.0, np.array([0.0, known_heights(SYNTHETIC)[0, 1] - heights(clip)[0, 0, 1], 0.0]))
    found = measured_heights(clip)
    np.testing.assert_allclose(found, known_heights(SYNTHETIC), atol=RESTING)


def test_a_clip_too_short_for_a_step_shows_no_floor():
    clip, _ = synthesise("neutral", np.zeros(40), np.ones(40))
    assert find_resting_heights(clip, humanoid_of(SYNTHETIC)) is None


def find_standing(clip: MotionClip) -> np.ndarray:
    """Returns the frames [T, 2, 1] in which the left and the right foot stand flat: those in which it is lowest."""
    lowness = heights(clip).sum(axis=-1)
    return (lowness <= np.quantile(lowness, STANDING, axis=0))[..., None]


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_standing_feet_do_not_slide_more_than_the_sources(mocap, source, target):
    clip, skeleton = example(mocap, source), example(mocap, target).skeleton
    other = retarget(clip, skeleton).clip
    own, there = slide(clip, clip), slide(other, clip)
    assert there < SLIDE * own + STILL


def slide(clip: MotionClip, source: MotionClip) -> float:
    """Returns the mean speed in leg lengths per second of the part on which each foot stands in the source.

    That is its heel or its toe, whichever moves less while it is in contact.
    """
    speeds = []
    for motion in (source, clip):
        roles, feet = need_roles(motion.skeleton), world(motion)[0]
        feet = feet[:, [*roles.left_foot, *roles.right_foot]][..., [0, 2]]
        leg = leg_length_of(motion.skeleton, humanoid_of(motion.skeleton))
        speeds.append(np.linalg.norm(np.diff(feet, axis=0), axis=-1).reshape(-1, 2, 2) * motion.fps / leg)
    contact = foot_contacts(world(source)[0], need_roles(source.skeleton), source.fps)
    contact = (contact[1:] & contact[:-1]).reshape(-1, 2, 2)
    part = np.argmin(np.where(contact, speeds[0], np.inf), axis=-1)[..., None]
    stands_on = np.take_along_axis(contact, part, axis=-1)
    return float(np.take_along_axis(speeds[1], part, axis=-1)[stands_on].mean())


@pytest.mark.parametrize("target", SOURCES)
def test_the_result_is_a_clip_on_the_target_with_its_own_bones(mocap, target):
    clip, skeleton = example(mocap, "momask"), example(mocap, target).skeleton
    result = retarget(clip, skeleton)
    assert result.clip.skeleton is skeleton
    assert result.clip.num_frames == clip.num_frames and result.clip.fps == clip.fps
    np.testing.assert_allclose(np.linalg.norm(result.clip.rotations, axis=-1), 1.0, atol=EXACT)
    bones = world(result.clip)[0][:, 1:] - world(result.clip)[0][:, skeleton.parents[1:]]
    lengths = np.linalg.norm(skeleton.offsets[1:], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(bones, axis=-1), np.broadcast_to(lengths, bones.shape[:2]), atol=EXACT)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("target", ("bandai", "procedural"))
def test_names_do_not_matter(mocap, source, target):
    if source == target:
        return
    clip, other = example(mocap, source), example(mocap, target)
    plain, numbered = retarget(clip, other.skeleton), retarget(renamed(clip), renamed(other).skeleton)
    np.testing.assert_array_equal(plain.clip.rotations, numbered.clip.rotations)
    np.testing.assert_array_equal(plain.clip.root_positions, numbered.clip.root_positions)


@given(seed=st.integers(0, 99), yaw=st.floats(-3.1, 3.1), x=st.floats(-5, 5), y=st.floats(-1, 1), z=st.floats(-5, 5))
def test_turning_and_shifting_the_source_turns_and_shifts_the_result(seed, yaw, x, y, z):
    clip, target = body_clip(seed, spread=0.2), SYNTHETIC
    shift = np.array([x, y, z])
    plain, other = retarget(clip, target), retarget(moved(clip, yaw, shift), target)
    wanted = moved(plain.clip, yaw, plain.scale * shift)
    np.testing.assert_allclose(world(other.clip)[0], world(wanted)[0], atol=SAME_PATH)


@given(seed=st.integers(0, 99), factor=st.floats(0.3, 3.0), larger=st.floats(0.3, 3.0))
def test_the_size_of_neither_side_matters(seed, factor, larger):
    clip, target = body_clip(seed, spread=0.2), example_target()
    plain = retarget(clip, target.skeleton)
    other = retarget(scaled(clip, factor), scaled(target, larger).skeleton)
    assert other.scale == pytest.approx(plain.scale * larger / factor)
    np.testing.assert_allclose(world(other.clip)[0] / larger, world(plain.clip)[0], atol=SAME_PATH)


@settings(max_examples=20)
@given(seed=st.integers(0, 99), source_joints=st.integers(0, 9), target_joints=st.integers(0, 9))
def test_joints_that_are_no_part_of_the_body_do_not_matter(seed, source_joints, target_joints):
    clip, target = body_clip(seed, spread=0.2), example_target()
    plain = retarget(clip, target.skeleton).clip
    more = padded(target, target_joints, seed).skeleton
    other = retarget(padded(clip, source_joints, seed), more).clip
    shared = target.skeleton.num_joints
    np.testing.assert_allclose(world(other)[0][:, :shared], world(plain)[0], atol=SAME_PATH)
    at_rest = np.zeros((clip.num_frames, target_joints, 4))
    at_rest[..., 0] = 1.0
    np.testing.assert_allclose(other.rotations[:, shared:], at_rest, atol=EXACT)


@settings(max_examples=20)
@given(seed=st.integers(0, 99), letters=st.randoms(use_true_random=False))
def test_any_names_give_the_same_motion(seed, letters):
    clip, target = body_clip(seed, spread=0.2), example_target()
    plain = retarget(clip, target.skeleton).clip
    other = retarget(called(clip, letters), called(target, letters).skeleton).clip
    np.testing.assert_array_equal(other.rotations, plain.rotations)


@given(seed=st.integers(0, 99), other=st.integers(0, 99))
def test_local_axes_do_not_matter_where_the_reference_is_known(seed, other):
    clip, target = body_clip(seed, spread=0.2), example_target()
    clip, target = known(clip), known(target)
    plain = retarget(clip, target.skeleton).clip
    poses = [random_rotations(number, each.skeleton.num_joints) for number, each in ((seed, clip), (other, target))]
    turned = retarget(with_rest(clip, poses[0]), skeleton_with_rest(target.skeleton, poses[1])).clip
    np.testing.assert_allclose(world(turned)[0], world(plain)[0], atol=SAME_PATH)
    back = with_rest(plain, poses[1])
    assert angles(world(turned)[1], world(back)[1]).max() < 1e-4


@given(seed=st.integers(0, 99), raised=st.floats(-90, 30), forward=st.floats(-30, 90))
def test_a_rest_pose_with_other_arms_gives_the_same_motion(seed, raised, forward):
    clip, target = body_clip(seed, spread=0.2), example_target()
    plain = retarget(clip, target.skeleton).clip
    changed = [with_rest(each, arms(each.skeleton, raised, forward)) for each in (clip, target)]
    other = retarget(changed[0], changed[1].skeleton).clip
    legs = [joint for joint in range(target.skeleton.num_joints) if joint not in below_arms(target.skeleton)]
    np.testing.assert_allclose(world(other)[0][:, legs], world(plain)[0][:, legs], atol=SAME_PATH)
    roles = need_roles(target.skeleton)
    hands = [roles.left_hand, roles.right_hand]
    np.testing.assert_allclose(world(other)[0][:, hands], world(plain)[0][:, hands], atol=1e-3)


@pytest.mark.parametrize("name", ("100style", "mixamo", "momask", "procedural"))
def test_a_skeleton_of_any_axes_is_understood_from_its_motion(mocap, name):
    clip, target = example(mocap, name), example(mocap, "xia").skeleton
    bare = with_rest(clip, random_rotations(3, clip.skeleton.num_joints))
    assert not stands(bare.skeleton, humanoid_of(bare.skeleton))
    plain, other = retarget(clip, target).clip, retarget(bare, target).clip
    assert np.linalg.norm(world(other)[0] - world(plain)[0], axis=-1).mean() < ANY_AXES


def test_a_stored_skeleton_keeps_the_reference_that_only_a_motion_shows(mocap):
    for name in SOURCES:
        skeleton = example(mocap, name).skeleton
        loaded = skeleton_from_json(skeleton_to_json(skeleton))
        assert (loaded.reference is None) == (name != "bandai")
        body = humanoid_of(skeleton)
        np.testing.assert_array_equal(reference_pose(loaded, body), reference_pose(skeleton, body))


def test_a_reference_pose_is_a_t_pose_that_faces_forward(mocap):
    for name in SOURCES:
        clip = example(mocap, name)
        body = humanoid_of(clip.skeleton)
        reference = reference_pose(clip.skeleton, body)
        pose = with_rest(clip, reference).skeleton.offsets
        lower = pose[body.left_lower_arm] / np.linalg.norm(pose[body.left_lower_arm])
        shin = pose[body.right_shin] / np.linalg.norm(pose[body.right_shin])
        np.testing.assert_allclose(lower, [1, 0, 0], atol=EXACT, err_msg=name)
        np.testing.assert_allclose(shin, [0, -1, 0], atol=EXACT, err_msg=name)
        assert pose[body.left_toe][2] > 0 and abs(pose[body.left_toe][0]) < EXACT


def test_references_of_two_clips_of_one_skeleton_agree(mocap):
    clip = example(mocap, "bandai")
    body = humanoid_of(clip.skeleton)
    halves = [find_reference(clip.skeleton, part, body) for part in (clip.rotations[:50], clip.rotations[50:])]
    apart = angles(*halves)
    assert apart.mean() < 5.0


@given(count=st.integers(1, 6), longer=st.integers(1, 6), seed=st.integers(0, 99))
def test_a_longer_chain_holds_all_that_a_shorter_one_does(count, longer, seed):
    turns = quat_normalise(np.random.default_rng(seed).normal(size=(3, count + 1, 4)))
    count, longer = sorted((count, longer))
    turns = turns[:, : count + 1]
    there = resample_chain(turns, longer)
    np.testing.assert_array_equal(there[:, -1], turns[:, -1])
    back = resample_chain(np.concatenate((turns[:, :1], there), axis=1), count)
    np.testing.assert_array_equal(back, turns[:, 1:])


def test_a_body_without_arms_moves_like_one_with_arms_and_they_hang(mocap):
    clip, target = example(mocap, "mixamo"), example(mocap, "procedural").skeleton
    armless = without_arms(clip)
    assert armless.skeleton.roles is None and armless.skeleton.humanoid is not None
    (whole, _), (points, _) = (world(retarget(each, target).clip) for each in (clip, armless))
    body = humanoid_of(target)
    for joint in (body.hips, body.head, body.left_foot, body.right_toe):
        np.testing.assert_allclose(points[:, joint], whole[:, joint], atol=ARMLESS)
    for upper, hand in ((body.left_upper_arm, body.left_hand), (body.right_upper_arm, body.right_hand)):
        arm = points[:, upper] - points[:, hand]
        assert (arm[..., 1] > HANGS * np.linalg.norm(arm, axis=-1)).all()


def test_the_summary_says_joints_and_scale(mocap):
    result = retarget(example(mocap, "mixamo"), SYNTHETIC)
    assert result.summary == f"retargeted from 55 to 21 joints, legs scaled by {result.scale:.2f}"


def test_ten_thousand_frames_take_less_than_two_seconds(mocap):
    clip = example(mocap, "mixamo")
    frames = np.arange(10_000) % clip.num_frames
    clip = replace(clip, root_positions=clip.root_positions[frames], rotations=clip.rotations[frames])
    times = []
    for _ in range(3):
        began = time.process_time()
        retarget(clip, SYNTHETIC)
        times.append(time.process_time() - began)
    assert min(times) < 2.0


def test_a_skeleton_without_ankles_is_refused(mocap):
    clip = example(mocap, "procedural")
    body = humanoid_of(clip.skeleton)
    bare = replace(clip.skeleton, humanoid=replace(body, left_foot=None, left_toe=None))
    assert_refused(lambda: retarget(clip, bare), place="skeleton", rule_mentions="ankle")


def test_a_skeleton_with_legs_of_no_length_is_refused():
    clip = body_clip()
    skeleton = replace(SYNTHETIC, offsets=0.0 * SYNTHETIC.offsets)
    assert_refused(lambda: retarget(clip, skeleton), place="skeleton", rule_mentions="apart")


def example_target() -> MotionClip:
    """Returns a clip on the skeleton of procedural walkers."""
    return PROCEDURAL


def known(clip: MotionClip) -> MotionClip:
    """Returns the clip with its reference pose stored in its skeleton."""
    skeleton = clip.skeleton
    return replace(clip, skeleton=replace(skeleton, reference=reference_pose(skeleton, humanoid_of(skeleton))))


def random_rotations(seed: int, count: int) -> np.ndarray:
    return quat_normalise(np.random.default_rng(seed).normal(size=(count, 4)))


def arms(skeleton: Skeleton, raised: float, forward: float) -> np.ndarray:
    """Returns the zero pose [J, 4] of a T pose with the arms raised and turned forward, in degrees."""
    body, turns = humanoid_of(skeleton), {}
    for side, sign in (("left", 1.0), ("right", -1.0)):
        axis, angle = (np.array([0.0, -forward, raised]), np.radians(np.hypot(forward, raised)))
        turns[getattr(body, f"{side}_upper_arm")] = quat_from_axis_angle(sign * axis, np.array(angle))
    return turned_at(skeleton, turns)


def below_arms(skeleton: Skeleton) -> set[int]:
    """Returns the arms and all joints below them."""
    roles = need_roles(skeleton)
    found = {roles.left_shoulder, roles.right_shoulder}
    for joint in range(skeleton.num_joints):
        if skeleton.parents[joint] in found:
            found.add(joint)
    return found


PROCEDURAL = example(None, "procedural")  # type: ignore[arg-type] # reads no file
SYNTHETIC = PROCEDURAL.skeleton
