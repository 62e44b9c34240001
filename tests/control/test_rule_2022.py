"""Laws of the frame rule of Mason et al. 2022: known walks are reproduced, poses move to the next root."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.loop.rollout import locked_rollout, rollout
from pfnn_jax.control.loop.state import ROOT, initial_state, place_state, write_input
from pfnn_jax.control.loop.step import LOOP_CONFIGS, Command, network_input, published_step, steer
from pfnn_jax.control.vectors import to_3d
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.layout import LAYOUTS, layout_for
from pfnn_jax.motion.ground import to_world
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.control.walkers import JOINTS, WALK, arc, pose

# Some hundred float32 steps are summed, over some metres.
DRIFT = 3e-4
# The same float32 operations in another order.
REORDERED = 1e-5
# The pose forgets half of its beginning at every frame.
FORGOTTEN = 20
LAYOUT = {
    name: replace(LAYOUTS[name](JOINTS), ends=() if name.endswith("pfnn") else (0, 1, 2, 4))
    for name in ("mason2022", "mason2022_mann", "mason2022_pfnn")
}
phased = pytest.mark.parametrize("layout", [LAYOUT["mason2022"], LAYOUT["mason2022_pfnn"]], ids=lambda each: each.name)


def vector_of(angle):
    """Returns local phases of four end effectors that all have one angle."""
    return jnp.tile(jnp.stack([jnp.sin(angle), jnp.cos(angle)]), 4)


def blocks_of(walk, angle, layout):
    """Returns the joints at a phase of the walk, relative to their own root."""
    dt = 1.0 / layout.fps
    turn, travel = -walk["turn_rate"] * dt, walk["speed"] * dt
    here, before = jnp.asarray(pose(angle)), jnp.asarray(pose(angle - walk["cadence"] * dt))
    # The root steps straight ahead, then turns: the pose before, seen from this root.
    before = to_world(before - to_3d(jnp.stack([jnp.zeros(()), travel]))[None], facing_of(turn))
    axes = jnp.zeros((JOINTS, 3))
    return {
        "joint_position": here,
        "joint_forward": axes.at[:, 2].set(1.0),
        "joint_up": axes.at[:, 1].set(1.0),
        "joint_velocity": (here - before) * layout.fps,
    }


placed = jax.jit(initial_state, static_argnums=0)
one_step = jax.jit(published_step, static_argnums=(0, 1))


def facing_of(yaw):
    return jnp.stack([jnp.sin(yaw), jnp.cos(yaw)])


def oracle(layout):
    """Returns a function (walk, x, phase) -> y of the walk's next frame."""

    def evaluate(walk, x, phase):
        dt = 1.0 / layout.fps
        angle = phase if layout.phase_kind == "global" else jnp.arctan2(phase[0], phase[1])
        after = angle + walk["cadence"] * dt
        facing, travel = facing_of(walk["turn_rate"] * dt), jnp.stack([jnp.zeros(()), walk["speed"] * dt])
        blocks = {name: to_world(block, facing) for name, block in blocks_of(walk, after, layout).items()}
        blocks["joint_position"] += to_3d(travel)[None]
        positions, directions = arc(walk["speed"], walk["turn_rate"], jnp.arange(6) / 6.0)
        samples = (*(to_world(positions, facing) + travel[None]).T, *to_world(directions, facing).T)
        blocks |= dict(
            zip((f"trajectory_{k}_{a}" for k in ("position", "direction") for a in "xz"), samples, strict=True)
        )
        blocks |= {"local_phase": vector_of(after), "local_phase_change": vector_of(after) - vector_of(angle)}
        blocks |= {"foot_contacts": jnp.zeros(2), "phase_change": jnp.full(1, walk["cadence"])}
        y = jnp.zeros(layout.output_size)
        for name in layout.output_blocks:
            y = y.at[layout.output_slice(name)].set(blocks[name].reshape(-1))
        return y

    return evaluate


@partial(jax.jit, static_argnums=0)
def input_row(layout, walk, angle=0.0):
    positions, directions = arc(walk["speed"], walk["turn_rate"], jnp.arange(-6, 6) / 6.0)
    samples = (*positions.T, *directions.T)
    names = (f"trajectory_{kind}_{axis}" for kind in ("position", "direction") for axis in "xz")
    return write_input(layout, blocks_of(walk, jnp.float32(angle), layout) | dict(zip(names, samples, strict=True)))


def start(layout, walk):
    phase = jnp.float32(0.0) if layout.phase_kind == "global" else vector_of(jnp.float32(0.0))
    return placed(layout, input_row(layout, walk), phase, jnp.zeros(2), jnp.zeros(()))


def ahead(num_frames):
    direction = jnp.tile(jnp.asarray([[0.0, 1.0]]), (num_frames, 1))
    return Command(velocity=1.2 * direction, direction=direction)


@phased
@pytest.mark.parametrize("turn_rate", [1e-3, 0.6])
def test_rollout_reproduces_a_known_walk(layout, turn_rate):
    """With `trajectory_rate` 1; below, the root lags by design."""
    walk, config = WALK | {"turn_rate": turn_rate}, replace(LOOP_CONFIGS[layout.name], trajectory_rate=1.0)
    frames = rollout(oracle(layout), walk, layout, start(layout, walk), ahead(120), config=config)
    yaw = turn_rate / 60.0 * np.arange(121)
    steps = walk["speed"] / 60.0 * np.stack([np.sin(yaw), np.cos(yaw)], -1)
    roots = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])[:121]
    np.testing.assert_allclose(frames.root_positions, roots[:120], atol=DRIFT)
    np.testing.assert_allclose(np.unwrap(frames.root_yaw), yaw[:120], atol=DRIFT)
    last = jax.jit(blocks_of, static_argnums=2)(walk, jnp.float32(walk["cadence"] * 2.0), layout)["joint_position"]
    expected = to_world(last, facing_of(jnp.float32(yaw[120]))) + to_3d(jnp.float32(roots[120]))[None]
    np.testing.assert_allclose(frames.joint_positions[-1], expected, atol=DRIFT)


@phased
def test_state_repeats_its_row_at_any_position(layout):
    x = input_row(layout, WALK)
    state = jax.jit(place_state)(start(layout, WALK), jnp.asarray([3.0, -2.0]), jnp.float32(2.0))
    np.testing.assert_allclose(network_input(layout, state), x, atol=REORDERED)


def test_the_next_root_is_a_share_of_the_predicted_one():
    layout = LAYOUT["mason2022"]
    after, y = one_step(
        partial(oracle(layout), WALK), layout, start(layout, WALK), jax.tree.map(lambda a: a[0], ahead(1))
    )
    predicted = y[layout.output_slice("trajectory_position_z")][0]
    np.testing.assert_allclose(after.positions[ROOT, 1], 0.85 * predicted, rtol=1e-5)
    turned = jnp.arctan2(after.directions[ROOT, 0], after.directions[ROOT, 1])
    np.testing.assert_allclose(turned, 0.85 * WALK["turn_rate"] / 60.0, rtol=1e-3)


def test_velocity_networks_gate_by_end_effector_velocities_of_the_pose():
    layout = LAYOUT["mason2022_mann"]
    truth = oracle(LAYOUT["mason2022"])

    def evaluate(walk, x, phase):
        y = truth(walk, x, vector_of(jnp.float32(0.3)))
        return y[np.r_[: layout.output_size - 2, 340 - 12 * (25 - JOINTS) : 342 - 12 * (25 - JOINTS)]]

    state = placed(layout, input_row(layout, WALK), jnp.zeros(12), jnp.zeros(2), jnp.zeros(()))
    command = jax.tree.map(lambda a: a[0], ahead(1))
    after, _ = one_step(partial(evaluate, WALK), layout, state, command)
    x = network_input(layout, steer(layout, after, command, LOOP_CONFIGS[layout.name]))
    velocities = x[layout.input_slice("joint_velocity")].reshape(-1, 3)
    np.testing.assert_allclose(after.phase, velocities[np.array(layout.ends)].reshape(-1), atol=REORDERED)


def test_locked_rollout_moves_the_pose_to_the_true_next_root():
    """A network with exact outputs receives the true input of each frame."""
    clip, labels = synthesise("neutral", np.full(120, 0.8), np.full(120, 1.2), seed=0)
    layout = layout_for("mason2022_pfnn", clip.skeleton)
    rows = clip_features(clip, layout, labels)
    x, y, phase = (jnp.asarray(values[:40]) for values in (rows.x, rows.y, rows.phase))
    joints = np.concatenate(
        [np.arange(layout.input_size)[layout.input_slice(name)] for name in layout.input_blocks[4:]]
    )

    def seen(params, given, angle):
        index = jnp.argmax(jnp.cos(phase - angle))
        # Contacts are not fed back: they carry out how far the pose that was given is from the truth.
        error = jnp.abs(given[joints] - x[index, joints]).max()
        return y[index].at[layout.output_slice("foot_contacts")].set(error)

    found = locked_rollout(seen, None, layout, x, phase)
    assert float(found[:, layout.output_slice("foot_contacts")].max()) < DRIFT
