"""Laws of the published loop, of rollouts under commands and along paths, and of locked rollouts."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from pfnn_jax.control.loop.pursuit import make_timed_path, point_at
from pfnn_jax.control.loop.rollout import Frames, follow_path, locked_rollout, rollout, stability
from pfnn_jax.control.loop.state import ROOT, initial_state, place_state, straight_row
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command, LoopConfig, network_input, published_step, steer
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.layout import GAITS
from pfnn_jax.motion.paths import circle, figure_eight, mirror_path, resample_path, straight
from tests.control.walkers import (
    LAYOUT,
    OBEDIENT,
    ORACLES,
    WALK,
    input_row,
    reflection,
    sway,
    true_walk,
)
from tests.models.helpers import predict

# Two hundred float32 steps are summed, over some metres.
DRIFT = 2e-4
# The same float32 operations, compiled in another order.
REORDERED = 1e-5
# Metres: the state fills past roots in between samples by chords; the pose forgets half of that at every frame.
FORGOTTEN = 20

placed = jax.jit(initial_state, static_argnums=0)
layouts = pytest.mark.parametrize("layout", LAYOUT.values(), ids=LAYOUT)


def start(layout, walk=None, phase=0.0):
    walk = walk or WALK
    return placed(layout, input_row(layout, walk, phase), jnp.float32(phase), jnp.zeros(2), jnp.zeros(()))


def straight_on(num_frames, speed=1.2):
    ahead = jnp.tile(jnp.asarray([[0.0, 1.0]]), (num_frames, 1))
    return Command(velocity=speed * ahead, direction=ahead)


@layouts
@pytest.mark.parametrize("turn_rate", [1e-3, 0.6, -0.6])
def test_oracle_is_reproduced(layout, turn_rate):
    walk = WALK | {"turn_rate": turn_rate}
    frames = rollout(ORACLES[layout.name], walk, layout, start(layout, walk), straight_on(200))
    roots, yaw, phase, joints = true_walk(walk, layout.fps, 200)
    np.testing.assert_allclose(frames.root_positions, roots, atol=DRIFT)
    np.testing.assert_allclose(np.unwrap(frames.root_yaw), yaw, atol=DRIFT)
    np.testing.assert_allclose(np.unwrap(frames.phase), phase, atol=DRIFT)
    np.testing.assert_allclose(frames.joint_positions[FORGOTTEN:], joints[FORGOTTEN:], atol=DRIFT)


@layouts
def test_inputs_follow_the_frame_rule(layout):
    """The joints of x_{i+1} are those of y_i in root i; the trajectory of x is relative to root i."""
    config = LoopConfig(1e-6, 1e-6, 0.5, 0.5, 0.5, 0.5)  # the steering bends nothing
    command = Command(velocity=jnp.ones(2), direction=jnp.asarray([0.6, 0.8]))

    @jax.jit
    def advance(state):
        after, y = published_step(partial(ORACLES[layout.name], WALK), layout, state, command, config)
        return after, network_input(layout, steer(layout, state, command, config)), y

    state, y = start(layout), None
    for _ in range(FORGOTTEN + 70):
        before = y
        state, x, y = advance(state)
    x, y = np.asarray(x), np.asarray(before)
    for name in ("joint_position", "joint_velocity"):
        scale = layout.length_unit * (1.0 if name == "joint_position" else 1.0 / layout.time_unit)
        np.testing.assert_allclose(
            x[layout.input_slice(name)] * scale, y[layout.output_slice(name)] * scale, atol=DRIFT
        )
    expected = input_row(layout, WALK)
    for axis in "xz":
        block = layout.input_slice(f"trajectory_position_{axis}")
        # The oracle steps along chords, its own prediction follows the arc: they part by a fraction of a millimetre.
        np.testing.assert_allclose(x[block] * layout.length_unit, expected[block] * layout.length_unit, atol=7e-3)
        block = layout.input_slice(f"trajectory_direction_{axis}")
        np.testing.assert_allclose(x[block], expected[block], atol=1e-2)


@layouts
def test_state_repeats_the_row_it_came_from(layout):
    x = input_row(layout, WALK)
    state = placed(layout, x, jnp.float32(1.0), jnp.asarray([3.0, -2.0]), jnp.float32(2.0))
    scale = max(1.0, float(jnp.abs(x).max()))
    np.testing.assert_allclose(network_input(layout, state), x, atol=REORDERED * scale)
    np.testing.assert_allclose(state.positions[ROOT], [3.0, -2.0], atol=REORDERED)


def test_rollout_is_equivariant_under_rigid_motion():
    layout = LAYOUT["pfnn2017"]
    yaw, shift = 2.2, np.array([4.0, -3.0], np.float32)
    cos, sin = np.cos(yaw), np.sin(yaw)
    turn = np.array([[cos, -sin], [sin, cos]])  # rows: what +X and +Z become
    path = figure_eight(2.0)
    moved = resample_path(path.points @ turn + shift, closed=True, num_points=len(path.points))
    state, walker, weights = start(layout), OBEDIENT[layout.name], sway(layout)
    here = follow_path(walker, weights, layout, state, make_timed_path(path, 1.2), 200)
    elsewhere = jax.jit(place_state)(state, shift, jnp.float32(yaw))
    there = follow_path(walker, weights, layout, elsewhere, make_timed_path(moved, 1.2), 200)
    np.testing.assert_allclose(np.asarray(here.root_positions) @ turn + shift, there.root_positions, atol=10 * DRIFT)
    joints = [np.asarray(frames.joint_positions)[..., [0, 2]] for frames in (here, there)]
    np.testing.assert_allclose(joints[0] @ turn + shift, joints[1], atol=10 * DRIFT)
    np.testing.assert_allclose(here.phase, there.phase, atol=DRIFT)
    np.testing.assert_allclose(here.progress, there.progress, atol=20 * DRIFT)


def test_rollout_is_equivariant_under_mirroring():
    layout = LAYOUT["mason2018"]
    into = reflection({name: layout.input_width(name) for name in layout.input_blocks})
    out = reflection({name: layout.output_width(name) for name in layout.output_blocks})
    walker, weights = OBEDIENT[layout.name], sway(layout)

    def mirrored(weights, x, phase):
        return out * walker(weights, into * x, phase)

    x, path = input_row(layout, WALK | {"turn_rate": 1e-3}), circle(2.0)
    states = [placed(layout, row, jnp.zeros(()), jnp.zeros(2), jnp.zeros(())) for row in (x, into * x)]
    left = follow_path(walker, weights, layout, states[0], make_timed_path(path, 1.2), 200)
    right = follow_path(mirrored, weights, layout, states[1], make_timed_path(mirror_path(path), 1.2), 200)
    flip = np.array([-1.0, 1.0, 1.0])
    np.testing.assert_allclose(np.asarray(left.joint_positions) * flip, right.joint_positions, atol=DRIFT)
    np.testing.assert_allclose(np.asarray(left.root_positions) * flip[:2], right.root_positions, atol=DRIFT)
    np.testing.assert_allclose(left.root_yaw, -right.root_yaw, atol=DRIFT)
    assert float(left.root_yaw.max()) > 1.0


def test_loop_scan_and_vmap_agree():
    layout = LAYOUT["mason2018"]
    walker, weights = OBEDIENT[layout.name], sway(layout)
    angles = np.array([0.5, -1.0, 3.0], np.float32)
    direction = jnp.stack([jnp.sin(angles), jnp.cos(angles)], -1)
    one = start(layout)
    batch = jax.vmap(lambda d: rollout(walker, weights, layout, one, commands_towards(d)))(direction)
    alone = rollout(walker, weights, layout, one, commands_towards(direction[1]))
    state, commands = one, commands_towards(direction[1])
    advance = jax.jit(partial(published_step, partial(walker, weights), layout))
    for frame in range(60):
        state, y = advance(state, jax.tree.map(lambda a, i=frame: a[i], commands))
    scale = 1.0 / layout.length_unit
    np.testing.assert_allclose(alone.outputs, batch.outputs[1], atol=REORDERED * scale)
    np.testing.assert_allclose(y, alone.outputs[-1], atol=REORDERED * scale)
    np.testing.assert_allclose(state.joint_positions, alone.joint_positions[-1], atol=REORDERED)
    jax.tree.map(partial(np.testing.assert_allclose, atol=REORDERED), state, alone.state)


def commands_towards(direction, num_frames=60):
    directions = jnp.tile(direction[None], (num_frames, 1))
    return Command(velocity=1.2 * directions, direction=directions)


def small_network(layout, num_adapters):
    config = NetworkConfig(layout.input_size, layout.output_size, hidden=16)
    network = init_network(config, key=jax.random.key(0))
    keys = jax.random.split(jax.random.key(1), num_adapters)
    adapters = jax.vmap(lambda key: init_style(AdapterConfig("cp", 3), config, key=key))(keys)
    return network, adapters


def evaluate_small(params, x, phase):
    network, adapter = params
    return 0.1 * predict(network, adapter, jnp.tanh(x), phase)


def test_styles_in_one_vmap_share_one_network():
    layout = LAYOUT["mason2018"]
    network, adapters = small_network(layout, 2)
    track, state = make_timed_path(circle(2.0), 1.2), start(layout)
    x, phase = jnp.tile(input_row(layout, WALK)[None], (12, 1)), jnp.linspace(0.0, 1.0, 12)

    def run(adapter):
        params = (network, adapter)
        frames = follow_path(evaluate_small, params, layout, state, track, 30)
        return frames, locked_rollout(evaluate_small, params, layout, x, phase)

    frames, locked = jax.jit(jax.vmap(run))(adapters)
    for index in range(2):
        alone = run(jax.tree.map(lambda a, i=index: a[i], adapters))
        np.testing.assert_allclose(frames.outputs[index], alone[0].outputs, atol=REORDERED)
        np.testing.assert_allclose(frames.joint_positions[index], alone[0].joint_positions, atol=REORDERED)
        np.testing.assert_allclose(locked[index], alone[1], atol=REORDERED)
    assert float(jnp.abs(locked[0] - locked[1]).max()) > 1e-3


def test_locked_rollout_feeds_back_the_pose_alone():
    layout = LAYOUT["mason2018"]
    network, adapters = small_network(layout, 1)
    params = (network, jax.tree.map(lambda a: a[0], adapters))
    x = np.random.default_rng(0).normal(size=(9, layout.input_size)).astype(np.float32)
    phase = np.linspace(0.0, 2.0, 9, dtype=np.float32)
    found = locked_rollout(evaluate_small, params, layout, jnp.asarray(x), jnp.asarray(phase))
    row = x[0].copy()
    for frame in range(9):
        y = np.asarray(evaluate_small(params, jnp.asarray(row), jnp.asarray(phase[frame])))
        np.testing.assert_allclose(found[frame], y, atol=REORDERED)
        if frame < 8:
            row = x[frame + 1].copy()
            for name in ("joint_position", "joint_velocity"):
                row[layout.input_slice(name)] = y[layout.output_slice(name)]


@layouts
@pytest.mark.parametrize("radius", [2.0, -2.0])
def test_circle_is_followed(layout, radius):
    track = make_timed_path(circle(radius), 1.2)
    state = start(layout, WALK | {"turn_rate": 1e-3})
    frames = follow_path(OBEDIENT[layout.name], sway(layout), layout, state, track, 900)
    seen = stability(layout, frames, jnp.zeros(layout.output_size), jnp.ones(layout.output_size))
    assert bool(seen.finite)
    # The walker obeys at once, so looking ahead by l cuts corners: by at most l² / 2R, the arc's height over a tangent.
    cut = (LOOP_CONFIGS[layout.name].look_ahead * 1.2) ** 2 / (2.0 * abs(radius))
    assert float(seen.turn_rate) == pytest.approx(1.2 / radius, rel=0.1)
    assert float(seen.speed) == pytest.approx(1.2, rel=0.1)
    assert seen.trajectory_error is not None and float(seen.trajectory_error) < cut
    assert bool((jnp.diff(frames.progress) >= 0.0).all())


def test_figure_eight_is_followed_through_its_crossing():
    layout, track = LAYOUT["mason2018"], make_timed_path(figure_eight(2.0), 1.2)
    state = start(layout, WALK | {"turn_rate": 1e-3})
    frames = follow_path(OBEDIENT[layout.name], sway(layout), layout, state, track, 1400)
    assert float(frames.path_distance.max()) < 0.3
    assert float(frames.progress[-1]) > float(track.length)  # more than once round
    assert float(frames.root_positions[:, 0].min()) < -3.5 and float(frames.root_positions[:, 0].max()) > 3.5


@layouts
def test_a_character_stays_at_the_end_of_an_open_path(layout):
    state = start(layout, WALK | {"turn_rate": 1e-3})
    frames = follow_path(OBEDIENT[layout.name], sway(layout), layout, state, make_timed_path(straight(3.0), 1.2), 500)
    np.testing.assert_allclose(frames.root_positions[-1], [0.0, 3.0], atol=0.3)
    assert float(jnp.abs(jnp.diff(frames.root_positions[-60:], axis=0)).max()) < 1e-3
    assert float(frames.progress[-1]) <= 3.0


def test_points_along_paths():
    closed, opened = make_timed_path(circle(1.0), 1.0), make_timed_path(straight(2.0), 1.0)
    round_once = point_at(closed, jnp.asarray([0.0, np.pi, 2 * np.pi, 3 * np.pi], jnp.float32))
    np.testing.assert_allclose(round_once, [[0, 0], [2, 0], [0, 0], [2, 0]], atol=2e-3)
    np.testing.assert_allclose(point_at(opened, jnp.asarray([-1.0, 0.5, 9.0])), [[0, 0], [0, 0.5], [0, 2]], atol=1e-6)


def test_standing_character_stands():
    layout = LAYOUT["pfnn2017"]
    row = straight_row(layout, input_row(layout, WALK), 0.0)
    state = initial_state(layout, row, jnp.zeros(()), jnp.ones(2), jnp.float32(1.0))
    state = replace(state, gait=jnp.zeros_like(state.gait).at[:, GAITS.index("stand")].set(1.0))
    frames = rollout(ORACLES[layout.name], WALK, layout, state, straight_on(120, speed=0.0))
    np.testing.assert_allclose(frames.root_positions, np.ones((120, 2)), atol=REORDERED)
    np.testing.assert_allclose(frames.root_yaw, np.ones(120), atol=REORDERED)
    # The phase advances at a tenth of its rate.
    np.testing.assert_allclose(frames.phase, np.arange(120) * 0.1 * WALK["cadence"] / 60.0, atol=DRIFT)


@layouts
def test_stability_of_a_known_walk(layout):
    frames = rollout(ORACLES[layout.name], WALK, layout, start(layout), straight_on(200))
    mean, std = jnp.mean(frames.outputs, axis=0), jnp.full(layout.output_size, 1.0 / layout.length_unit)
    seen = stability(layout, frames, mean, std)
    assert float(seen.speed) == pytest.approx(WALK["speed"], rel=1e-3)
    assert float(seen.turn_rate) == pytest.approx(WALK["turn_rate"], rel=1e-3)
    pose = (np.asarray(frames.outputs) - np.asarray(mean))[60:, layout.output_slice("joint_position")]
    assert float(seen.pose_distance) == pytest.approx(np.mean(pose**2) * layout.length_unit**2, rel=1e-3)
    assert float(seen.pose_peak) >= float(seen.pose_distance) > 0.0
    assert seen.trajectory_error is None


def test_stability_of_a_diverging_rollout_is_infinite():
    layout = LAYOUT["mason2018"]

    def broken(params, x, phase):
        return jnp.where(phase > 1.0, jnp.nan, ORACLES["mason2018"](params, x, phase))

    frames: Frames = rollout(broken, WALK, layout, start(layout), straight_on(100))
    seen = stability(layout, frames, jnp.zeros(layout.output_size), jnp.ones(layout.output_size))
    assert not bool(seen.finite)
    assert np.isinf([seen.pose_distance, seen.pose_peak, seen.speed, seen.turn_rate]).all()


def test_step_is_differentiable():
    layout = LAYOUT["pfnn2017"]
    with jax.enable_x64(True):
        state = jax.tree.map(lambda a: jnp.asarray(np.asarray(a, np.float64)), start(layout))
        weights = jnp.asarray(np.asarray(sway(layout), np.float64))

        @jax.jit
        def follow(velocity, joints):
            command = Command(velocity=velocity, direction=jnp.asarray([0.6, 0.8]))
            moved, _ = published_step(
                partial(OBEDIENT["pfnn2017"], weights), layout, state.replace(joint_positions=joints), command
            )
            return moved.positions, moved.directions, moved.joint_positions

        check_grads(follow, (jnp.asarray([0.3, 1.0]), state.joint_positions), order=1)


@pytest.mark.parametrize("change", [{"velocity_rate": 0.0}, {"pose_rate": 1.5}, {"position_bias": -1.0}])
def test_loop_config_is_validated(change):
    with pytest.raises(ValueError, match=next(iter(change))):
        replace(LOOP_CONFIGS["mason2018"], **change)
