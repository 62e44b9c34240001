"""One frame of the published loop: the command bends the trajectory, the network's output moves the body.

The loop of Holden 2017, Mason 2018 (§5.1) and Mason 2022, a pure function of one character and one frame:
`published_step`. At frame i

1. `steer` turns the predicted future trajectory towards the command,
2. `network_input` writes x_i from the state,
3. the network predicts y_i, and
4. `advance` places the joints and advances root, phase and trajectory to frame i+1.

The state is in metres, seconds and radians in the world. Steps 2 and 4 differ between layouts: they have two frame
rules, `rule_2017` and, for next-frame layouts, `rule_2022`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.loop import rule_2017, rule_2022
from pfnn_jax.control.loop.state import NUM_POINTS, ROOT, CharacterState
from pfnn_jax.control.vectors import length, lerp, running_sum
from pfnn_jax.errors import check_positive, check_share
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.ground import turn_towards

Evaluate = Callable[[jax.Array, jax.Array], jax.Array]
"""(x [Dx], phase [] or [G]) -> y [Dy], in layout units."""


@dataclass(frozen=True)
class LoopConfig:
    """Constants of the published loop. Shares are per frame at 60 fps.

    Attributes:
        position_bias, direction_bias: a future point w seconds ahead takes the share 1 - (1 - w)^bias of the command.
        velocity_rate, direction_rate, gait_rate: share by which a target moves to the commanded one.
        look_ahead: seconds, at the commanded speed, to the target on a followed path.
        pose_rate: share of the predicted joint positions; the rest is the previous pose advanced by its velocity.
        stand_speed: metres per second below which the gait blends into standing.
        jog_speed: metres per second from which the gait is jog (only `pfnn2017` reads gaits other than stand).
        trajectory_rate, phase_rate: shares of the predicted trajectory and local phases, see `rule_2022`
            (next-frame layouts only).
        steering: on a followed path, the least share of the angle between facing and target by which the commanded
            facing turns, see `pursuit`. Below 1 a character keeps the sway of its style.
        command_gain: factor on commanded velocities, for a network that was steered in other units than metres per
            second.
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
    trajectory_rate: float = 0.85
    phase_rate: float = 0.5
    steering: float = 1.0
    command_gain: float = 1.0

    def __post_init__(self) -> None:
        shares = (
            "velocity_rate",
            "direction_rate",
            "gait_rate",
            "pose_rate",
            "trajectory_rate",
            "phase_rate",
            "steering",
        )
        check_share(self, *shares)
        check_positive(
            self, "position_bias", "direction_bias", "stand_speed", "jog_speed", "look_ahead", "command_gain"
        )


_MASON = LoopConfig(0.75, 1.25, velocity_rate=0.25, direction_rate=0.25, gait_rate=0.25, look_ahead=0.8)
_MASON_2022 = replace(_MASON, steering=0.25)

LOOP_CONFIGS = {
    "mason2018": _MASON,
    "mason2022": _MASON_2022,
    "mason2022_mann": _MASON_2022,
    "mason2022_pfnn": _MASON_2022,
    "pfnn2017": LoopConfig(0.5, 2.0, velocity_rate=0.9, direction_rate=0.9, gait_rate=0.1, look_ahead=0.6),
}
"""The constants of the published demos, by layout. The demos do not follow paths: the look-aheads are those that kept
closest to circles and figures of eight, with the released network and with one trained on procedural walks."""


@struct.dataclass(kw_only=True)
class Command:
    """The command to a character for one frame, in the world.

    Attributes:
        velocity: [2] metres per second on the ground (x, z); zero means stop.
        direction: [2] desired facing direction, unit vector.
        style: [C] weights of the styles that a `pfnn_jax.control.controller.Controller` holds; None keeps the
            style. The published loop does not use them.
    """

    velocity: jax.Array
    direction: jax.Array
    style: jax.Array | None = None


def published_step(
    evaluate: Evaluate,
    layout: FrameLayout,
    state: CharacterState,
    command: Command,
    config: LoopConfig | None = None,
) -> tuple[CharacterState, jax.Array]:
    """Computes one frame of one character.

    Args:
        evaluate: the network, (x [Dx], phase [] or [G]) -> y [Dy] in layout units.
        layout: its layout.
        state: before frame i.
        command: of frame i.
        config: by default the published constants of the layout.

    Returns:
        The state before frame i+1, and y_i [Dy] in layout units. Root i is the state's point `ROOT - 1`; its joints
        are those that y_i predicts: of frame i, or of frame i+1 for a next-frame layout.
    """
    config = config or LOOP_CONFIGS[layout.name]
    state = steer(layout, state, command, config)
    y = evaluate(network_input(layout, state), state.phase)
    return advance(layout, state, y, config), y


def steer(layout: FrameLayout, state: CharacterState, command: Command, config: LoopConfig) -> CharacterState:
    """Moves target, gait and future trajectory of a state towards the command."""
    velocity = lerp(state.target_velocity, config.command_gain * command.velocity, config.velocity_rate)
    facing = turn_towards(state.target_direction, command.direction, config.direction_rate)
    ahead = np.arange(1, NUM_POINTS - ROOT, dtype=np.float32) / 60.0
    toward_position = 1.0 - (1.0 - ahead[:, None]) ** config.position_bias
    toward_direction = 1.0 - (1.0 - ahead) ** config.direction_bias
    steps = lerp(jnp.diff(state.positions[ROOT:], axis=0), velocity[None] / layout.fps, toward_position)
    future = state.positions[ROOT][None] + running_sum(steps)
    directions = turn_towards(state.directions[ROOT + 1 :], facing, toward_direction)
    gait = lerp(state.gait[ROOT], _wanted_gait(velocity, config), config.gait_rate)
    return replace(
        state,
        # Joined, not set in place: a crowd's step would evaluate the new directions for all 111 points.
        positions=jnp.concatenate([state.positions[: ROOT + 1], future]),
        directions=jnp.concatenate([state.directions[: ROOT + 1], directions]),
        gait=state.gait.at[ROOT:].set(gait),
        target_velocity=velocity,
        target_direction=facing,
    )


def held_command(state: CharacterState, config: LoopConfig) -> Command:
    """Returns the command that leaves the targets of a state unchanged."""
    return Command(velocity=state.target_velocity / config.command_gain, direction=state.target_direction)


def network_input(layout: FrameLayout, state: CharacterState) -> jax.Array:
    """Returns x [Dx] in layout units for a steered state, by the layout's frame rule."""
    return (rule_2022 if layout.next_frame else rule_2017).network_input(layout, state)


def advance(layout: FrameLayout, state: CharacterState, y: jax.Array, config: LoopConfig) -> CharacterState:
    """Returns the state before the next frame, by the layout's frame rule, of a steered state and its output y [Dy]."""
    if layout.next_frame:
        return rule_2022.advance(layout, state, y, config.pose_rate, config.trajectory_rate, config.phase_rate)
    return rule_2017.advance(layout, state, y, config.pose_rate)


def _wanted_gait(velocity: jax.Array, config: LoopConfig) -> jax.Array:
    """Returns gait weights [6] for a velocity [2]: standing below `stand_speed`, else walking or jogging."""
    speed = length(velocity)
    moving = jnp.clip(speed / config.stand_speed, 0.0, 1.0)
    jogging = (speed >= config.jog_speed).astype(speed.dtype)
    zero = jnp.zeros_like(speed)
    return jnp.stack([1.0 - moving, moving * (1.0 - jogging), moving * jogging, zero, zero, zero])
