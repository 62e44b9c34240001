"""Geometry on the ground: local and world frames are inverse to each other, and NumPy and JAX agree."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.motion.ground import (
    angle_between,
    facing_of,
    to_local,
    to_world,
    turn,
    turn_towards,
    wrap_angle,
    yaw_of,
)

EXACT = 1e-12  # float64, sums of a few terms of order one
SINGLE = 2e-6  # float32, sums of a few terms of order one


@pytest.mark.parametrize("width", [2, 3])
def test_to_world_undoes_to_local(width):
    rng = np.random.default_rng(0)
    facing, v = facing_of(rng.uniform(-4, 4, 7)), rng.normal(size=(7, 5, width))
    np.testing.assert_allclose(to_world(to_local(v, facing), facing), v, atol=EXACT)
    forward = np.stack([facing[:, 0], np.zeros(7), facing[:, 1]], -1)[:, [0, 1, 2] if width == 3 else [0, 2]]
    np.testing.assert_allclose(to_local(forward, facing)[:, -1], 1.0, atol=EXACT)


def test_yaw_of_undoes_facing_of():
    yaw = np.linspace(-3.1, 3.1, 50)
    np.testing.assert_allclose(yaw_of(facing_of(yaw)), yaw, atol=EXACT)
    np.testing.assert_allclose(facing_of(np.pi / 2), [1.0, 0.0], atol=EXACT)


def test_turning_by_the_angle_between_two_facings_maps_one_to_the_other():
    rng = np.random.default_rng(1)
    a, b = facing_of(rng.uniform(-4, 4, 9)), facing_of(rng.uniform(-4, 4, 9))
    np.testing.assert_allclose(turn(a, angle_between(a, b)), b, atol=EXACT)
    half = turn_towards(a, b, 0.5)
    np.testing.assert_allclose(angle_between(a, half), angle_between(half, b), atol=EXACT)


def test_wrapped_angles_differ_by_whole_turns():
    angle = np.linspace(-20.0, 20.0, 101)
    wrapped = wrap_angle(angle)
    assert (wrapped >= -np.pi).all() and (wrapped < np.pi).all()
    turns = (angle - wrapped) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=EXACT)


@pytest.mark.parametrize("width", [2, 3])
def test_numpy_and_jax_agree(width):
    rng = np.random.default_rng(2)
    yaw, v = rng.uniform(-3, 3, 4), rng.normal(size=(4, 5, width))
    facing, target = facing_of(yaw), facing_of(rng.uniform(-3, 3, 4))
    single = [jnp.asarray(value, jnp.float32) for value in (yaw, v, facing, target)]
    pairs = [
        (facing_of(yaw), facing_of(single[0])),
        (to_world(v, facing), to_world(single[1], single[2])),
        (to_local(v, facing), to_local(single[1], single[2])),
        (to_local(v, facing[0]), to_local(single[1], single[2][0])),
        (angle_between(facing, target), angle_between(single[2], single[3])),
        (turn_towards(facing, target, 0.3), turn_towards(single[2], single[3], 0.3)),
        (wrap_angle(3 * yaw), wrap_angle(3 * single[0])),
        (yaw_of(facing), yaw_of(single[2])),
    ]
    for in_numpy, in_jax in pairs:
        assert in_jax.dtype == jnp.float32
        np.testing.assert_allclose(in_jax, in_numpy, atol=SINGLE)
