"""Laws of foot locking: identity without contact, no sliding and rest in contact, smoothness, equivariance."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.ik.fix_feet import fix_feet
from pfnn_jax.control.ik.foot_lock import FootLockConfig, initial_locks, lock_feet
from pfnn_jax.control.ik.pose import Pose, make_rig
from pfnn_jax.errors import InputError
from pfnn_jax.evaluation.metrics import contact_sliding
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics as clip_kinematics
from pfnn_jax.motion.kinematics import quat_from_axis_angle, quat_from_yaw, quat_multiply, quat_rotate
from tests.motion.skeletons import body_clip

FLOAT32 = 1e-4  # metres after some hundred frames
STILL = 1e-3  # metres that a held toe may move
RESTS = 1e-3  # metres from its height of rest: 5 % of an offset of 2 cm are left after the time of release
FRAMES, CYCLE = 240, 60


def walk(slide: float = 0.25) -> tuple[MotionClip, np.ndarray]:
    """Returns a walk of bent legs whose stance feet slide by `slide` metres per second, and its contacts [T, 4]."""
    skeleton = body_clip().skeleton
    time = np.arange(FRAMES)
    angles = np.zeros((FRAMES, skeleton.num_joints))
    contacts = np.zeros((FRAMES, 4))
    for side, (hip, knee, heel, _) in enumerate(make_rig(skeleton).legs):
        phase = 2 * np.pi * (time / CYCLE + 0.5 * side)
        swing = np.maximum(np.sin(phase), 0.0)
        angles[:, hip] = -0.35 - 0.3 * np.cos(phase) * -1.0 - 0.4 * swing
        angles[:, knee] = 0.6 + 0.5 * swing
        angles[:, heel] = -(angles[:, hip] + angles[:, knee])
        contacts[:, 2 * side : 2 * side + 2] = (np.sin(phase) < -0.3)[:, None]
    rotations = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), angles)
    roots = np.stack([0.05 * np.sin(time / 30), np.full(FRAMES, 0.95), time * ((0.9 + slide) / 60)], axis=-1)
    return MotionClip(skeleton, 60.0, roots, rotations), contacts


def joints(clip: MotionClip) -> np.ndarray:
    return clip_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


@pytest.fixture(scope="module")
def walked() -> tuple[MotionClip, np.ndarray, MotionClip]:
    clip, contacts = walk()
    return clip, contacts, fix_feet(clip, contacts)


def test_held_toes_do_not_move_and_heels_slide_less(walked):
    clip, contacts, fixed = walked
    feet = list(make_rig(clip.skeleton).feet)
    before, after = joints(clip)[:, feet], joints(fixed)[:, feet]
    settled = contacts.astype(bool)
    for _ in range(4):  # frames in which a toe takes the lead of its foot
        settled[1:] &= settled[:-1]
    both = settled[1:] & settled[:-1]
    moved = np.linalg.norm(np.diff(after[..., [0, 2]], axis=0), axis=-1)
    assert moved[:, [1, 3]][both[:, [1, 3]]].max() < STILL
    assert contact_sliding(before, contacts > 0.5, 60.0) > 0.2
    assert contact_sliding(after, contacts > 0.5, 60.0) < 0.25 * contact_sliding(before, contacts > 0.5, 60.0)


def stand(heights: np.ndarray) -> tuple[MotionClip, np.ndarray]:
    """Returns bent legs whose feet are at heights [T] above their rest, and the heights [4] of rest."""
    clip, _ = walk()
    clip = replace(clip, rotations=np.repeat(clip.rotations[:1], len(heights), axis=0))
    hips = np.array([[0.0, 0.95, 0.0]]) + heights[:, None] * [0.0, 1.0, 0.0]
    feet = list(make_rig(clip.skeleton).feet)
    rest = joints(replace(clip, root_positions=hips))[0, feet, 1] - heights[0]
    skeleton = replace(clip.skeleton, resting_heights=rest.reshape(2, 2))
    return replace(clip, skeleton=skeleton, root_positions=hips), rest


@pytest.mark.parametrize(("first", "lowest"), [(0.03, 0.0), (0.03, -0.01), (0.03, 0.01), (-0.02, -0.02)])
def test_held_feet_come_down_to_where_they_rest_and_stay(first, lowest):
    """The contact begins while the feet are above or below their rest, where the network may leave them by a little."""
    begins, low, rises = 5, 30, 60
    lift = np.interp(np.arange(90), [0, low, rises, rises + 10], [first, lowest, lowest, lowest + 0.01])
    clip, rest = stand(lift)
    contacts = np.repeat((np.arange(90) >= begins)[:, None], 4, axis=1).astype(float)
    feet = joints(fix_feet(clip, contacts))[:, list(make_rig(clip.skeleton).feet)]
    above = feet[..., 1] - rest
    np.testing.assert_allclose(above[:begins], np.repeat(lift[:begins, None], 4, axis=1), atol=FLOAT32)
    assert above.min() > min(first, 0.0) - FLOAT32  # never below the rest, but where the contact began there
    np.testing.assert_allclose(above[low + 20 :], max(lowest, 0.0), atol=RESTS)
    assert (
        np.sign(first) * np.diff(above[begins:], axis=0)
    ).max() < FLOAT32  # it does not rise with the predicted foot
    assert np.abs(np.diff(feet[begins:, :, [0, 2]], axis=0)).max() < STILL


def test_held_feet_come_down_without_a_jump():
    """No change of velocity is larger than the predicted foot's, which the ground takes away where the foot rests."""
    heights = 0.03 * np.cos(np.pi * np.clip(np.arange(90) / 40.0, 0.0, 1.0))  # ends 3 cm below the rest
    clip, rest = stand(heights)
    contacts = np.repeat((np.arange(90) >= 5)[:, None], 4, axis=1).astype(float)
    contacts[70:] = 0.0
    above = joints(fix_feet(clip, contacts))[:, list(make_rig(clip.skeleton).feet), 1] - rest
    assert np.abs(np.diff(above, 2, axis=0)).max() < np.abs(np.diff(heights)).max() + FLOAT32


def test_only_legs_and_the_height_of_the_hips_change_and_bones_keep_their_lengths(walked):
    clip, _, fixed = walked
    rig = make_rig(clip.skeleton)
    moving = {joint for hip, knee, heel, _ in rig.legs for joint in (hip, knee, heel)}
    others = [joint for joint in range(rig.num_joints) if joint not in moving]
    np.testing.assert_allclose(fixed.rotations[:, others], clip.rotations[:, others], atol=1e-7)
    np.testing.assert_allclose(fixed.root_positions[:, [0, 2]], clip.root_positions[:, [0, 2]], atol=1e-7)
    sunk = clip.root_positions[:, 1] - fixed.root_positions[:, 1]
    assert sunk.min() > -1e-6 and sunk.max() <= FootLockConfig().max_drop * rig.leg_length
    found = joints(fixed)
    lengths = np.linalg.norm(found[:, 1:] - found[:, clip.skeleton.parents[1:]], axis=-1)
    expected = np.linalg.norm(clip.skeleton.offsets[1:], axis=-1)
    np.testing.assert_allclose(lengths, np.tile(expected, (FRAMES, 1)), atol=1e-6)


def test_without_contact_nothing_changes():
    clip, contacts = walk()
    fixed = fix_feet(clip, 0.0 * contacts)
    np.testing.assert_allclose(joints(fixed), joints(clip), atol=FLOAT32)


def test_corrected_joints_move_smoothly(walked):
    """Accelerations are no larger than if the sliding foot stopped within a frame."""
    clip, _, fixed = walked
    feet = [joint for leg in make_rig(clip.skeleton).legs for joint in leg]
    before, after = (np.linalg.norm(np.diff(joints(c)[:, feet], 2, axis=0), axis=-1) * 3600 for c in (clip, fixed))
    speed = np.linalg.norm(np.diff(joints(clip)[:, feet], axis=0), axis=-1).max() * 60
    assert after.max() < before.max() + 0.5 * speed * 60
    assert np.median(after) < 2.0 * np.median(before) + 1.0


def test_foot_lock_is_equivariant_under_rigid_motion(walked):
    clip, contacts, fixed = walked
    yaw, shift = quat_from_yaw(2.0), np.array([40.0, 0.0, -7.0])
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(yaw, rotations[:, 0])
    elsewhere = replace(clip, root_positions=quat_rotate(yaw, clip.root_positions) + shift, rotations=rotations)
    np.testing.assert_allclose(
        joints(fix_feet(elsewhere, contacts)), quat_rotate(yaw, joints(fixed)) + shift, atol=FLOAT32
    )


def test_foot_lock_is_equivariant_under_mirroring(walked):
    clip, contacts, fixed = walked
    mirror, flip = clip.skeleton.mirror, np.array([1.0, 1.0, -1.0, -1.0])
    reflect = np.array([-1.0, 1.0, 1.0])
    other = replace(clip, root_positions=clip.root_positions * reflect, rotations=clip.rotations[:, mirror] * flip)
    found = joints(fix_feet(other, contacts[:, [2, 3, 0, 1]]))
    np.testing.assert_allclose(found, joints(fixed)[:, mirror] * reflect, atol=FLOAT32)


def test_vmap_equals_one_by_one():
    clip, contacts = walk()
    rig = make_rig(clip.skeleton)
    rows = slice(20, 36)
    poses = Pose(
        hips=jnp.asarray(clip.root_positions[rows], jnp.float32),
        rotations=jnp.asarray(clip.rotations[rows], jnp.float32),
    )
    touch = jnp.asarray(contacts[rows], jnp.float32)
    step = partial(lock_feet, rig)
    locks = jax.tree.map(lambda leaf: jnp.stack([leaf] * 16), initial_locks(rig))
    together = jax.jit(jax.vmap(step))(poses, touch, locks)
    one = jax.jit(step)
    for i in (0, 7, 15):
        alone = one(*jax.tree.map(lambda leaf, i=i: leaf[i], (poses, touch)), initial_locks(rig))
        for a, b in zip(jax.tree.leaves(alone), jax.tree.leaves(together), strict=True):
            np.testing.assert_allclose(a, b[i], atol=1e-5)


def test_gradients_are_finite_at_full_stretch():
    skeleton = body_clip().skeleton
    rig = make_rig(skeleton)
    straight = jnp.zeros((rig.num_joints, 4)).at[:, 0].set(1.0)  # the T-pose: both legs at their full length

    def loss(hips, rotations):
        locks = replace(initial_locks(rig), held=jnp.ones(4) > 0.0, strength=jnp.ones(4))
        pose, _ = lock_feet(rig, Pose(hips=hips, rotations=rotations), jnp.ones(4), locks)
        return jnp.sum(pose.rotations**2 * jnp.arange(4.0)[None]) + jnp.sum(pose.hips)

    with jax.debug_nans(True):
        slope = jax.jit(jax.grad(loss, argnums=(0, 1)))(jnp.array([0.0, 0.95, 0.0]), straight)
    assert all(np.isfinite(leaf).all() for leaf in slope)


def test_wrong_shapes_and_settings_out_of_range_are_refused():
    clip, contacts = walk()
    for place, labels, joints in (
        ("contacts", contacts[:-1], None),
        ("joints", contacts, np.zeros((FRAMES, 2, 3))),
    ):
        with pytest.raises(InputError) as caught:
            fix_feet(clip, labels, joints=joints)
        assert caught.value.place == place
    with pytest.raises(ValueError, match="lock_threshold"):
        FootLockConfig(lock_threshold=0.2, release_threshold=0.3)
    with pytest.raises(ValueError, match="release_time"):
        FootLockConfig(release_time=0.0)
