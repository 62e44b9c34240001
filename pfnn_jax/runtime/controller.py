"""One character under control: what a command does to the trajectory, and what a network's output does to the body.

The loop of Holden 2017 and Mason 2018 (§5.1), a pure function of one character and one frame: `step`. At frame i

1. `steer` turns the predicted future trajectory towards the command,
2. `network_input` writes x_i: trajectory relative to root i, joints of frame i-1 relative to root i-1,
3. the network predicts y_i, and
4. `advance` places the joints of frame i and moves root, phase and trajectory on to frame i+1.

The state is in metres, seconds and radians in the world; layouts are met only in 2 and 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.motion.layout import TRAJECTORY_OFFSETS, FrameLayout
from pfnn_jax.runtime.ground import lift, mix, to_local, to_world, turn, turn_towards, unit
from pfnn_jax.runtime.state import NUM_POINTS, ROOT, STRIDE, CharacterState, fill_between

Evaluate = Callable[[jax.Array, jax.Array], jax.Array]
"""(x [Dx], phase []) -> y [Dy], in layout units."""


@dataclass(frozen=True)
class ControllerConfig:
    """How a character answers its commands. Shares are per frame at 60 fps.

    Attributes:
        position_bias, direction_bias: a future point at w of a second takes 1 - (1 - w)^bias of the command.
        velocity_rate, direction_rate, gait_rate: share of the way from the old target to the commanded one.
        look_ahead: seconds of the commanded speed by which a followed path is looked ahead.
        pose_rate: share of the predicted joint positions; the rest is the previous pose moved on by its velocity.
        stand_speed: metres per second below which the gait turns into standing.
        jog_speed: metres per second from which the gait is jog (only `pfnn2017` reads gaits other than stand).
    """

    position_bias: float
    direction_bias: float
    velocity_rate: float
    direction_rate: float
    gait_rate: float
    look_ahead: float
    pose_rate: float = 0.5
    stand_speed: float = 0.06
    jog_speed: float = 2.0

    def __post_init__(self) -> None:
        for name in ("velocity_rate", "direction_rate", "gait_rate", "pose_rate"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise ValueError(f"ControllerConfig.{name} must be in (0, 1], got {getattr(self, name)}.")
        for name in ("position_bias", "direction_bias", "stand_speed", "jog_speed", "look_ahead"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"ControllerConfig.{name} must be above 0, got {getattr(self, name)}.")


CONTROLLERS = {
    "mason2018": ControllerConfig(0.75, 1.25, velocity_rate=0.25, direction_rate=0.25, gait_rate=0.25, look_ahead=0.8),
    "pfnn2017": ControllerConfig(0.5, 2.0, velocity_rate=0.9, direction_rate=0.9, gait_rate=0.1, look_ahead=0.6),
}
"""The constants of the two published demos, by layout. Neither follows paths: the look-aheads are those that kept
closest to circles and figures of eight, with the released network and with one trained on procedural walks."""


@struct.dataclass(kw_only=True)
class Command:
    """What is asked of a character at one frame, in the world.

    Attributes:
        velocity: [2] metres per second on the ground (x, z); zero asks it to stand.
        direction: [2] unit vector that it shall face.
    """

    velocity: jax.Array
    direction: jax.Array


def step(
    evaluate: Evaluate,
    layout: FrameLayout,
    state: CharacterState,
    command: Command,
    config: ControllerConfig | None = None,
) -> tuple[CharacterState, jax.Array]:
    """One frame of one character.

    Args:
        evaluate: the network, (x [Dx], phase []) -> y [Dy] in layout units.
        layout: its layout.
        state: before frame i.
        command: of frame i.
        config: by default the published constants of the layout.

    Returns:
        The state before frame i+1, which holds the joints of frame i, whose root is its point `ROOT - 1`; and
        y_i [Dy] in layout units.
    """
    config = config or CONTROLLERS[layout.name]
    state = steer(layout, state, command, config)
    y = evaluate(network_input(layout, state), state.phase)
    return advance(layout, state, y, config), y


def steer(layout: FrameLayout, state: CharacterState, command: Command, config: ControllerConfig) -> CharacterState:
    """The state with its target, gait and future trajectory drawn towards the command."""
    velocity = mix(state.target_velocity, command.velocity, config.velocity_rate)
    facing = turn_towards(state.target_direction, command.direction, config.direction_rate)
    ahead = np.arange(1, NUM_POINTS - ROOT, dtype=np.float32) / 60.0
    toward_position = 1.0 - (1.0 - ahead[:, None]) ** config.position_bias
    toward_direction = 1.0 - (1.0 - ahead) ** config.direction_bias
    steps = mix(jnp.diff(state.positions[ROOT:], axis=0), velocity[None] / layout.fps, toward_position)
    future = state.positions[ROOT][None] + jnp.cumsum(steps, axis=0)
    directions = turn_towards(state.directions[ROOT + 1 :], facing, toward_direction)
    gait = mix(state.gait[ROOT], _wanted_gait(velocity, config), config.gait_rate)
    return replace(
        state,
        positions=state.positions.at[ROOT + 1 :].set(future),
        directions=state.directions.at[ROOT + 1 :].set(directions),
        gait=state.gait.at[ROOT:].set(gait),
        target_velocity=velocity,
        target_direction=facing,
    )


def network_input(layout: FrameLayout, state: CharacterState) -> jax.Array:
    """x [Dx] in layout units: the trajectory relative to this root, the joints relative to the previous one."""
    root, facing = state.positions[ROOT], state.directions[ROOT]
    before, faced = state.positions[ROOT - 1], state.directions[ROOT - 1]
    positions = to_local(state.positions[::STRIDE] - root[None], facing) / layout.length_unit
    directions = to_local(state.directions[::STRIDE], facing)
    joints = to_local(state.joint_positions - lift(before)[None], faced) / layout.length_unit
    velocities = to_local(state.joint_velocities, faced) * (layout.time_unit / layout.length_unit)
    blocks = {
        "trajectory_position_x": positions[:, 0],
        "trajectory_position_z": positions[:, 1],
        "trajectory_direction_x": directions[:, 0],
        "trajectory_direction_z": directions[:, 1],
        "gait": state.gait[::STRIDE].T,
        "joint_position": joints,
        "joint_velocity": velocities,
        # The ground is flat, and heights are relative to it.
        "terrain_height": jnp.zeros(3 * len(TRAJECTORY_OFFSETS), positions.dtype),
    }
    return jnp.concatenate([blocks[name].reshape(-1) for name, _ in layout.inputs])


def advance(layout: FrameLayout, state: CharacterState, y: jax.Array, config: ControllerConfig) -> CharacterState:
    """The state before the next frame: joints of this frame placed, root, phase and trajectory moved on by y [Dy]."""
    root, facing = state.positions[ROOT], state.directions[ROOT]
    rate = layout.length_unit / layout.time_unit
    joints = to_world(_block(layout, y, "joint_position", 3) * layout.length_unit, facing) + lift(root)[None]
    # The stored velocity leads from the previous frame to this one; the newly predicted one leads on from here.
    moved = state.joint_positions + state.joint_velocities / layout.fps
    # A character that stands does not drift, and its phase slows to a tenth (Holden 2017's demo).
    moving = jnp.maximum(1.0 - state.gait[ROOT, 0], 0.0) ** 0.25
    travel = to_world(_block(layout, y, "root_velocity", 2)[0] * rate, facing)
    turning = _block(layout, y, "root_yaw_rate", 1)[0, 0] * (layout.yaw_unit / layout.time_unit)
    change = _block(layout, y, "phase_change", 1)[0, 0] * (layout.phase_unit / layout.time_unit)
    new_root = root + moving / layout.fps * travel
    new_facing = unit(turn(facing, moving / layout.fps * turning))
    positions, directions = _predicted_future(layout, y)
    return replace(
        state,
        positions=_shift(state.positions, new_root, to_world(positions, new_facing) + new_root[None]),
        directions=_shift(state.directions, new_facing, to_world(directions, new_facing)),
        gait=_shift(state.gait, state.gait[ROOT], state.gait[ROOT + 1 :]),
        joint_positions=mix(moved, joints, config.pose_rate),
        joint_velocities=to_world(_block(layout, y, "joint_velocity", 3) * rate, facing),
        phase=jnp.mod(state.phase + (0.9 * moving + 0.1) * change / layout.fps, 2.0 * jnp.pi),
    )


def _block(layout: FrameLayout, y: jax.Array, name: str, width: int) -> jax.Array:
    return y[layout.output_slice(name)].reshape(-1, width)


def _predicted_future(layout: FrameLayout, y: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Positions [50, 2] metres and directions [50, 2] of frames 1 to 50 after the next, relative to the next root."""
    names = [f"trajectory_{kind}_{axis}" for kind in ("position", "direction") for axis in "xz"]
    filled = fill_between(jnp.stack([y[layout.output_slice(name)] for name in names], -1))[1:]
    return filled[:, :2] * layout.length_unit, unit(filled[:, 2:])


def _shift(points: jax.Array, now: jax.Array, future: jax.Array) -> jax.Array:
    return jnp.concatenate([points[1 : ROOT + 1], now[None], future])


def _wanted_gait(velocity: jax.Array, config: ControllerConfig) -> jax.Array:
    """[6] gait weights for a velocity [2]: standing below `stand_speed`, else walking or jogging."""
    squared = jnp.sum(velocity * velocity)
    speed = jnp.where(squared > 0.0, jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)), 0.0)
    moving = jnp.clip(speed / config.stand_speed, 0.0, 1.0)
    jogging = (speed >= config.jog_speed).astype(speed.dtype)
    zero = jnp.zeros_like(speed)
    return jnp.stack([1.0 - moving, moving * (1.0 - jogging), moving * jogging, zero, zero, zero])
