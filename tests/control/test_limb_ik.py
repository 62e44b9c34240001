"""Laws of two-bone limbs and of arms: bones keep their lengths, targets are reached, gradients are finite."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.control.ik.limb import reach_arms, two_bone
from pfnn_jax.control.ik.pose import Pose, forward_kinematics, make_rig
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.two_bone import SOFT, bend
from tests.motion.skeletons import body_clip

FLOAT32 = 2e-5  # metres: a target on a leg of 0.84 m, through one arccos near its steep end
STILL = 2e-3  # quaternion entries of a leg that need not move; a straight one bends by a quarter of a degree
COUNT = 64

CLIP = body_clip(frames=COUNT, spread=0.3)
RIG = make_rig(CLIP.skeleton)
LEG = RIG.legs[0][:3]
POSES = Pose(hips=jnp.asarray(CLIP.root_positions, jnp.float32), rotations=jnp.asarray(CLIP.rotations, jnp.float32))
place = jax.jit(jax.vmap(partial(forward_kinematics, RIG)))
solve = jax.jit(jax.vmap(lambda pose, target: two_bone(RIG, pose, LEG, target)))
POSITIONS = np.asarray(place(POSES)[0])
LENGTHS = np.linalg.norm(CLIP.skeleton.offsets[1:], axis=-1)
SHIFTS = np.random.default_rng(1).normal(0.0, 0.08, (COUNT, 3)).astype(np.float32)
TARGETS = POSITIONS[:, LEG[2]] + SHIFTS


def bones(positions: np.ndarray) -> np.ndarray:
    return np.linalg.norm(positions[:, 1:] - positions[:, CLIP.skeleton.parents[1:]], axis=-1)


def test_targets_within_reach_are_reached_and_bones_keep_their_lengths():
    after = np.asarray(place(solve(POSES, jnp.asarray(TARGETS)))[0])
    reach = np.linalg.norm(TARGETS - POSITIONS[:, LEG[0]], axis=-1) / RIG.leg_length
    assert 10 < (reach < SOFT).sum() < COUNT
    missed = np.linalg.norm(after[:, LEG[2]] - TARGETS, axis=-1)
    assert missed[reach < SOFT].max() < FLOAT32
    np.testing.assert_allclose(bones(after), np.tile(LENGTHS, (COUNT, 1)), atol=FLOAT32)


def test_a_limb_points_at_targets_beyond_its_reach():
    hip = POSITIONS[:, LEG[0]]
    away = TARGETS - hip
    far = hip + away / np.linalg.norm(away, axis=-1, keepdims=True) * (2.0 * RIG.leg_length)
    after = np.asarray(place(solve(POSES, jnp.asarray(far)))[0])
    leg = after[:, LEG[2]] - hip
    length = np.linalg.norm(leg, axis=-1)
    assert (np.sum(leg * away, axis=-1) / length / np.linalg.norm(away, axis=-1)).min() > 1.0 - 1e-6
    full = np.linalg.norm(CLIP.skeleton.offsets[list(LEG[1:])], axis=-1).sum()
    assert length.max() <= full + FLOAT32 and length.min() > 0.997 * full  # a knee bent askew stays a little so


def test_only_hip_and_knee_turn_and_a_reached_target_changes_nothing():
    after = solve(POSES, jnp.asarray(TARGETS))
    others = [joint for joint in range(RIG.num_joints) if joint not in LEG[:2]]
    np.testing.assert_array_equal(np.asarray(after.rotations)[:, others], np.asarray(POSES.rotations)[:, others])
    np.testing.assert_array_equal(after.hips, POSES.hips)
    still = solve(POSES, jnp.asarray(POSITIONS[:, LEG[2]]))
    np.testing.assert_allclose(still.rotations, POSES.rotations, atol=STILL)


def test_two_bone_is_equivariant_under_rigid_motion():
    yaw, shift = quat_from_yaw(1.1), np.array([3.0, 0.0, -2.0])
    turned = quat_multiply(yaw, np.asarray(POSES.rotations[:, 0]))
    poses = Pose(
        hips=jnp.asarray(quat_rotate(yaw, np.asarray(POSES.hips)) + shift, jnp.float32),
        rotations=POSES.rotations.at[:, 0].set(jnp.asarray(turned, jnp.float32)),
    )
    after = place(solve(poses, jnp.asarray(quat_rotate(yaw, TARGETS) + shift, jnp.float32)))[0]
    expected = quat_rotate(yaw, np.asarray(place(solve(POSES, jnp.asarray(TARGETS)))[0])) + shift
    np.testing.assert_allclose(after, expected, atol=10 * FLOAT32)  # knees near full stretch are steep in the target


def test_vmap_and_jit_equal_one_by_one():
    together = solve(POSES, jnp.asarray(TARGETS))
    one = jax.jit(partial(two_bone, RIG), static_argnums=1)(
        jax.tree.map(lambda leaf: leaf[3], POSES), LEG, jnp.asarray(TARGETS[3])
    )
    np.testing.assert_allclose(one.rotations, together.rotations[3], atol=FLOAT32)
    points = [jnp.asarray(p, jnp.float32) for p in (*POSITIONS[3, list(LEG)], TARGETS[3], [0.0, 0.0, 1.0])]
    compiled = jax.jit(bend)(*points)
    with jax.disable_jit():
        eager = bend(*points)
    for a, b in zip(eager, compiled, strict=True):
        np.testing.assert_allclose(a, b, atol=FLOAT32)


def bent_leg(flexion: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns hip, knee and ankle of a leg of two bones of half a metre, hanging down, the knee forward."""
    half = flexion / 2
    knee = np.array([0.0, -0.5 * np.cos(half), 0.5 * np.sin(half)])
    return np.zeros(3), knee, np.array([0.0, -np.cos(half), 0.0])


@pytest.mark.parametrize("flexion", [0.0, 1e-4, 0.02, 0.1, -0.05])
def test_a_straight_leg_bends_its_knee_forward(flexion):
    points = [jnp.asarray(p, jnp.float32) for p in bent_leg(flexion)]
    over, _, end = jax.jit(bend)(*points, jnp.array([0.0, -0.9, 0.0]), jnp.array([0.0, 0.0, 1.0]))
    knee = quat_rotate(over, points[1])
    np.testing.assert_allclose(end, [0.0, -0.9, 0.0], atol=FLOAT32)
    assert float(knee[2]) == pytest.approx(0.5 * np.sin(np.arccos(0.9)), abs=1e-3)


def test_two_bone_is_continuous_through_full_stretch():
    """The knee moves continuously while the target passes beyond the reach of the leg, and back."""
    heights = jnp.linspace(-0.90, -1.10, 401)

    def knee(height):
        hip, knee, heel = (jnp.asarray(p, jnp.float32) for p in bent_leg(0.5))
        over, _, _ = bend(hip, knee, heel, jnp.stack([0.0 * height, height, 0.0 * height]), jnp.array([0.0, 0.0, 1.0]))
        return quat_rotate(over, knee)

    steps = np.linalg.norm(np.diff(np.asarray(jax.jit(jax.vmap(knee))(heights)), axis=0), axis=-1)
    assert steps.max() < 3e-3  # for steps of the target of half a millimetre


def test_gradients_are_correct_at_generic_targets_and_finite_at_singular_ones():
    with jax.enable_x64(True):
        pole = jnp.array([0.1, 0.0, 1.0])

        def end(points, target):
            over, under, found = bend(points[0], points[1], points[2], target, pole)
            return jnp.concatenate([over, under, found])

        for flexion, target in ((0.6, [0.1, -0.8, 0.2]), (0.2, [0.0, -0.97, 0.15]), (1.5, [0.0, -1.4, 0.3])):
            points = [jnp.asarray(p) for p in bent_leg(flexion)]
            check_grads(jax.jit(end), (points, jnp.array(target)), order=1, modes=("rev",), atol=2e-3, rtol=2e-3)
        with jax.debug_nans(True):
            slope = jax.jit(jax.jacrev(end, argnums=(0, 1)))
            for flexion, target in ((0.0, [0.0, -1.0, 0.0]), (0.0, [0.0, -2.0, 0.0]), (0.0, [0.0, 0.0, 0.0])):
                found = slope([jnp.asarray(p) for p in bent_leg(flexion)], jnp.array(target))
                assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(found))
            nowhere = slope([jnp.zeros(3)] * 3, jnp.zeros(3))
            assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(nowhere))


def test_arms_lie_along_predicted_positions():
    reach = jax.jit(jax.vmap(partial(reach_arms, RIG)))
    other = place(Pose(hips=POSES.hips, rotations=POSES.rotations[::-1].at[:, :4].set(POSES.rotations[:, :4])))[0]
    wanted = np.asarray(other) + POSITIONS[:, 1:2] - np.asarray(other)[:, 1:2]  # arms of another pose on this trunk
    after = reach(POSES, jnp.asarray(wanted))
    found = np.asarray(place(after)[0])
    for arm in RIG.arms:
        for upper, lower in zip(arm[:-1], arm[1:], strict=True):
            bone, ray = found[:, lower] - found[:, upper], wanted[:, lower] - found[:, upper]
            cosine = np.sum(bone * ray, -1) / np.linalg.norm(bone, axis=-1) / np.linalg.norm(ray, axis=-1)
            assert cosine.min() > 1.0 - 1e-5
    np.testing.assert_allclose(bones(found), np.tile(LENGTHS, (COUNT, 1)), atol=FLOAT32)
    turned = {joint for arm in RIG.arms for joint in arm[:-1]}
    others = [joint for joint in range(RIG.num_joints) if joint not in turned]
    np.testing.assert_array_equal(np.asarray(after.rotations)[:, others], np.asarray(POSES.rotations)[:, others])
    same = reach(POSES, jnp.asarray(POSITIONS))
    np.testing.assert_allclose(same.rotations, POSES.rotations, atol=1e-3)  # of 1 - cos, half the digits are lost
