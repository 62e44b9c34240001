"""Laws of rigs and poses: they equal the NumPy kinematics of clips on any tree, under `vmap` and `jit`."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.ik.pose import Pose, Rig, forward_kinematics, make_rig, pose_from_world, turn_joint
from pfnn_jax.errors import InputError
from pfnn_jax.motion import kinematics
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.kinematics import quat_between, quat_from_axis_angle, quat_multiply, quat_normalise, quat_rotate
from pfnn_jax.motion.skeleton import need_roles
from tests.motion.skeletons import body, body_clip, random_clip

FLOAT32 = 5e-6  # metres and quaternion entries after chains of a dozen products
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def poses_of(clip) -> Pose:
    return Pose(hips=jnp.asarray(clip.root_positions, jnp.float32), rotations=jnp.asarray(clip.rotations, jnp.float32))


def plain_rig(skeleton) -> Rig:
    """Returns a rig of any tree, without limbs."""
    return Rig(tuple(map(int, skeleton.parents)), tuple(map(tuple, skeleton.offsets.tolist())), (), (), 1.0)


@pytest.mark.parametrize("seed, joints", [(0, 1), (1, 2), (2, 9), (3, 40)])
def test_forward_kinematics_equals_that_of_clips_on_any_tree(seed, joints):
    clip = random_clip(np.random.default_rng(seed), joints, 4)
    expected = kinematics.forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    found = jax.vmap(lambda pose: forward_kinematics(plain_rig(clip.skeleton), pose))(poses_of(clip))
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=4 * FLOAT32)  # bones of this tree are metres long


def test_pose_from_world_inverts_forward_kinematics():
    clip = body_clip(frames=6)
    rig, poses = make_rig(clip.skeleton), poses_of(clip)
    _, world = jax.vmap(lambda pose: forward_kinematics(rig, pose))(poses)
    again = jax.vmap(lambda hips, q: pose_from_world(rig, hips, q))(poses.hips, world)
    np.testing.assert_allclose(again.rotations, poses.rotations, atol=FLOAT32)


def test_turning_a_joint_turns_its_descendants_only():
    clip = body_clip(frames=1)
    rig = make_rig(clip.skeleton)
    pose = jax.tree.map(lambda leaf: leaf[0], poses_of(clip))
    positions, world = forward_kinematics(rig, pose)
    knee = rig.legs[0][1]
    delta = quat_from_axis_angle(jnp.array([0.3, -0.2, 0.9]), jnp.float32(0.7))
    moved, turned = forward_kinematics(rig, turn_joint(rig, pose, world, knee, delta))
    positions, delta = np.asarray(positions, float), np.asarray(delta, float)
    below = [joint for joint in range(rig.num_joints) if knee in kinematics_chain(rig, joint)]
    others = [joint for joint in range(rig.num_joints) if joint not in below]
    around = positions[knee]
    np.testing.assert_allclose(
        np.asarray(moved)[below], around + quat_rotate(delta, positions[below] - around), atol=FLOAT32
    )
    np.testing.assert_array_equal(np.asarray(moved)[others], positions[others])
    np.testing.assert_allclose(turned[knee], quat_multiply(delta, np.asarray(world[knee])), atol=FLOAT32)


def kinematics_chain(rig: Rig, joint: int) -> list[int]:
    chain = []
    while joint >= 0:
        chain.append(joint)
        joint = rig.parents[joint]
    return chain


def test_a_rig_is_hashable_and_names_both_legs_and_arms():
    clip = body_clip()
    rig = make_rig(clip.skeleton)
    assert hash(rig) == hash(make_rig(clip.skeleton))
    names = clip.skeleton.names
    assert [[names[j] for j in leg] for leg in rig.legs] == [
        ["l_thigh", "l_calf", "l_foot", "l_toe"],
        ["r_thigh", "r_calf", "r_foot", "r_toe"],
    ]
    assert [[names[j] for j in arm] for arm in rig.arms] == [
        ["l_upperarm", "l_forearm", "l_hand"],
        ["r_upperarm", "r_forearm", "r_hand"],
    ]
    assert rig.feet == (14, 15, 18, 19)


def test_the_knee_is_found_behind_joints_without_length():
    clip = body_clip()
    skeleton = clip.skeleton
    offsets = np.insert(skeleton.offsets, 13, 0.0, axis=0)  # a twist joint without length below the left hip
    parents = np.insert(np.where(skeleton.parents >= 13, skeleton.parents + 1, skeleton.parents), 13, 12)
    parents[14] = 13
    names = (*skeleton.names[:13], "l_twist", *skeleton.names[13:])
    roles = replace(need_roles(skeleton), left_foot=(15, 16), right_hip=17, right_foot=(19, 20))
    rig = make_rig(replace(skeleton, names=names, parents=parents, offsets=offsets, roles=roles))
    assert rig.legs == ((12, 14, 15, 16), (17, 18, 19, 20))
    assert rig.leg_length == pytest.approx(make_rig(skeleton).leg_length)


def test_a_skeleton_without_roles_or_knees_is_refused():
    with pytest.raises(InputError, match="hips"):
        make_rig(body())
    skeleton = body_clip().skeleton
    stiff = replace(skeleton, roles=replace(need_roles(skeleton), left_hip=13))
    with pytest.raises(InputError, match="knee"):
        make_rig(stiff, "stiff.bvh")


@pytest.mark.parametrize(
    "name",
    ["bandai-namco-2/dataset-2_walk-turn-left_normal_001.bvh", "100style/Neutral_FW.bvh", "xia/neutral_01.bvh"],
)
def test_rigs_of_real_skeletons(mocap, name):
    files = [mocap / name] if (mocap / name).exists() else sorted((mocap / name.split("/")[0]).glob("*.bvh"))[:1]
    skeleton = read_bvh(files[0]).skeleton
    rig = make_rig(skeleton)
    for hip, knee, heel, toe in rig.legs:
        assert hip < knee < heel <= toe
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    for _, knee, heel, _ in rig.legs:
        assert 0.35 < lengths[knee] / rig.leg_length < 0.65
        assert 0.35 < lengths[heel] / rig.leg_length < 0.65
    assert all(len(arm) >= 3 for arm in rig.arms)


def test_quaternions_of_both_libraries_agree():
    random = np.random.default_rng(0)
    q, r = quat_normalise(random.normal(size=(2, 7, 4)))
    v, w = random.normal(size=(2, 7, 3))
    for function, arguments in (
        (quat_multiply, (q, r)),
        (quat_rotate, (q, v)),
        (kinematics.quat_conjugate, (q,)),
        (quat_normalise, (3 * q,)),
        (quat_from_axis_angle, (v, w[:, 0])),
        (quat_between, (v, w)),
        (kinematics.quat_exp, (v,)),
        (kinematics.quat_from_yaw, (w[:, 0],)),
        (kinematics.quat_from_forward_up, (v, w)),
        (kinematics.quat_from_matrix, (kinematics.quat_to_matrix(q),)),
    ):
        expected = function(*arguments)
        found = function(*(jnp.asarray(a, jnp.float32) for a in arguments))
        assert isinstance(found, jax.Array) and found.dtype == jnp.float32
        assert isinstance(expected, np.ndarray) and expected.dtype == np.float64
        np.testing.assert_allclose(found, expected, atol=FLOAT32)


def test_gradients_of_quaternions_are_finite_at_singular_values():
    zero, x = jnp.zeros(3), jnp.array([1.0, 0.0, 0.0])
    with jax.debug_nans(True):
        for function, at in (
            (quat_normalise, jnp.zeros(4)),
            (lambda v: quat_from_axis_angle(v, 1.0), zero),
            (lambda v: quat_between(v, x), zero),
            (lambda v: quat_between(v, x), -x),
            (lambda v: quat_between(v, x), x),
            (kinematics.quat_exp, zero),
            (lambda v: kinematics.quat_from_forward_up(v, x), zero),
            (lambda v: kinematics.quat_from_forward_up(v, x), x),
        ):
            assert np.isfinite(function(at)).all()
            assert np.isfinite(jax.jacobian(function)(at)).all()
    np.testing.assert_allclose(quat_between(zero, x), IDENTITY)
