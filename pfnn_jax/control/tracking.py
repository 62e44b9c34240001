"""Command tracking: time scaling, heading correction and a limit on the look-ahead speed.

Networks answer requested speeds and directions as their training data did, each style in its own way, and some hardly
at all. The published loop leaves it at that. Command tracking wraps it in three corrections:

- Time scaling. The character runs at `time_scale` times network time: its frames are interpolated, and drawn faster or
  slower than they were predicted. Root, feet and phase change speed together, so feet stay in step with the ground, and
  the inputs of the network do not change. When commanded to stop, the drawn body leaves the network's motion
  (`standing`); the network goes on unseen until its feet pass each other, and waits there (time scale 0).
- Heading correction. With every network frame the whole character, including its feet and its past trajectory, is
  rotated towards the commanded heading at a bounded rate, about the foot on which it stands, so that this foot does not
  slide. Network inputs are relative to the root, so they do not change. A standing character is never rotated.
- Look-ahead limit. A network reads a future trajectory that it predicted itself. One trained on walks and runs can
  drift from a walk into a run (positive feedback through its own trajectory input), so the speed of the future
  trajectory is limited to what the style allows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.control.loop.state import ROOT, CharacterState
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.vectors import length, lerp, running_sum, unit
from pfnn_jax.errors import check_positive, check_share
from pfnn_jax.motion.ground import angle_between, to_local, turn, turn_towards, wrap_angle, yaw_of

STOP_SPEED = 0.05
"""Metres per second; a slower command means stop."""

MIN_WALK_SPEED = 0.05
"""Metres per second; lower bound of a walking speed used as a divisor."""

DISTANCE_RISE = 0.05
"""Metres per second of network time at which the recent minimum of the distance between the feet rises again."""


@dataclass(frozen=True)
class TrackingConfig:
    """Constants of command tracking. Rates are shares per frame at 60 fps: per displayed frame for the time scale, per
    network frame for the running means.

    Attributes:
        min_time_scale, max_time_scale: bounds of the time scale while walking; speeds beyond them are not reached.
        time_scale_rate: of the time scale towards its target.
        stopping_time_scale: lower bound of the time scale of a network that goes on unseen.
        passing_tolerance: metres above the recent minimum of the distance between the feet within which they pass.
        velocity_rate: of the running mean of the character's velocity, which spans about one step.
        heading_rate: of the running mean of the heading error: over a gait cycle, so that the sway of a slow walk is
            not corrected.
        correction_gain: radians per second of heading correction per radian of heading error.
        max_correction_rate: radians per second, upper bound of the heading correction.
        standing_contact: contact, the mean of heel and toe, above which a foot stands and can be turned about.
        max_requested_turn: radians, the largest turn that is requested from the network at once.
        speed_tolerance: largest relative difference between the speed requested from a network and the natural speed
            of its style.
        max_lookahead_ratio: upper bound of the predicted trajectory's speed, as a multiple of the natural speed.
        heading_tolerance: radians, heading error above which strafing is considered to have failed.
        strafe_timeout: seconds of network time for which strafing may fail before the facing constraint is released,
            and seconds over which it is released.
        fps: frames per second.
    """

    min_time_scale: float = 0.15
    max_time_scale: float = 2.0
    time_scale_rate: float = 0.1
    stopping_time_scale: float = 0.6
    passing_tolerance: float = 0.03
    velocity_rate: float = 0.05
    heading_rate: float = 0.03
    correction_gain: float = 1.0
    max_correction_rate: float = 1.0
    standing_contact: float = 0.5
    max_requested_turn: float = 0.5
    speed_tolerance: float = 0.25
    max_lookahead_ratio: float = 1.25
    heading_tolerance: float = 0.35
    strafe_timeout: float = 1.0
    fps: float = 60.0

    def __post_init__(self) -> None:
        check_share(self, "time_scale_rate", "velocity_rate", "heading_rate", "standing_contact")
        check_positive(self, "min_time_scale", "stopping_time_scale", "strafe_timeout", "max_lookahead_ratio", "fps")
        if self.max_time_scale < self.min_time_scale:
            found = f"got {self.max_time_scale}"
            raise ValueError(f"TrackingConfig.max_time_scale must be at least min_time_scale, {found}.")


@struct.dataclass(kw_only=True)
class StyleSpeed:
    """The walking speed of a style, or of a mixture of styles.

    Attributes:
        natural: [] metres per second at which the style walks.
        gain: [] speed to request from the network, as a multiple of the natural speed, so that it walks at the natural
            speed (`pfnn_jax.control.calibration.calibrate_speeds`).
    """

    natural: jax.Array
    gain: jax.Array


@struct.dataclass(kw_only=True)
class TrackingState:
    """The state of command tracking for one character.

    Attributes:
        time_scale: [] seconds of network time per second of real time; 0 while the network waits.
        velocity: [2] metres per second of network time relative to the root: a running mean.
        heading_error: [] radians about +Y from the actual to the commanded heading: a running mean.
        strafe_failure: [] seconds of network time by which failing to strafe outweighs succeeding.
        min_distance: [] metres, recent minimum of the distance between the feet.
        waiting: [] bool, whether the network waits for the next walk.
    """

    time_scale: jax.Array
    velocity: jax.Array
    heading_error: jax.Array
    strafe_failure: jax.Array
    min_distance: jax.Array
    waiting: jax.Array


def init_tracking(velocity: jax.Array, distance: jax.Array, time_scale: float) -> TrackingState:
    """Returns the state of a character that starts at a time scale; at 0 its network waits.

    Args:
        velocity: [2] metres per second of network time, relative to the root.
        distance: [] metres between the feet.
        time_scale: initial time scale.
    """
    zero = jnp.zeros_like(distance)
    return TrackingState(
        time_scale=zero + time_scale,
        velocity=velocity,
        heading_error=zero,
        strafe_failure=zero,
        min_distance=distance,
        waiting=jnp.asarray(time_scale == 0.0),
    )


def is_moving(command: Command) -> jax.Array:
    """Returns whether [] a command is to move, not to stop."""
    return length(command.velocity) > STOP_SPEED


def network_command(
    command: Command, facing: jax.Array, speed: StyleSpeed, tracking: TrackingState, config: TrackingConfig
) -> Command:
    """Returns the command to pass to the network so that a moving character tracks `command`.

    Out-of-distribution commands can break the gait of a network. The requested speed therefore stays near the natural
    speed of the style, and the rest is left to the time scale; the requested turn stays within what the published demos
    request at once, so the character turns about in an arc. If the style cannot strafe, the facing constraint is
    dropped after `strafe_timeout`.

    Args:
        command: of the user, above `STOP_SPEED`.
        facing: [2] unit vector that the root faces.
        speed: of the character's style.
        tracking: state before this frame.
        config: constants.
    """
    wanted = length(command.velocity)
    lower, upper = 1.0 - config.speed_tolerance, 1.0 + config.speed_tolerance
    requested = jnp.clip(wanted, lower * speed.natural, upper * speed.natural) * speed.gain
    constraint = jnp.clip(2.0 - tracking.strafe_failure / config.strafe_timeout, 0.0, 1.0)
    turn_left = angle_between(facing, turn_towards(unit(command.velocity), command.direction, constraint))
    turn_now = jnp.clip(turn_left, -config.max_requested_turn, config.max_requested_turn)
    velocity = command.velocity * (requested / jnp.maximum(wanted, STOP_SPEED))
    return replace(command, velocity=turn(velocity, turn_now - turn_left), direction=turn(facing, turn_now))


def limit_lookahead(state: CharacterState, natural_speed: jax.Array, config: TrackingConfig) -> CharacterState:
    """Limits the speed of the future trajectory to `max_lookahead_ratio` times the natural speed [] m/s."""
    steps = jnp.diff(state.positions[ROOT:], axis=0)
    longest = config.max_lookahead_ratio * natural_speed / config.fps
    steps = steps * (longest / jnp.maximum(length(steps), longest))[:, None]
    future = state.positions[ROOT][None] + running_sum(steps)
    return replace(state, positions=state.positions.at[ROOT + 1 :].set(future))


def update_tracking(
    tracking: TrackingState,
    before: CharacterState,
    after: CharacterState,
    command: Command,
    distance: jax.Array,
    stands: jax.Array,
    config: TrackingConfig,
) -> TrackingState:
    """Returns the tracking state after one more network frame.

    Args:
        tracking: state before the frame.
        before, after: states of the character before and after the frame.
        command: of the user. The heading error of a character that is commanded to stop is 0.
        distance: [] metres between the feet after the frame.
        stands: [] bool, whether nothing of the network's motion is drawn, so that it may wait.
        config: constants.
    """
    moving, facing = is_moving(command), before.directions[ROOT]
    step = (after.positions[ROOT] - before.positions[ROOT]) * config.fps
    velocity = lerp(tracking.velocity, to_local(step, facing), config.velocity_rate)
    heading_error = _heading_error(tracking, turn(facing, yaw_of(velocity)), command, config)
    min_distance = jnp.minimum(distance, tracking.min_distance + DISTANCE_RISE / config.fps)
    passing = distance <= min_distance + config.passing_tolerance
    return replace(
        tracking,
        velocity=velocity,
        heading_error=heading_error,
        strafe_failure=_strafe_failure(tracking, heading_error, command, config),
        min_distance=min_distance,
        waiting=~moving & (tracking.waiting | (passing & stands)),
    )


def _heading_error(tracking: TrackingState, heading: jax.Array, command: Command, config: TrackingConfig) -> jax.Array:
    """Returns the running mean [] of the angle from a heading [2] to the commanded one."""
    error = jnp.where(is_moving(command), angle_between(heading, unit(command.velocity)), 0.0)
    return wrap_angle(tracking.heading_error + config.heading_rate * wrap_angle(error - tracking.heading_error))


def _strafe_failure(
    tracking: TrackingState, heading_error: jax.Array, command: Command, config: TrackingConfig
) -> jax.Array:
    """Returns the seconds [] by which failing to strafe outweighs succeeding; 0 unless the command is to strafe."""
    sideways = jnp.abs(angle_between(unit(command.velocity), command.direction)) > config.heading_tolerance
    failing = jnp.abs(heading_error) > config.heading_tolerance
    # Once released, do not re-engage the facing constraint: the time of failure stops falling.
    recovery = jnp.where(tracking.strafe_failure < config.strafe_timeout, -1.0, 0.0)
    failure = jnp.maximum(tracking.strafe_failure + jnp.where(failing, 1.0, recovery) / config.fps, 0.0)
    return jnp.where(is_moving(command) & sideways, failure, 0.0)


def heading_correction(tracking: TrackingState, command: Command, config: TrackingConfig) -> jax.Array:
    """Returns the angle [] radians by which the character is rotated in one network frame; 0 for a stop command."""
    bound = config.max_correction_rate
    rate = jnp.clip(config.correction_gain * tracking.heading_error, -bound, bound)
    # The rate is per second of real time, in which the network makes `time_scale` times as many frames.
    time_scale = jnp.maximum(tracking.time_scale, config.min_time_scale)
    return jnp.where(is_moving(command), rate / (config.fps * time_scale), 0.0)


def update_time_scale(tracking: TrackingState, command: Command, config: TrackingConfig) -> TrackingState:
    """Returns the tracking state with the time scale of the next displayed frame."""
    moving, time_scale = is_moving(command), tracking.time_scale
    waiting = tracking.waiting & ~moving
    reachable = length(command.velocity) / jnp.maximum(length(tracking.velocity), MIN_WALK_SPEED)
    walking = jnp.clip(reachable, config.min_time_scale, config.max_time_scale)
    target = jnp.where(moving, walking, jnp.maximum(time_scale, config.stopping_time_scale))
    time_scale = jnp.where(waiting, 0.0, lerp(time_scale, target, config.time_scale_rate))
    return replace(tracking, time_scale=time_scale, waiting=waiting)
