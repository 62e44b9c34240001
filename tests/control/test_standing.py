"""Standing: characters stop on both feet in every style, turn on the spot, and walk off, without a jump."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.controller import Controller, make_controller, rollout_commands
from pfnn_jax.control.controller_state import carry, draw_body
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.standing import Stance, StandingConfig, WalkingBody, init_standing, update_standing
from pfnn_jax.motion.ground import angle_between, facing_of, turn
from tests.trained import walking_run

FPS = 60
ON_FLOOR = 0.01  # m from the heights at which the data's feet stand flat: what one sees as standing
FASTER = 1.1  # largest speed of a joint as a multiple of that of the same style's walk: a step is not faster than one
PHASES, APART = 16, 5  # moments of stopping, frames apart: 1.3 s, more than a cycle
WALK, STAND, TURN, AGAIN = 150, 120, 150, 60  # frames of a walk, of standing, of turning on the spot, of walking off
STOP = WALK + np.arange(PHASES) * APART
LEG = 0.85


@pytest.fixture(scope="module")
def controller(tmp_path_factory) -> Controller:
    return make_controller(walking_run(tmp_path_factory))


def commands(speed: float, stop: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns velocities [T, 2] and directions [T, 2]: walk on a curve, stop, turn on the spot, walk off."""
    frame = np.arange(STOP[-1] + STAND + TURN + AGAIN)
    yaw = np.deg2rad(20.0) * np.clip(frame, 0, stop) / FPS + np.deg2rad(100.0) * (frame >= stop + STAND)
    moving = (frame < stop) | (frame >= stop + STAND + TURN)
    direction = np.stack([np.sin(yaw), np.cos(yaw)], -1).astype(np.float32)
    return np.float32(speed) * moving[:, None] * direction, direction


@pytest.fixture(scope="module")
def walks(controller) -> dict[str, np.ndarray]:
    """Walks of all styles that stop in 16 moments: leaves [S, P, T, ...]."""
    styles = np.eye(len(controller.styles), controller.capacity, dtype=np.float32)
    starts = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(controller.start(style=s) for s in range(len(styles))))
    rows = [
        [commands(float(speed), int(stop)) for stop in STOP]
        for speed in np.asarray(controller.params.speeds)[: len(styles)]
    ]
    velocity, direction = (jnp.asarray(np.array([[pair[i] for pair in row] for row in rows])) for i in range(2))

    @jax.jit
    def walk(state, velocity, direction, style):
        command = Command(
            velocity=velocity, direction=direction, style=jnp.broadcast_to(style, (len(velocity), *style.shape))
        )
        seen = rollout_commands(controller.setup, controller.params, state, command)[1]
        return {
            "joints": seen.joints,
            "facing": seen.facing,
            "weight": seen.standing.weight,
            "root": seen.root,
            "contacts": seen.contacts,
            "time_scale": seen.time_scale,
        }

    many = jax.vmap(jax.vmap(walk, (None, 0, 0, None)))
    return jax.tree.map(np.asarray, many(starts, velocity, direction, jnp.asarray(styles)))


def speeds(joints: np.ndarray) -> np.ndarray:
    """Returns the largest speed of a joint [..., T - 1] in m/s of joints [..., T, J, 3]."""
    return np.linalg.norm(np.diff(joints, axis=-3), axis=-1).max(-1) * FPS


def test_both_feet_are_on_the_floor_a_second_after_the_command(controller, walks):
    feet = walks["joints"][..., list(controller.setup.rig.feet), 1]
    floor = np.array([controller.setup.rig.resting_heights]).reshape(1, 4)
    for phase, stop in enumerate(STOP):
        above = feet[:, phase, stop + FPS : stop + STAND] - floor[:, None]
        assert np.abs(above).max() < ON_FLOOR, (phase, above)


def test_no_joint_is_faster_than_in_the_walk(walks):
    """While it starts, stops, stands, turns on the spot and walks off."""
    fastest = speeds(walks["joints"])
    for style in range(len(fastest)):
        most = FASTER * fastest[style, :, 2 * FPS : WALK - 1].max()
        assert fastest[style].max() < most, (style, fastest[style].max(-1), most)


def test_a_standing_character_sways_but_its_feet_do_not_move(controller, walks):
    for phase, stop in enumerate(STOP):
        joints = walks["joints"][:, phase, stop + FPS + 15 : stop + STAND]
        feet = joints[:, :, list(controller.setup.rig.feet)]
        assert np.ptp(feet, axis=1).max() < 2e-3  # m: what is left of slowing down
        assert np.ptp(joints, axis=1).max() > 1e-3
        assert (walks["contacts"][:, phase, stop + FPS : stop + STAND] == 1.0).all()
        assert (walks["time_scale"][:, phase, stop + FPS : stop + STAND] == 0.0).all()


def test_a_character_turns_on_the_spot_with_alternate_steps(controller, walks):
    for phase, stop in enumerate(STOP):
        turned = slice(stop + STAND - 1, stop + STAND + TURN)
        facing = walks["facing"][:, phase, turned]
        yaw = np.unwrap(np.arctan2(facing[..., 0], facing[..., 1]), axis=1)
        assert np.abs(np.rad2deg(yaw[:, -1] - yaw[:, 0]) - 100.0).max() < 2.0
        feet = walks["joints"][:, phase, turned][:, :, list(controller.setup.rig.feet)]
        moving = (np.linalg.norm(np.diff(feet, axis=1), axis=-1) * FPS > 0.1).reshape(len(feet), -1, 2, 2).all(-1)
        assert not moving.all(-1).any()  # never both at once
        steps = (np.diff(moving.astype(int), axis=1) == 1).sum(1)
        assert (steps >= 1).all() and (steps <= 4).all(), steps
        assert (
            np.linalg.norm(walks["root"][:, phase, turned] - walks["root"][:, phase, turned][:, :1], axis=-1).max()
            < 0.25  # m: a body that leans goes round its feet
        )


def test_a_walk_is_what_the_network_predicts(controller):
    """Where the weight of standing is 0, the body is drawn as without standing."""
    direction = jnp.asarray([0.0, 1.0])
    style = jnp.asarray(controller.style_weights(0))
    command = Command(velocity=1.1 * direction, direction=direction, style=style)
    many = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (60, *leaf.shape)), command)
    state, seen = rollout_commands(controller.setup, controller.params, controller.start(), many)
    assert seen.standing.weight[0] > 0.9 and state.standing.weight == 0.0
    again = replace(
        state, standing=replace(state.standing, feet=state.standing.feet + 1.0, hips=state.standing.hips + 1.0)
    )
    draw = jax.jit(partial(draw_body, controller.setup))
    for name in ("joints", "root", "facing", "contacts"):
        one, other = (getattr(draw(controller.params, s, command), name) for s in (state, again))
        np.testing.assert_array_equal(one, other)


def test_carrying_by_nothing_changes_nothing(controller):
    state = controller.start((2.0, -3.0), 0.7)
    same = carry(state, jnp.zeros(()), jnp.zeros(2))
    for one, other in zip(jax.tree.leaves(state), jax.tree.leaves(same), strict=True):
        np.testing.assert_array_equal(one, other)
    there = carry(
        carry(state, jnp.float32(0.4), jnp.asarray([1.0, 2.0])),
        jnp.float32(-0.4),
        turn(jnp.asarray([-1.0, -2.0]), jnp.float32(-0.4)),
    )
    np.testing.assert_allclose(there.motion.joint_positions, state.motion.joint_positions, atol=1e-5)


# The functions alone, on a body that glides.

CONFIG = StandingConfig()
STANCE = Stance(
    rotations=jnp.asarray([[1.0, 0.0, 0.0, 0.0]] * 3),
    height=jnp.float32(0.9),
    hips=jnp.zeros(2),
    feet=jnp.asarray([[[0.1, 0.09, -0.07], [0.1, 0.02, 0.07]], [[-0.1, 0.09, -0.07], [-0.1, 0.02, 0.07]]]),
    chest=jnp.asarray([1.0, 0.0, 0.0, 0.0]),
)


def body(seconds: float, speed: float = 1.2, mirror: bool = False) -> WalkingBody:
    """Returns a body at constant speed along +Z, whose left foot stands at 0 and whose right one swings past it."""
    feet = np.array(STANCE.feet)
    feet[1, :, 2] += 2.0 * speed * seconds
    feet[1, :, 1] += 0.06
    feet = feet[::-1] * [-1.0, 1.0, 1.0] if mirror else feet
    contacts = np.array([[1.0, 1.0], [0.0, 0.0]])
    values: dict[str, Any] = {
        "hips": [0.0, speed * seconds],
        "facing": [0.0, 1.0],
        "feet": feet,
        "contacts": contacts[::-1] if mirror else contacts,
        "speed": speed,
    }
    return WalkingBody(**{name: jnp.asarray(value, jnp.float32) for name, value in values.items()})


@partial(jax.jit, static_argnames="frames")
def stop_and_stand(before, walk, direction, frames: int):
    def frame(state, _):
        state = update_standing(state, walk, STANCE, jnp.asarray(False), direction, LEG, CONFIG)
        return state, state

    return jax.lax.scan(frame, before, length=frames)[1]


def walked(seconds: float, **options: Any):
    state = init_standing(STANCE, jnp.zeros(2), jnp.asarray([0.0, 1.0]), stopped=False)
    for at in (seconds - 2 / FPS, seconds - 1 / FPS):
        state = update_standing(
            state, body(at, **options), STANCE, jnp.asarray(True), jnp.asarray([0.0, 1.0]), LEG, CONFIG
        )
    return state


@pytest.mark.parametrize("seconds", [-0.25, -0.1, 0.0, 0.1, 0.2])
@pytest.mark.parametrize("speed", [0.5, 1.2, 2.0])
def test_hips_and_feet_come_to_rest_in_the_stance(seconds, speed):
    before = walked(seconds, speed=speed)
    states = stop_and_stand(before, body(seconds, speed=speed), jnp.asarray([0.0, 1.0]), 120)
    hips, feet = np.asarray(states.hips), np.asarray(states.feet)
    first = np.diff(np.concatenate([np.asarray(before.hips)[None], hips]), axis=0)[0, 1] * FPS
    assert first == pytest.approx(speed, rel=0.1)  # it goes on as it went
    assert (np.diff(hips[:, 1]) * FPS).max() < 1.05 * speed
    assert not bool(states.stepping[60:].any())
    np.testing.assert_allclose(feet[-1, :, :, 1], STANCE.feet[..., 1], atol=1e-6)
    middle = feet[-1].mean((0, 1))[[0, 2]]
    np.testing.assert_allclose(hips[-1], middle, atol=0.5 * CONFIG.step_distance * LEG + 1e-3)


def test_stopping_is_equivariant_under_mirroring():
    one, other = (
        stop_and_stand(walked(0.05, mirror=m), body(0.05, mirror=m), facing_of(jnp.float32(-1.0 if m else 1.0)), 180)
        for m in (False, True)
    )
    np.testing.assert_allclose(one.feet, np.asarray(other.feet)[:, ::-1] * [-1.0, 1.0, 1.0], atol=1e-5)
    np.testing.assert_allclose(one.hips, np.asarray(other.hips) * [-1.0, 1.0], atol=1e-5)
    assert abs(float(angle_between(one.facing[-1], facing_of(jnp.float32(1.0))))) < 0.02


def test_configuration_is_validated():
    for name in ("stop_seconds", "rest_rate", "max_turn_rate"):
        with pytest.raises(ValueError, match=f"StandingConfig.{name}"):
            replace(StandingConfig(), **{name: 0.0})
