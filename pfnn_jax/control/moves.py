"""The moves of an engine's blend tree: a style standing, walking, turning and strafing, each as a clip that loops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from operator import itemgetter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.abilities import facing_error, keeps_facing
from pfnn_jax.control.controller import Controller, Embodiment, rollout_commands
from pfnn_jax.control.controller_state import ControllerState, style_speed
from pfnn_jax.control.generation import clip_of_states
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.standing import StandingConfig
from pfnn_jax.control.tracking import TrackingConfig
from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, cut, move_clip
from pfnn_jax.motion.cycles import GAIT_SECONDS, MAX_TURN, cut_cycle
from pfnn_jax.motion.ground import facing_of, yaw_of
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_rotate
from pfnn_jax.motion.trajectory import root_motion
from pfnn_jax.motion.world_motion import world_motion

WARM_UP_SECONDS = 4.0
"""A move is shown from here on: the character has reached its speed and heading."""

SHOWN_SECONDS = 9.0
"""At least two cycles of the slowest gait, and one of the sway of standing."""

IDLE_SECONDS = (0.99 * StandingConfig().sway_seconds[0], 1.01 * StandingConfig().sway_seconds[0])
"""Shortest and longest loop of standing: its sway repeats itself exactly after a weight shift."""

CURVE, SPOT = np.deg2rad(60.0), np.deg2rad(90.0)
"""Radians per second of turns while walking and on the spot."""

SPOT_SECONDS = (0.5, MAX_TURN / SPOT)
"""Shortest and longest loop of turning on the spot."""

STRAFE_SPEED = 0.7
"""Speed of strafes and of walking backward, relative to walking ahead."""

MIN_SPEED_SHARE = 0.5
"""Share of the commanded speed or turn rate below which a move is left out."""


@dataclass(frozen=True)
class Move:
    """What a character is commanded to do, steadily.

    Attributes:
        speed: relative to the style's natural speed; 0 stands.
        heading: radians from the facing direction to that of travel, positive to the left.
        turn_rate: radians per second about +Y, positive to the left.
        seconds: shortest and longest cycle.
    """

    speed: float = 1.0
    heading: float = 0.0
    turn_rate: float = 0.0
    seconds: tuple[float, float] = GAIT_SECONDS


MOVES: dict[str, Move] = {
    "idle": Move(speed=0.0, seconds=IDLE_SECONDS),
    "walk": Move(),
    "walk_left": Move(turn_rate=CURVE),
    "walk_right": Move(turn_rate=-CURVE),
    "turn_left": Move(speed=0.0, turn_rate=SPOT, seconds=SPOT_SECONDS),
    "turn_right": Move(speed=0.0, turn_rate=-SPOT, seconds=SPOT_SECONDS),
    "strafe_left": Move(speed=STRAFE_SPEED, heading=np.pi / 2),
    "strafe_right": Move(speed=STRAFE_SPEED, heading=-np.pi / 2),
    "backward": Move(speed=STRAFE_SPEED, heading=np.pi),
}
"""By the name of the clip."""


@dataclass(frozen=True, eq=False)
class MoveClips:
    """The moves of one style.

    Attributes:
        clips: by name, each a cycle that closes (`motion.cycles.cut_cycle`).
        notes: one line for each move that the style cannot make.
    """

    clips: dict[str, MotionClip]
    notes: tuple[str, ...]


def make_moves(controller: Controller, weights: np.ndarray, body: Embodiment) -> MoveClips:
    """Returns the moves of a style that it can make.

    Args:
        controller: of the character, with command tracking.
        weights: [C] of the style.
        body: the controller was made for.

    Raises:
        InputError: for a style that makes none of them.
        ValueError: for a controller without command tracking, which obeys no facing.
    """
    tracking, fps = controller.setup.tracking, body.layout.fps
    if tracking is None:
        raise ValueError("`controller` must have command tracking.")
    speed = float(style_speed(controller.params, jnp.asarray(weights)).natural)
    commands = [_commands(move, speed, fps) for move in MOVES.values()]
    start = replace(controller.start(), style=jnp.asarray(weights))
    run = jax.vmap(partial(rollout_commands, controller.setup, controller.params, start))
    states = jax.tree.map(np.asarray, run(jax.tree.map(lambda *leaves: jnp.stack(leaves), *commands))[1])
    clips, notes = {}, []
    for number, (name, move) in enumerate(MOVES.items()):
        own = jax.tree.map(itemgetter(number), states)
        try:
            clip = clip_of_states(own, body, name)
            _check(move, _late(own), _late(commands[number]), fps, tracking)
            shown = cut(clip, round(WARM_UP_SECONDS * fps), clip.num_frames)
            clips[name] = at_origin(cut_cycle(shown, seconds=move.seconds), move)
        except InputError as error:
            notes.append(f"{name} is left out: {error.value}")
    if not clips:
        raise InputError(getattr(body, "path", "memory"), "moves", "none", "choose another style: it can make no move")
    return MoveClips(clips, tuple(notes))


def _commands(move: Move, speed: float, fps: float) -> Command:
    """Returns the commands, leaves [T, 2], of a move at a style's natural speed."""
    yaw = move.turn_rate * np.arange(round((WARM_UP_SECONDS + SHOWN_SECONDS) * fps)) / fps
    velocity = move.speed * speed * facing_of(yaw + move.heading)
    return Command(velocity=jnp.asarray(velocity, jnp.float32), direction=jnp.asarray(facing_of(yaw), jnp.float32))


def _late(tree: Any) -> Any:
    """Returns the second half of the frames of leaves [T, ...]: the character has reached its speed and heading."""
    return jax.tree.map(lambda leaf: np.asarray(leaf)[len(leaf) // 2 :], tree)


def _check(move: Move, states: ControllerState, command: Command, fps: float, tracking: TrackingConfig) -> None:
    """Refuses a move in which the character does not do what it is commanded.

    Args:
        move: the move.
        states: leaves [T, ...].
        command: leaves [T, 2].
        fps: frames per second.
        tracking: constants of command tracking.

    Raises:
        InputError: whose value says what the character does instead.
    """
    facing, failure = np.asarray(states.facing), float(states.tracking.strafe_failure[-1])
    direction = np.asarray(command.direction)
    if move.turn_rate == 0.0 and not keeps_facing(facing, direction, failure, tracking):
        error = np.degrees(facing_error(facing, direction))
        raise InputError(
            "style", "facing", f"it turns away by {error:.0f} degrees", "must face the commanded direction"
        )
    yaw = np.unwrap(yaw_of(facing))
    rate, wanted = np.degrees([(yaw[-1] - yaw[0]) * fps / (len(yaw) - 1), move.turn_rate])
    if wanted != 0.0 and rate / wanted < MIN_SPEED_SHARE:
        raise InputError(
            "style", "turn rate", f"it turns at {rate:.0f} of {wanted:.0f} degrees per second", "must turn"
        )
    speed = float(np.linalg.norm(np.diff(states.root, axis=0), axis=-1).mean() * fps)
    commanded = float(np.linalg.norm(command.velocity, axis=-1).mean())
    if speed < MIN_SPEED_SHARE * commanded:
        raise InputError("style", "speed", f"it moves at {speed:.2f} of {commanded:.2f} m/s", "must move")


def at_origin(cycle: MotionClip, move: Move) -> MotionClip:
    """Returns a cycle that begins at the origin: a straight one travels along its heading, a turn begins facing +Z."""
    motion = world_motion(cycle)
    facing = root_motion(motion.positions, motion.roles, cycle.fps).facing
    yaw = yaw_of(facing[0])
    if move.speed > 0.0 and move.turn_rate == 0.0:
        yaw = yaw_of((cycle.root_positions[-1] - cycle.root_positions[0])[[0, 2]]) - move.heading
    back = quat_from_yaw(-yaw)
    start = quat_rotate(back, cycle.root_positions[0]) * [1.0, 0.0, 1.0]
    return move_clip(cycle, back, -start)
