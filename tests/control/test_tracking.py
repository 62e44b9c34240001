"""Command tracking and the calibration of speeds: laws of the functions alone, without a network."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.calibration import _best_request
from pfnn_jax.control.loop.state import ROOT, initial_state, turn_state
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command, held_command, steer
from pfnn_jax.control.tracking import (
    StyleSpeed,
    TrackingConfig,
    TrackingState,
    heading_correction,
    init_tracking,
    limit_lookahead,
    network_command,
    update_time_scale,
    update_tracking,
)
from pfnn_jax.control.vectors import length
from pfnn_jax.motion.ground import angle_between
from tests.control.walkers import LAYOUT, WALK, input_row

CONFIG = TrackingConfig()
FLOAT32 = 2e-5
SPEED = StyleSpeed(natural=jnp.float32(1.0), gain=jnp.float32(1.0))
NEAR, FAR = jnp.float32(0.1), jnp.float32(0.5)  # metres between the feet: passing each other, in a step
AHEAD = jnp.asarray([0.0, 1.0])
STOP = Command(velocity=jnp.zeros(2), direction=AHEAD)


def walking(phase: float = 0.0, position=(0.0, 0.0), yaw: float = 0.0):
    layout = LAYOUT["mason2018"]
    return initial_state(
        layout, input_row(layout, WALK), jnp.float32(phase), jnp.asarray(position, jnp.float32), jnp.float32(yaw)
    )


def mirrored(tree):
    """Returns vectors [..., 2] and [..., 3] reflected in the plane x = 0."""

    def flip(leaf):
        if leaf.ndim and leaf.shape[-1] in (2, 3):
            return leaf.at[..., 0].multiply(-1.0)
        return leaf

    return jax.tree.map(flip, tree)


def test_tracking_is_equivariant_under_mirroring():
    before = walking(0.3, (0.4, 1.0), 0.2)
    after = replace(before, positions=jnp.roll(before.positions, -1, 0), directions=jnp.roll(before.directions, -1, 0))
    command = Command(velocity=jnp.asarray([0.9, 0.4]), direction=jnp.asarray([0.8, -0.6]))
    tracking = replace(
        init_tracking(jnp.asarray([0.2, 1.1]), NEAR, 0.8),
        heading_error=jnp.float32(0.1),
        strafe_failure=jnp.float32(1.3),
    )
    speed = StyleSpeed(natural=jnp.float32(1.0), gain=jnp.float32(0.8))

    def track(before, after, command, tracking):
        requested = network_command(command, before.directions[ROOT], speed, tracking, CONFIG)
        found = update_tracking(tracking, before, after, command, NEAR, jnp.asarray(False), CONFIG)
        angle = heading_correction(found, command, CONFIG)
        return (requested, turn_state(after, angle, after.positions[ROOT]), found.velocity), (
            found.heading_error,
            angle,
        )

    vectors, angles = track(before, after, command, tracking)
    other = replace(mirrored(tracking), heading_error=-tracking.heading_error)
    mirror_vectors, mirror_angles = track(mirrored(before), mirrored(after), mirrored(command), other)
    for a, b in zip(jax.tree.leaves(mirrored(vectors)), jax.tree.leaves(mirror_vectors), strict=True):
        np.testing.assert_allclose(a, b, atol=FLOAT32)
    np.testing.assert_allclose(jnp.stack(angles), -jnp.stack(mirror_angles), atol=FLOAT32)
    assert angles[1] != 0.0


def test_angles_go_the_short_way():
    a, b = jnp.asarray([0.0, 1.0]), jnp.asarray([1.0, 0.0])
    assert angle_between(a, b) == pytest.approx(np.pi / 2) and angle_between(b, a) == pytest.approx(-np.pi / 2)


def test_lookahead_speed_is_limited():
    state = walking(0.0, (0.4, 1.0), 0.2)
    steps = 60.0 * length(jnp.diff(state.positions[ROOT:], axis=0))
    for natural in (0.5 * float(steps.mean()), 2.0 * float(steps.max())):
        limited = limit_lookahead(state, jnp.float32(natural), CONFIG)
        found = 60.0 * length(jnp.diff(limited.positions[ROOT:], axis=0))
        np.testing.assert_allclose(found, np.minimum(steps, CONFIG.max_lookahead_ratio * natural), rtol=1e-3)
        np.testing.assert_array_equal(limited.positions[: ROOT + 1], state.positions[: ROOT + 1])


@pytest.mark.parametrize("gain", [1.0, 0.4])
def test_held_command_leaves_targets_unchanged(gain):
    layout, config = LAYOUT["mason2018"], replace(LOOP_CONFIGS["mason2018"], command_gain=gain)
    state = replace(walking(), target_velocity=jnp.asarray([0.3, 0.9]), target_direction=jnp.asarray([0.6, 0.8]))
    steered = steer(layout, state, held_command(state, config), config)
    np.testing.assert_allclose(steered.target_velocity, state.target_velocity, atol=FLOAT32)
    np.testing.assert_allclose(steered.target_direction, state.target_direction, atol=FLOAT32)


STRAFE = Command(velocity=jnp.asarray([1.0, 0.0]), direction=AHEAD)


def strafing(seconds: float, error: float, tracking: TrackingState | None = None) -> TrackingState:
    """Returns the tracking state after strafing for some seconds with a constant heading error."""
    state, found = walking(), tracking or init_tracking(AHEAD, NEAR, 1.0)
    for _ in range(round(seconds * CONFIG.fps)):
        found = replace(found, heading_error=jnp.float32(error))
        found = update_tracking(found, state, state, STRAFE, NEAR, jnp.asarray(False), CONFIG)
    return replace(found, heading_error=jnp.float32(error))


def requested_yaw(tracking: TrackingState) -> float:
    facing = walking().directions[ROOT]
    return float(angle_between(facing, network_command(STRAFE, facing, SPEED, tracking, CONFIG).direction))


def test_facing_is_released_when_strafing_fails():
    timeout = CONFIG.strafe_timeout
    assert requested_yaw(strafing(0.9 * timeout, 1.5)) == pytest.approx(0.0, abs=1e-6)
    assert requested_yaw(strafing(1.2 * timeout, 1.5)) == pytest.approx(0.2 * np.pi / 2, abs=0.06)
    assert requested_yaw(strafing(2.5 * timeout, 1.5)) == pytest.approx(CONFIG.max_requested_turn, abs=1e-6)
    assert requested_yaw(strafing(2.5 * timeout, 0.1)) == pytest.approx(0.0, abs=1e-6)


def test_released_facing_stays_released():
    released = strafing(2.5 * CONFIG.strafe_timeout, 1.5)
    assert strafing(1.0, 0.0, released).strafe_failure >= released.strafe_failure


def test_occasional_heading_errors_do_not_release_the_facing():
    state, tracking = walking(), init_tracking(AHEAD, NEAR, 1.0)
    for _ in range(300):
        for error in (1.5, 0.0, 0.0):
            tracking = replace(tracking, heading_error=jnp.float32(error))
            tracking = update_tracking(tracking, state, state, STRAFE, NEAR, jnp.asarray(False), CONFIG)
    assert tracking.strafe_failure < CONFIG.strafe_timeout


@pytest.mark.parametrize("time_scale", [CONFIG.min_time_scale, 1.0])
def test_an_unseen_network_waits_once_its_feet_pass_each_other(time_scale):
    state, tracking, scales = walking(), init_tracking(AHEAD, NEAR, time_scale), []
    tracking = replace(tracking, waiting=jnp.asarray(False))
    for frame in range(60):
        stands, distance = jnp.asarray(frame >= 20), NEAR if frame in (10, 40) else FAR
        tracking = update_tracking(tracking, state, state, STOP, distance, stands, CONFIG)
        tracking = update_time_scale(tracking, STOP, CONFIG)
        scales.append(float(tracking.time_scale))
    assert min(scales[:40]) > 0.0  # also when they pass while the motion is still drawn
    assert scales[39] > 0.95 * CONFIG.stopping_time_scale  # slow motion does not wait longer
    assert max(scales[40:]) == 0.0
    moving = update_time_scale(tracking, replace(STOP, velocity=AHEAD), CONFIG)
    assert moving.time_scale > 0.0 and not moving.waiting


def test_waiting_terminates_for_feet_that_never_pass():
    state, tracking = walking(), replace(init_tracking(AHEAD, NEAR, 1.0), waiting=jnp.asarray(False))
    for _ in range(600):
        tracking = update_tracking(tracking, state, state, STOP, FAR, jnp.asarray(True), CONFIG)
    assert tracking.waiting


def test_configuration_is_validated():
    for change in ({"time_scale_rate": 0.0}, {"fps": -1.0}, {"max_time_scale": 0.1}):
        (name,) = change
        with pytest.raises(ValueError, match=f"TrackingConfig.{name}"):
            TrackingConfig(**change)


def test_requested_speed_is_the_one_whose_neighbours_answer_best():
    """The network runs if asked for 2.5: 2 is nearer to the natural speed than 1.5, but has a bad neighbour."""
    requested, natural = np.array([[0.5, 1.0, 1.5, 2.0, 2.5]]), np.array([1.0])
    assert _best_request(requested, np.array([[0.5, 0.8, 0.95, 1.0, 3.0]]), natural) == 1.5


def test_diverging_rollouts_are_not_chosen_nor_their_neighbours():
    requested, natural, nan = np.array([[0.5, 1.0, 1.5, 2.0, 2.5]]), np.array([1.2]), np.nan
    assert _best_request(requested, np.array([[0.5, 0.8, 1.1, 1.2, nan]]), natural) == 1.5
    assert _best_request(requested, np.full((1, 5), nan), natural) == 1.2


def test_the_greatest_request_is_tried_as_a_neighbour_only():
    requested, natural = np.array([[0.5, 1.0, 1.5, 2.0]]), np.array([1.0])
    assert _best_request(requested, np.array([[0.1, 0.2, 0.9, 1.0]]), natural) == 1.5
