"""Keeping to a command: the pace at which a character lives, small turns of the whole of it, and a bound on its haste.

Networks answer speeds and directions as their data did, each style in its own way, and some hardly at all. The
published loop leaves it at that. Here a few things are added around it:

- Pace. The character lives at `pace` times its own time: frames of the network are drawn faster or slower than they
  were predicted, and between them. Root, feet and phase slow down and quicken together, so that feet keep step with the
  ground, and the network notices nothing. One that is told to stand takes its step to its end, and halts as its feet
  come down: at pace 0 it stands.
- Turning. With every frame of its own time the whole character, feet and past included, is turned about its root
  towards the way it shall go, at a bounded rate. The network cannot notice that, as it sees all from the root. One that
  stands is never turned. What is left of that turn under a foot on the ground is the foot lock's to hold.
- Haste. A network reads where it will be from what it predicted before. One that was shown walks and runs can so talk
  itself from walking into running; the way ahead that it is given is therefore nowhere faster than its style allows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.control.ground import angle_between, length, mix, root_yaw, to_local, turn, turn_towards, unit, wrapped
from pfnn_jax.control.loop.state import ROOT, CharacterState
from pfnn_jax.control.loop.step import Command, ControllerConfig

STILL = 0.05
"""Metres per second below which a command is to stand."""

LEAST_SPEED = 0.05
"""Metres per second that a walk has at least, where something is divided by its speed."""

RISE, STOPPING_RISE = 0.02, 0.06
"""Metres per second by which the least height of the feet is forgotten: of its own time while it walks, of the world's
while it waits to halt, so that a slow one does not wait longer."""


@dataclass(frozen=True)
class Regulation:
    """How strictly a character is kept to its command. Rates are shares per frame at 60 fps: of the world for the pace,
    of its own time for what it remembers of its motion.

    Attributes:
        slowest, fastest: bounds of the pace while walking; commands beyond them are not kept.
        pace_rate: of the pace towards the wanted one.
        stopping: the pace at most at which a step is taken to its end before it halts.
        landing_rate: of the pace towards 0, once its feet are down.
        touch: metres above the lowest that its feet have been together, within which they count as down.
        speed_rate: of the running mean of the character's own velocity: about a step.
        heading_rate: of the running mean of how far it is off its way.
        turning: radians per second of turning for each radian off the way.
        most_turning: radians per second, the most that it is turned.
        most_asked: radians, the most that a network is asked to turn at once.
        stretch: share by which the speed asked of a network may differ from its style's own.
        haste: times its style's own speed, the most that the way ahead of it may have.
        astray: radians off its way, beyond which it does not manage to go there as it faces.
        patience: seconds of its own time for which it may be astray before it gives up its facing for its way, and
            seconds in which it does so.
    """

    slowest: float = 0.15
    fastest: float = 2.0
    pace_rate: float = 0.1
    stopping: float = 0.6
    landing_rate: float = 0.2
    touch: float = 0.005
    speed_rate: float = 0.05
    heading_rate: float = 0.08
    turning: float = 4.0
    most_turning: float = 1.0
    most_asked: float = 0.5
    stretch: float = 0.25
    haste: float = 1.25
    astray: float = 0.35
    patience: float = 1.0


STANDARD = Regulation()


@struct.dataclass(kw_only=True)
class Regulated:
    """What regulation remembers of one character.

    Attributes:
        pace: [] its own seconds for each second of the world.
        velocity: [2] metres for each of its own seconds, seen from its root: a running mean.
        off: [] radians about +Y from its way to the wanted one: a running mean.
        astray: [] seconds of its own time for which it has been more off its way than on it, for facing elsewhere.
        lowest: [] metres, the least height to which both of its feet came down of late, the higher of them counted.
        landing: [] bool, whether it is halting.
    """

    pace: jax.Array
    velocity: jax.Array
    off: jax.Array
    astray: jax.Array
    lowest: jax.Array
    landing: jax.Array


def begin(velocity: jax.Array, clearance: jax.Array, pace: float) -> Regulated:
    """Of a character that goes at `velocity` [2], as seen from its root, whenever it goes; at pace 0 it stands."""
    zero = jnp.zeros_like(clearance)
    landing = jnp.asarray(pace == 0.0)
    return Regulated(pace=zero + pace, velocity=velocity, off=zero, astray=zero, lowest=clearance, landing=landing)


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
    that a character turns about in an arc. One that cannot go aside or back as it faces faces where it goes, after a
    while. One that shall stand is asked to go on, and is stopped by its pace.
    """
    speed, facing = length(command.velocity), before.directions[ROOT]
    near = jnp.clip(speed, (1.0 - config.stretch) * own, (1.0 + config.stretch) * own) * share
    kept = jnp.clip(2.0 - regulated.astray / config.patience, 0.0, 1.0)
    left = angle_between(facing, turn_towards(unit(command.velocity), command.direction, kept))
    at_once = jnp.clip(left, -config.most_asked, config.most_asked)
    velocity = turn(command.velocity * (near / jnp.maximum(speed, STILL)), at_once - left)
    moving = speed > STILL
    return replace(
        command,
        velocity=jnp.where(moving, velocity, before.target_velocity / constants.command_gain),
        direction=jnp.where(moving, turn(facing, at_once), before.target_direction),
    )


def hold_back(state: CharacterState, own: jax.Array, fps: float, config: Regulation) -> CharacterState:
    """The state with a way ahead that is nowhere faster than `haste` times its style's `own` [] m/s."""
    steps = jnp.diff(state.positions[ROOT:], axis=0)
    most = config.haste * own / fps
    steps = steps * (most / jnp.maximum(length(steps), most))[:, None]
    future = state.positions[ROOT][None] + jnp.cumsum(steps, axis=0)
    return replace(state, positions=state.positions.at[ROOT + 1 :].set(future))


def observe(
    regulated: Regulated,
    before: CharacterState,
    after: CharacterState,
    command: Command,
    clearance: jax.Array,
    fps: float,
    config: Regulation,
) -> Regulated:
    """What is remembered after one more frame of the character's own time.

    Args:
        regulated: so far.
        before, after: states one frame of the network apart.
        command: what is wanted; a character that shall stand is never off its way.
        clearance: [] metres, the height of its feet after the frame, the higher of them counted.
        fps: frames per second.
        config: rates.
    """
    facing, wanted = before.directions[ROOT], unit(command.velocity)
    moved = to_local((after.positions[ROOT] - before.positions[ROOT]) * fps, facing)
    velocity = mix(regulated.velocity, moved, config.speed_rate)
    moving = length(command.velocity) > STILL
    off = jnp.where(moving, angle_between(turn(facing, root_yaw(velocity)), wanted), 0.0)
    off = wrapped(regulated.off + config.heading_rate * wrapped(off - regulated.off))
    apart = moving & (jnp.abs(angle_between(wanted, command.direction)) > config.astray)
    # Who has given up its facing, and goes where it faces, is not to try again.
    back = jnp.where(regulated.astray < config.patience, -1.0, 0.0)
    astray = jnp.maximum(regulated.astray + jnp.where(jnp.abs(off) > config.astray, 1.0, back) / fps, 0.0)
    # Feet of one who waits to halt count as down a little higher from frame to frame, so that it halts at last.
    rise = jnp.where(moving, RISE, STOPPING_RISE / jnp.maximum(regulated.pace, config.slowest))
    lowest = jnp.minimum(clearance, regulated.lowest + rise / fps)
    down = (clearance <= lowest + config.touch) & (regulated.pace <= config.stopping + 0.05)
    return replace(
        regulated,
        velocity=velocity,
        off=off,
        astray=jnp.where(apart, astray, 0.0),
        lowest=lowest,
        landing=~moving & (regulated.landing | down),
    )


def turning(regulated: Regulated, wanted: jax.Array, fps: float, config: Regulation) -> jax.Array:
    """Radians [] by which a character is turned in one frame of its own time towards a wanted velocity [2]."""
    rate = jnp.clip(config.turning * regulated.off, -config.most_turning, config.most_turning)
    frames = jnp.maximum(regulated.pace, config.slowest)  # of its own time in one of the world
    return jnp.where(length(wanted) > STILL, rate / (fps * frames), 0.0)


def keep_pace(regulated: Regulated, wanted: jax.Array, config: Regulation) -> Regulated:
    """What is remembered, with the pace of the next frame of the world for a wanted velocity [2]."""
    speed, own = length(wanted), jnp.maximum(length(regulated.velocity), LEAST_SPEED)
    moving, pace = speed > STILL, regulated.pace
    landing = regulated.landing & ~moving
    target = jnp.where(
        moving,
        jnp.clip(speed / own, config.slowest, config.fastest),
        jnp.where(landing, 0.0, jnp.minimum(pace, config.stopping)),
    )
    pace = mix(pace, target, jnp.where(landing, config.landing_rate, config.pace_rate))
    return replace(regulated, pace=jnp.where(landing & (pace < 0.03), 0.0, pace), landing=landing)
