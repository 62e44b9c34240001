"""Laws of rotations and of forward kinematics, against SciPy's independent implementation."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_between,
    quat_conjugate,
    quat_exp,
    quat_from_axis_angle,
    quat_from_euler,
    quat_from_forward_up,
    quat_from_matrix,
    quat_from_yaw,
    quat_log,
    quat_multiply,
    quat_normalise,
    quat_rotate,
    quat_slerp,
    quat_to_euler,
    quat_to_matrix,
)
from tests.motion.skeletons import random_clip

FLOAT64 = 1e-12  # a few dozen ulp over short chains of products
LOCKED = 1e-7  # at gimbal lock angles are found from entries of that size
ORDERS = ["".join(order) for order in itertools.permutations("XYZ")]
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def rotations(count: int = 64, seed: int = 0) -> np.ndarray:
    return quat_normalise(np.random.default_rng(seed).normal(size=(count, 4)))


def same_rotation(a: np.ndarray, b: np.ndarray, tolerance: float = FLOAT64) -> bool:
    return bool(np.all(np.abs(np.abs(np.sum(a * b, axis=-1)) - 1.0) < tolerance))


def test_product_applies_the_second_first_and_stays_unit():
    a, b, v = rotations(seed=1), rotations(seed=2), np.random.default_rng(3).normal(size=(64, 3))
    product = quat_multiply(a, b)
    np.testing.assert_allclose(np.linalg.norm(product, axis=-1), 1.0, atol=FLOAT64)
    np.testing.assert_allclose(quat_rotate(product, v), quat_rotate(a, quat_rotate(b, v)), atol=FLOAT64)
    np.testing.assert_allclose(quat_to_matrix(product), quat_to_matrix(a) @ quat_to_matrix(b), atol=FLOAT64)


def test_conjugate_is_the_inverse():
    q = rotations()
    np.testing.assert_allclose(quat_multiply(q, quat_conjugate(q)), np.tile(IDENTITY, (64, 1)), atol=FLOAT64)


def test_leading_axes_broadcast():
    a, b = rotations(6).reshape(2, 3, 1, 4), rotations(5, seed=1)
    assert quat_multiply(a, b).shape == (2, 3, 5, 4)
    assert quat_rotate(a, np.ones((5, 3))).shape == (2, 3, 5, 3)


def test_normalising_zero_gives_the_identity():
    np.testing.assert_array_equal(quat_normalise(np.zeros(4)), IDENTITY)


@pytest.mark.parametrize("order", ORDERS)
def test_euler_order_is_the_order_of_the_channels(order):
    angles = np.random.default_rng(4).uniform(-3, 3, (50, 3))
    expected = Rotation.from_euler(order, angles).as_matrix()  # capitals: about the moving axes, as listed
    np.testing.assert_allclose(quat_to_matrix(quat_from_euler(angles, order)), expected, atol=FLOAT64)


@pytest.mark.parametrize("order", ORDERS)
def test_euler_angles_round_trip(order):
    angles = np.random.default_rng(5).uniform(-1, 1, (200, 3)) * np.array([np.pi, np.pi / 2 - 1e-3, np.pi])
    np.testing.assert_allclose(quat_to_euler(quat_from_euler(angles, order), order), angles, atol=1e-9)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("middle", [np.pi / 2, -np.pi / 2])
def test_gimbal_lock_keeps_the_rotation(order, middle):
    angles = np.random.default_rng(6).uniform(-3, 3, (50, 3))
    angles[:, 1] = middle
    q = quat_from_euler(angles, order)
    back = quat_to_euler(q, order)
    np.testing.assert_allclose(quat_to_matrix(quat_from_euler(back, order)), quat_to_matrix(q), atol=LOCKED)


def test_euler_order_must_name_three_axes():
    with pytest.raises(ValueError, match="XXZ"):
        quat_from_euler(np.zeros(3), "XXZ")


def test_matrices_round_trip_at_every_half_turn():
    half_turns = quat_from_axis_angle(np.eye(3), np.pi)
    q = np.concatenate((rotations(), half_turns, IDENTITY[None]))
    assert same_rotation(quat_from_matrix(quat_to_matrix(q)), q)


def test_log_is_half_the_angle_and_exp_its_inverse():
    axis = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(quat_log(quat_from_axis_angle(axis, 0.8)), 0.4 * axis, atol=FLOAT64)
    q = rotations()
    assert same_rotation(quat_exp(quat_log(q)), q)
    np.testing.assert_allclose(quat_log(q), quat_log(-q), atol=FLOAT64)


@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-9, 1e-6])
def test_log_and_exp_are_smooth_at_the_identity(size):
    v = size * np.array([1.0, -2.0, 2.0]) / 3
    q = quat_exp(v)
    assert np.all(np.isfinite(q))
    np.testing.assert_allclose(quat_log(q), v, atol=1e-15, rtol=1e-6)


def test_slerp_takes_the_shorter_arc_through_its_ends_and_middle():
    a, b = rotations(seed=7), rotations(seed=8)
    assert same_rotation(quat_slerp(a, b, 0.0), a) and same_rotation(quat_slerp(a, b, 1.0), b)
    assert same_rotation(quat_slerp(a, b, 0.3), quat_slerp(a, -b, 0.3))
    turned = quat_slerp(IDENTITY, quat_from_yaw(2.0), 0.25)
    np.testing.assert_allclose(turned, quat_from_yaw(0.5), atol=FLOAT64)
    np.testing.assert_allclose(quat_slerp(a, a, 0.5), a, atol=FLOAT64)


def test_quat_between_maps_one_direction_to_the_other():
    random = np.random.default_rng(9)
    u, v = random.normal(size=(50, 3)), random.normal(size=(50, 3))
    u[0], v[0] = (2.0, 0.0, 0.0), (-1.0, 0.0, 0.0)  # opposite: any axis across
    u[1], v[1] = (0.0, 3.0, 0.0), (0.0, -1.0, 0.0)
    v[2] = u[2]
    unit = [w / np.linalg.norm(w, axis=-1, keepdims=True) for w in (u, v)]
    np.testing.assert_allclose(quat_rotate(quat_between(u, v), unit[0]), unit[1], atol=1e-9)


def test_positive_yaw_turns_forward_to_the_left():
    np.testing.assert_allclose(quat_rotate(quat_from_yaw(np.pi / 2), [0.0, 0.0, 1.0]), [1.0, 0.0, 0.0], atol=FLOAT64)


def test_forward_and_up_round_trip():
    q = rotations()
    forward, up = quat_rotate(q, [0.0, 0.0, 1.0]), quat_rotate(q, [0.0, 1.0, 0.0])
    assert same_rotation(quat_from_forward_up(3.0 * forward, 0.5 * up + 0.2 * forward), q)


def test_forward_kinematics_equals_products_of_matrices():
    clip = random_clip(np.random.default_rng(10), joints=9, frames=7)
    positions, world = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    for frame in range(7):
        transforms = []
        for joint, parent in enumerate(clip.skeleton.parents):
            local = np.eye(4)
            local[:3, :3] = Rotation.from_quat(clip.rotations[frame, joint], scalar_first=True).as_matrix()
            local[:3, 3] = clip.root_positions[frame] if parent < 0 else clip.skeleton.offsets[joint]
            transforms.append(local if parent < 0 else transforms[parent] @ local)
        expected = np.array(transforms)
        np.testing.assert_allclose(positions[frame], expected[:, :3, 3], atol=FLOAT64)
        np.testing.assert_allclose(quat_to_matrix(world[frame]), expected[:, :3, :3], atol=FLOAT64)
