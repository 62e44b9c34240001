"""The moves of an engine's blend tree: a style standing, walking, turning and strafing, each as a clip that loops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.controller import Controller, Embodiment, rollout_commands
from pfnn_jax.control.controller_state import ControllerState, style_speed
from pfnn_jax.control.loop.step import Command
from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, cut, move_clip
from pfnn_jax.motion.cycles import GAIT_SECONDS, cut_cycle
from pfnn_jax.motion.ground import angle_between, facing_of, yaw_of
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_rotate
from pfnn_jax.motion.trajectory import root_motion
from pfnn_jax.motion.world_motion import world_motion

WARM_UP_SECONDS = 4.0
"""A move is shown from here on: the character has reached its speed and heading."""

SHOWN_SECONDS = 6.0
"""At least two cycles of the slowest gait."""

IDLE_SECONDS = (2.0, 5.5)
"""Shortest and longest loop of standing."""

CURVE, SPOT = np.deg2rad(60.0), np.deg2rad(90.0)
"""Radians per second of turns while walking and on the spot."""

ASIDE = 0.7
"""Speed of strafing and of walking backward relative to walking ahead."""

MOST_ERROR = np.deg2rad(30.0)
"""Mean error of heading or facing from which on a style cannot make a move."""

LEAST_SPEED = 0.5
"""Share of the commanded speed below which it cannot either."""


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
    "turn_left": Move(speed=0.0, turn_rate=SPOT, seconds=IDLE_SECONDS),
    "turn_right": Move(speed=0.0, turn_rate=-SPOT, seconds=IDLE_SECONDS),
    "strafe_left": Move(speed=ASIDE, heading=np.pi / 2),
    "strafe_right": Move(speed=ASIDE, heading=-np.pi / 2),
    "backward": Move(speed=ASIDE, heading=np.pi),
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
        controller: of the character.
        weights: [C] of the style.
        body: the controller was made for.

    Raises:
        InputError: for a style that makes none of them.
    """
    speed = float(style_speed(controller.params, jnp.asarray(weights)).natural)
    commands = [_commands(move, speed, body.layout.fps) for move in MOVES.values()]
    start = replace(controller.start(), style=jnp.asarray(weights))
    run = jax.vmap(partial(rollout_commands, controller.setup, controller.params, start))
    _, states = run(jax.tree.map(lambda *leaves: jnp.stack(leaves), *commands))
    clips, notes = {}, []
    for number, (name, move) in enumerate(MOVES.items()):
        own = jax.tree.map(lambda leaf: np.asarray(leaf[number]), states)  # noqa: B023 - used at once
        try:
            _check(name, move, own, commands[number], speed * move.speed)
            shown = cut(_clip(own, name, body), round(WARM_UP_SECONDS * body.layout.fps), len(own.root))
            clips[name] = _at_origin(cut_cycle(shown, seconds=move.seconds), move)
        except InputError as error:
            notes.append(f"{name} is left out: {error.value}")
    if not clips:
        raise InputError(getattr(body, "path", "memory"), "moves", "none", "the network cannot walk in this style")
    return MoveClips(clips, tuple(notes))


def _commands(move: Move, speed: float, fps: float) -> Command:
    """Returns the commands, leaves [T, 2], of a move at a style's natural speed."""
    yaw = move.turn_rate * np.arange(round((WARM_UP_SECONDS + SHOWN_SECONDS) * fps)) / fps
    velocity = move.speed * speed * facing_of(yaw + move.heading)
    return Command(velocity=jnp.asarray(velocity, jnp.float32), direction=jnp.asarray(facing_of(yaw), jnp.float32))


def _check(name: str, move: Move, states: ControllerState, command: Command, speed: float) -> None:
    """Refuses a move in which the character does not do what it is commanded.

    Args:
        name: of the move.
        move: the move.
        states: leaves [T, ...].
        command: leaves [T, 2].
        speed: commanded, m/s.
    """
    half = len(states.root) // 2
    facing = np.abs(angle_between(np.asarray(command.direction), states.facing)[half:]).mean()
    if move.turn_rate == 0.0 and facing > MOST_ERROR:
        raise InputError("style", name, f"it faces {np.degrees(facing):.0f} degrees elsewhere", "must face as told")
    if speed > 0.0:
        steps = np.linalg.norm(np.diff(states.root[half:], axis=0), axis=-1)
        reached = steps.mean() * 60.0
        if reached < LEAST_SPEED * speed:
            raise InputError("style", name, f"{reached:.2f} of {speed:.2f} m/s", "must move")


def _clip(states: ControllerState, name: str, body: Embodiment) -> MotionClip:
    """Returns the clip of states, leaves [T, ...].

    Raises:
        InputError: if a value is not finite.
    """
    hips, rotations = np.asarray(states.pose.hips, np.float64), np.asarray(states.pose.rotations, np.float64)
    if not (np.isfinite(hips).all() and np.isfinite(rotations).all()):
        raise InputError(getattr(body, "path", "memory"), name, "not finite", "the network cannot walk in this style")
    return MotionClip(body.skeleton, body.layout.fps, hips, rotations, content=name)


def _at_origin(cycle: MotionClip, move: Move) -> MotionClip:
    """Returns a cycle that begins at the origin: a straight one travels along its heading, a turn begins facing +Z."""
    motion = world_motion(cycle)
    facing = root_motion(motion.positions, motion.roles, cycle.fps).facing
    yaw = yaw_of(facing[0])
    if move.speed > 0.0 and move.turn_rate == 0.0:
        yaw = yaw_of((cycle.root_positions[-1] - cycle.root_positions[0])[[0, 2]]) - move.heading
    back = quat_from_yaw(-yaw)
    start = quat_rotate(back, cycle.root_positions[0]) * [1.0, 0.0, 1.0]
    return move_clip(cycle, back, -start)
