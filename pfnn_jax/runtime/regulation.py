"""Keeping to a command: the pace at which a character lives, and small turns of the whole of it.

Networks answer speeds and directions as their data did, each style in its own way, and some hardly at all. The
published loop leaves it at that. Here two things are added around it:

- Pace. The character lives at `pace` times its own time: frames of the network are drawn faster or slower than they
  were predicted, and between them. Root, feet and phase slow down and quicken together, so that feet keep step with the
  ground, and the network notices nothing. At pace 0 the character stands.
- Turning. With every frame of its own time the whole character, feet and past included, is turned about its root
  towards the way it shall go, at a bounded rate. The network cannot notice that, as it sees all from the root. One that
  stands is never turned. What is left of that turn under a foot on the ground is the foot lock's to hold.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.runtime.frame import Command, ControllerConfig
from pfnn_jax.runtime.ground import lift, mix, root_yaw, to_local, turn, unit
from pfnn_jax.runtime.state import ROOT, CharacterState

STILL = 0.05
"""Metres per second below which a command is to stand."""


@dataclass(frozen=True)
class Regulation:
    """How strictly a character is kept to its command. Rates are shares per frame at 60 fps.

    Attributes:
        slowest, fastest: bounds of the pace while walking.
        pace_rate: of the pace towards the wanted one.
        speed_rate: of the running mean of the character's own velocity: about a step.
        heading_rate: of the running mean of how far it is off its way.
        turning: radians per second of turning for each radian off the way.
        most_turning: radians per second, the most that it is turned.
        most_asked: radians, the most that a network is asked to turn at once.
        stretch: share by which the speed asked of a network may differ from its style's own.
    """

    slowest: float = 0.3
    fastest: float = 2.0
    pace_rate: float = 0.1
    speed_rate: float = 0.05
    heading_rate: float = 0.08
    turning: float = 4.0
    most_turning: float = 1.0
    most_asked: float = 0.5
    stretch: float = 0.25


STANDARD = Regulation()


@struct.dataclass(kw_only=True)
class Regulated:
    """What regulation remembers of one character.

    Attributes:
        pace: [] its own seconds for each second of the world.
        velocity: [2] metres for each of its own seconds, seen from its root: a running mean.
        off: [] radians about +Y from its way to the wanted one: a running mean.
    """

    pace: jax.Array
    velocity: jax.Array
    off: jax.Array


def ask(
    command: Command,
    own: jax.Array,
    share: jax.Array,
    before: CharacterState,
    regulated: Regulated,
    constants: ControllerConfig,
    config: Regulation,
) -> Command:
    """What to ask of the network for a command, of a style that walks at `own` [] m/s if asked for a share [] of that.

    Networks that are asked for what their style never did may lose its gait. So they are asked for speeds near its
    own, and what is missing is left to the pace; and for turns by as much as the published demos ask for at once, so
    that a character turns about in an arc. One that shall stand is asked to go on, and is stopped by its pace.
    """
    speed = _length(command.velocity)
    near = jnp.clip(speed, (1.0 - config.stretch) * own, (1.0 + config.stretch) * own) * share
    left = angle_between(before.directions[ROOT], command.direction)
    at_once = jnp.clip(left, -config.most_asked, config.most_asked)
    velocity = turn(command.velocity * (near / jnp.maximum(speed, STILL)), at_once - left)
    moving = speed > STILL
    return replace(
        command,
        velocity=jnp.where(moving, velocity, before.target_velocity / constants.command_gain),
        direction=jnp.where(moving, turn(before.directions[ROOT], at_once), before.target_direction),
    )


def observe(
    regulated: Regulated,
    before: CharacterState,
    after: CharacterState,
    command: Command,
    fps: float,
    config: Regulation,
) -> Regulated:
    """Running means of velocity and heading after one more frame of the character's own time.

    Args:
        regulated: so far.
        before, after: states one frame of the network apart.
        command: what is wanted; a character that shall stand is never off its way.
        fps: frames per second.
        config: rates.
    """
    facing = before.directions[ROOT]
    moved = to_local((after.positions[ROOT] - before.positions[ROOT]) * fps, facing)
    velocity = mix(regulated.velocity, moved, config.speed_rate)
    going = turn(facing, root_yaw(velocity))
    off = jnp.where(_length(command.velocity) > STILL, angle_between(going, unit(command.velocity)), 0.0)
    change = jnp.mod(off - regulated.off + jnp.pi, 2.0 * jnp.pi) - jnp.pi
    off = regulated.off + config.heading_rate * change
    return replace(regulated, velocity=velocity, off=jnp.mod(off + jnp.pi, 2.0 * jnp.pi) - jnp.pi)


def turning(regulated: Regulated, wanted: jax.Array, fps: float, config: Regulation) -> jax.Array:
    """Radians [] by which a character is turned in one frame of its own time towards a wanted velocity [2]."""
    rate = jnp.clip(config.turning * regulated.off, -config.most_turning, config.most_turning)
    world = jnp.clip(regulated.pace, config.slowest, 1.0)  # frames of its own time in one of the world
    return jnp.where(_length(wanted) > STILL, rate / (fps * world), 0.0)


def keep_pace(regulated: Regulated, wanted: jax.Array, contacts: jax.Array, config: Regulation) -> Regulated:
    """The pace of the next frame of the world.

    Args:
        regulated: as `observe` leaves it.
        wanted: [2] m/s asked for in the world.
        contacts: [4] of the feet: a character halts when both are on the ground.
        config: rates.
    """
    speed, own = _length(wanted), jnp.maximum(_length(regulated.velocity), 0.05)
    moving = speed > STILL
    target = jnp.where(moving, jnp.clip(speed / own, config.slowest, config.fastest), 0.0)
    both = jnp.minimum(jnp.max(contacts[:2]), jnp.max(contacts[2:])) > 0.5
    halted = ~moving & ((both & (regulated.pace < 0.6)) | (regulated.pace < 0.05))
    pace = mix(regulated.pace, target, jnp.where(moving, config.pace_rate, 0.04))
    return replace(regulated, pace=jnp.where(halted, 0.0, pace))


def turn_state(state: CharacterState, angle: jax.Array) -> CharacterState:
    """The character turned about its root by an angle [] radians, and the way behind it with it: seen from
    its root nothing has changed."""
    root = state.positions[ROOT]

    def turned(v: jax.Array) -> jax.Array:
        level = turn(jnp.stack([v[..., 0], v[..., -1]], -1), angle)
        middle = [v[..., axis] for axis in range(1, v.shape[-1] - 1)]
        return jnp.stack([level[..., 0], *middle, level[..., 1]], -1)

    return replace(
        state,
        positions=turned(state.positions - root[None]) + root[None],
        directions=turned(state.directions),
        joint_positions=turned(state.joint_positions - lift(root)[None]) + lift(root)[None],
        joint_velocities=turned(state.joint_velocities),
        joint_forward=None if state.joint_forward is None else turned(state.joint_forward),
        joint_up=None if state.joint_up is None else turned(state.joint_up),
    )


def angle_between(a: jax.Array, b: jax.Array) -> jax.Array:
    """Radians about +Y from a direction [2] to another [2], in (-π, π]."""
    return jnp.arctan2(a[1] * b[0] - a[0] * b[1], a[0] * b[0] + a[1] * b[1])


def _length(v: jax.Array) -> jax.Array:
    squared = jnp.dot(v, v)
    return jnp.where(squared > 0.0, jnp.sqrt(jnp.where(squared > 0.0, squared, 1.0)), 0.0)
