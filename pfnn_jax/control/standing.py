"""Standing: a character that is to stop brings both feet to the floor, turns on the spot, and walks off again.

Networks are trained on walking, so that standing is not theirs to predict. Between the command to stop and the next
walk the drawn body leaves the network's motion for the stance of its style (`Stance`):

- Stopping. The hips come to rest a distance of their velocity over `rest_rate` ahead, without overshoot: the
  instantaneous capture point, where a walking body can stop. If a foot that is on the floor stands near enough to its
  place in a stance there, it stays, and the other steps next to it; else the foot in the air lands there first, and the
  other follows. Feet in the air leave with the velocity that they have.
- Standing. The rest of the body blends into the stance, breathes, and shifts its weight a little.
- Turning. From `turn_delay` on, the body turns to the commanded direction, and a foot that is too far from its place
  in the stance steps there, one at a time.
- Walking off. The network waits with its feet passing each other, the moment of a walk that is nearest to standing. The
  body blends into its motion, and what its feet and hips are apart at the first frame decays.

Everything is a pure function of one frame of one character. While `weight` is 0, nothing of the walk is changed.

Source of the capture point: Pratt et al. 2006, "Capture point: a step toward humanoid push recovery".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.vectors import length, lerp, smoothstep, to_3d, unit
from pfnn_jax.errors import check_positive
from pfnn_jax.motion.ground import angle_between, to_world, turn
from pfnn_jax.motion.kinematics import quat_normalise

GROUND = np.array([0, 2])
"""Axes of the ground in a position."""

CONTACT = 0.5
"""Predicted contact from which a foot stands on the floor."""

LANDING = 2.5
"""Multiple of distance over speed in which a foot in the air lands: `_swing` overshoots from 3 on."""

LEAST_LANDING = 0.75
"""Of the least duration of a step, for a foot that is in the air already and lands near."""

FLIGHT_SECONDS = 0.12
"""For which a foot in the air flies on at least with the velocity that it has: nearer, it would have to turn back."""

SLOWEST = 1e-3
"""Metres per second; below, a speed counts as this one, so that no duration is infinite."""

INSIDE_FIRST = 0.1
"""Added to the need of the foot on the inside of a turn, and taken from the other's, so that only one steps."""

SECOND_WAVE, SECOND_SHARE = 3.0, 0.2
"""Frequency of the second wave of the weight shift relative to the first, and its share: a single sine looks like a
pendulum. A whole multiple, so that standing repeats."""


@dataclass(frozen=True)
class StandingConfig:
    """Constants of standing. Lengths are shares of the leg length, so that one setting fits all skeletons.

    Attributes:
        stop_seconds, start_seconds: over which the body blends into the stance, and back into the walk.
        rest_rate: 1/s, at which the hips approach their place: they stop their velocity divided by it ahead.
        keep_distance: between where the hips would stop and the stance of a foot on the floor, within which it stays.
        down_height: above the floor, below which a foot in contact stands on it.
        settle_seconds: over which a foot that stays becomes flat.
        step_seconds: least and greatest duration of a step.
        step_speed: of a stepping foot on average, as a multiple of the style's natural speed.
        step_height: of a step, as a share of its length, and its least and greatest value.
        step_distance, step_angle: a foot further from its place, or turned further (radians), steps there.
        turning_angle: radians added to `step_angle` while the body turns at `max_turn_rate`.
        turn_delay: seconds after the command to stop from which a character turns on the spot.
        straighten: radians, an angle to the commanded direction below which it turns at once, while it stops: some
            styles walk askew.
        turn_gain, max_turn_rate, max_turn_acceleration: radians per second per radian, and their bounds.
        sway_seconds, sway: periods of the weight shift and of breathing, and their amplitudes: of the hips to the
            side, and of the chest in radians. All repeats after the longer of the two, so that standing is a loop.
        fps: frames per second.
    """

    stop_seconds: float = 0.5
    start_seconds: float = 0.4
    rest_rate: float = 4.5
    keep_distance: float = 0.2
    down_height: float = 0.04
    settle_seconds: float = 0.25
    step_seconds: tuple[float, float] = (0.28, 0.42)
    step_speed: float = 1.4
    step_height: tuple[float, float, float] = (0.15, 0.03, 0.08)
    step_distance: float = 0.07
    step_angle: float = 0.12
    turning_angle: float = 0.25
    turn_delay: float = 1.0
    straighten: float = 0.4
    turn_gain: float = 4.0
    max_turn_rate: float = 2.5
    max_turn_acceleration: float = 12.0
    sway_seconds: tuple[float, float] = (8.0, 4.0)
    sway: tuple[float, float] = (0.012, 0.012)
    fps: float = 60.0

    def __post_init__(self) -> None:
        check_positive(self, "stop_seconds", "start_seconds", "rest_rate", "settle_seconds", "step_speed", "fps")
        check_positive(self, "max_turn_rate", "max_turn_acceleration")


@struct.dataclass(kw_only=True)
class Stance:
    """How a style stands, relative to a centre on the ground and a facing.

    Attributes:
        rotations: [J, 4] of the joints relative to their parents; joint 0 relative to the facing.
        height: [] metres of the hips.
        hips: [2] metres on the ground, of the hips.
        feet: [2, 2, 3] metres, heel and toe of the left and the right foot, flat on the floor.
        chest: [4] rotation of the chest (`Rig.chest`) relative to the facing.
    """

    rotations: jax.Array
    height: jax.Array
    hips: jax.Array
    feet: jax.Array
    chest: jax.Array


@struct.dataclass(kw_only=True)
class StandingState:
    """The state of standing of one character. All but `weight` and the offsets is that of the drawn body.

    Attributes:
        stopped: [] bool, whether the last command was to stop.
        weight: [] in [0, 1]: 0 walks as the network does, 1 stands.
        seconds: [] since the command to stop.
        facing: [2] unit vector.
        turn_rate: [] radians per second.
        centre: [2] metres, of the stance.
        hips, velocity: [2] metres on the ground, and metres per second.
        feet: [2, 2, 3] metres, heel and toe of both feet.
        lifted, launch, land: [2, 2, 3] where the feet began to move, their velocity then, and where they come down.
        elapsed, duration: [2] seconds since then, and until they come down.
        stepping: [2] bool, whether a foot is in the air.
        hips_offset, feet_offset: [2] and [2, 2, 3] metres from the network's to the drawn body when it walked off.
    """

    stopped: jax.Array
    weight: jax.Array
    seconds: jax.Array
    facing: jax.Array
    turn_rate: jax.Array
    centre: jax.Array
    hips: jax.Array
    velocity: jax.Array
    feet: jax.Array
    lifted: jax.Array
    launch: jax.Array
    land: jax.Array
    elapsed: jax.Array
    duration: jax.Array
    stepping: jax.Array
    hips_offset: jax.Array
    feet_offset: jax.Array


@struct.dataclass(kw_only=True)
class WalkingBody:
    """What standing needs of the body as the network walks.

    Attributes:
        hips, facing: [2] on the ground.
        feet: [2, 2, 3] metres, heel and toe of both feet.
        contacts: [2, 2] in [0, 1].
        speed: [] metres per second, natural speed of the style.
    """

    hips: jax.Array
    facing: jax.Array
    feet: jax.Array
    contacts: jax.Array
    speed: jax.Array


def mix_stances(stances: Stance, weights: jax.Array) -> Stance:
    """Returns the stance of a mixture by weights [C] of stances, leaves [C, ...]."""

    def aligned(rotations: jax.Array) -> jax.Array:
        """Returns the rotations [C, ..., 4] with the signs nearest to those of the greatest weight."""
        like = jnp.take(rotations, jnp.argmax(weights), axis=0)[None]
        same = jnp.sum(rotations * like, axis=-1, keepdims=True) >= 0.0
        return jnp.where(same, rotations, -rotations)

    stances = replace(stances, rotations=aligned(stances.rotations), chest=aligned(stances.chest))
    mixed = jax.tree.map(lambda leaf: jnp.tensordot(weights, leaf, 1), stances)
    rotations, chest = quat_normalise(mixed.rotations), quat_normalise(mixed.chest)
    return replace(mixed, rotations=rotations, chest=chest)


def init_standing(stance: Stance, centre: jax.Array, facing: jax.Array, stopped: bool = True) -> StandingState:
    """Returns the state of a character that has been standing with the centre of its stance at [2], facing [2]."""
    zero = jnp.zeros((), stance.height.dtype)
    feet = _places(stance, centre, facing)
    return StandingState(
        stopped=jnp.asarray(stopped),
        weight=zero + float(stopped),
        seconds=zero,
        facing=facing,
        turn_rate=zero,
        centre=centre,
        hips=centre + to_world(stance.hips, facing),
        velocity=0.0 * centre,
        feet=feet,
        lifted=feet,
        launch=0.0 * feet,
        land=feet,
        elapsed=jnp.ones(2, zero.dtype),
        duration=jnp.ones(2, zero.dtype),
        stepping=jnp.zeros(2, bool),
        hips_offset=0.0 * centre,
        feet_offset=0.0 * feet,
    )


def update_standing(
    before: StandingState,
    walk: WalkingBody,
    stance: Stance,
    moving: jax.Array,
    direction: jax.Array,
    leg_length: float,
    config: StandingConfig,
) -> StandingState:
    """Returns the state of standing one frame later.

    Args:
        before: one frame earlier.
        walk: the body as the network has it in this frame.
        stance: of the character's style.
        moving: [] bool, whether the command is to walk.
        direction: [2] commanded facing.
        leg_length: metres.
        config: constants.
    """
    dt = 1.0 / config.fps
    rate = jnp.where(moving, -dt / config.start_seconds, dt / config.stop_seconds)
    weight = jnp.clip(before.weight + rate, 0.0, 1.0)
    walked = _walk(before, walk, moving & before.stopped, weight, config)
    begun = _begin_stop(before, walked, walk, stance, leg_length, config)
    stood = jax.tree.map(partial(jnp.where, before.stopped), before, begun)
    stood = _stand(replace(stood, weight=weight), walk.speed, stance, direction, leg_length, config)
    return jax.tree.map(partial(jnp.where, moving), walked, stood)


def _walk(
    before: StandingState, walk: WalkingBody, leaves: jax.Array, weight: jax.Array, config: StandingConfig
) -> StandingState:
    """Returns the state of a character that walks: the network's, and what is left of the offsets."""
    hips_offset = jnp.where(leaves, before.hips - walk.hips, before.hips_offset)
    feet_offset = jnp.where(leaves, before.feet - walk.feet, before.feet_offset)
    share = smoothstep(weight)
    hips, feet = walk.hips + share * hips_offset, walk.feet + share * feet_offset
    return replace(
        before,
        stopped=jnp.zeros_like(before.stopped),
        weight=weight,
        seconds=0.0 * before.seconds,
        facing=walk.facing,
        turn_rate=angle_between(before.facing, walk.facing) * config.fps,
        hips=hips,
        velocity=(hips - before.hips) * config.fps,
        feet=feet,
        hips_offset=hips_offset,
        feet_offset=feet_offset,
    )


def _begin_stop(
    before: StandingState,
    walked: StandingState,
    walk: WalkingBody,
    stance: Stance,
    leg_length: float,
    config: StandingConfig,
) -> StandingState:
    """Returns the state of a character that walked until now: where it will stand, and what its feet do first."""
    floor, facing = stance.feet[..., 1], walked.facing
    above = walked.feet[..., 1] - floor
    down = (jnp.max(walk.contacts, axis=1) >= CONTACT) & (jnp.min(above, axis=1) < config.down_height * leg_length)
    flat = _flat(walked.feet, above, stance)
    launch = (walked.feet - before.feet) * config.fps
    centre = _rest_place(walked, flat, down, launch, stance, leg_length, config)
    land = jnp.where(down[:, None, None], flat, _places(stance, centre, facing))
    distance, speed = (length(_middle(values)) for values in (land - walked.feet, launch))
    shortest, longest = config.step_seconds
    airborne = jnp.clip(LANDING * distance / jnp.maximum(speed, SLOWEST), LEAST_LANDING * shortest, longest)
    # From where the body was: `_stand` makes the step of this frame.
    return replace(
        walked,
        stopped=jnp.ones_like(walked.stopped),
        facing=before.facing,
        hips=before.hips,
        feet=before.feet,
        centre=centre,
        lifted=before.feet,
        launch=launch,
        land=land,
        elapsed=jnp.zeros_like(walked.elapsed),
        duration=jnp.where(down, config.settle_seconds, airborne),
        stepping=~down,
    )


def _flat(feet: jax.Array, above: jax.Array, stance: Stance) -> jax.Array:
    """Returns feet [2, 2, 3] put flat on the floor around the lower of heel and toe, whose heights are above [2, 2]."""
    size = length(_ground(stance.feet[:, 1] - stance.feet[:, 0]))[:, None]
    along = size * unit(_ground(feet[:, 1] - feet[:, 0]))
    on_toe = (above[:, 1] < above[:, 0])[:, None]
    heel = jnp.where(on_toe, _ground(feet[:, 1]) - along, _ground(feet[:, 0]))
    ground = jnp.stack([heel, heel + along], axis=1)
    return jnp.stack([ground[..., 0], stance.feet[..., 1], ground[..., 1]], axis=-1)


def _rest_place(
    walked: StandingState,
    flat: jax.Array,
    down: jax.Array,
    launch: jax.Array,
    stance: Stance,
    leg_length: float,
    config: StandingConfig,
) -> jax.Array:
    """Returns the centre [2] of the stance in which a walking character comes to rest."""
    facing, ahead = walked.facing, walked.velocity / config.rest_rate
    capture = walked.hips + ahead - to_world(stance.hips, facing)
    places = to_world(_middle(stance.feet), facing) + capture[None]
    apart = _middle(flat) - places  # [2, 2] from there to the stance of each foot where it is
    distance = jnp.where(down, length(apart), jnp.inf)
    kept = jnp.take(apart, jnp.argmin(distance), axis=0)
    # A foot in the air lands no less far ahead than it flies.
    flying = jnp.einsum("fi,i->f", _middle(walked.feet + FLIGHT_SECONDS * launch) - places, unit(ahead))
    reach = jnp.clip(jnp.max(jnp.where(down, 0.0, flying)), 0.0, length(ahead)) * unit(ahead)
    return capture + jnp.where(jnp.min(distance) < config.keep_distance * leg_length, kept, reach)


def _stand(
    state: StandingState,
    speed: jax.Array,
    stance: Stance,
    direction: jax.Array,
    leg_length: float,
    config: StandingConfig,
) -> StandingState:
    """Returns the state of a standing character one frame later: it turns, its hips settle and its feet step."""
    dt = 1.0 / config.fps
    seconds, most = state.seconds + dt, config.max_turn_acceleration * dt
    angle, fastest = angle_between(state.facing, direction), config.max_turn_rate
    turns = (seconds > config.turn_delay) | (jnp.abs(angle) < config.straighten)
    wanted = jnp.where(turns, jnp.clip(config.turn_gain * angle, -fastest, fastest), 0.0)
    turn_rate = state.turn_rate + jnp.clip(wanted - state.turn_rate, -most, most)
    facing = turn(state.facing, turn_rate * dt)
    goal = state.centre + to_world(stance.hips, facing)
    push, fade = state.velocity + config.rest_rate * (state.hips - goal), math.exp(-config.rest_rate * dt)
    hips = goal + (state.hips - goal + push * dt) * fade
    velocity = (state.velocity - push * (config.rest_rate * dt)) * fade
    moved = replace(state, seconds=seconds, facing=facing, turn_rate=turn_rate, hips=hips, velocity=velocity)
    return _step_feet(moved, speed, stance, leg_length, config)


def _step_feet(
    state: StandingState, speed: jax.Array, stance: Stance, leg_length: float, config: StandingConfig
) -> StandingState:
    """Returns the state after a frame of its feet: one that is too far from its place steps there."""
    shortest, longest = config.step_seconds
    # A foot that steps while the body turns comes down where its place will be in the middle of its time there.
    places = _places(stance, state.centre, turn(state.facing, state.turn_rate * longest))
    away = places - state.land
    distance = length(_middle(away))
    across = [_ground(points[:, 1] - points[:, 0]) for points in (state.land, places)]
    off = jnp.abs(jax.vmap(angle_between)(*across))
    turning = jnp.abs(state.turn_rate) / config.max_turn_rate
    need = distance / (config.step_distance * leg_length) + off / (config.step_angle + turning * config.turning_angle)
    # Of two feet that need it alike, the one on the inside of the turn steps first.
    need = jnp.where(need > 1.0, need + INSIDE_FIRST * jnp.sign(state.turn_rate) * np.array([1.0, -1.0]), 0.0)
    lifts = (need > 0.0) & (need >= need[::-1]) & ~state.stepping.any()
    lifts = lifts & ~(lifts[::-1] & np.array([False, True]))
    begins = lifts[:, None, None]
    fast = jnp.maximum(config.step_speed * speed, SLOWEST)
    elapsed = jnp.where(lifts, 0.0, state.elapsed) + 1.0 / config.fps
    duration = jnp.where(lifts, jnp.clip(distance / fast, shortest, longest), state.duration)
    lifted, launch = jnp.where(begins, state.feet, state.lifted), jnp.where(begins, 0.0, state.launch)
    stepping = state.stepping | lifts
    land = jnp.where(stepping[:, None, None], places, state.land)
    share = jnp.clip(elapsed / duration, 0.0, 1.0)
    feet = _swing(lifted, launch * duration[:, None, None], land, share[:, None, None])
    arc = 16.0 * share**2 * (1.0 - share) ** 2  # 1 in the middle; begins and ends without velocity
    height = _step_height(lifted, land, stance, leg_length, config) * stepping * arc
    feet = feet.at[..., 1].set(jnp.maximum(feet[..., 1] + height[:, None], stance.feet[..., 1]))
    return replace(
        state,
        feet=feet,
        lifted=lifted,
        launch=launch,
        land=land,
        elapsed=elapsed,
        duration=duration,
        stepping=stepping & (share < 1.0),
    )


def _swing(start: jax.Array, velocity: jax.Array, end: jax.Array, share: jax.Array) -> jax.Array:
    """Returns the cubic from a start with a velocity (per whole share) to an end at rest, at a share in [0, 1]."""
    back = 1.0 - share
    return lerp(start, end, smoothstep(share)) + velocity * (share * back * back)


def _step_height(
    lifted: jax.Array, land: jax.Array, stance: Stance, leg_length: float, config: StandingConfig
) -> jax.Array:
    """Returns the heights [2] in metres of steps; 0 for a foot that was in the air already."""
    share, least, most = config.step_height
    height = jnp.clip(share * length(_middle(land - lifted)), least * leg_length, most * leg_length)
    rise = jnp.min(lifted[..., 1] - stance.feet[..., 1], axis=1)
    return height * jnp.clip(1.0 - rise / (least * leg_length), 0.0, 1.0)


def sway(state: StandingState, leg_length: float, config: StandingConfig) -> tuple[jax.Array, jax.Array]:
    """Returns the weight shift of the hips [] in metres to the left, and the pitch [] of the chest in radians."""
    (shift_seconds, breath_seconds), (shift, breath) = config.sway_seconds, config.sway
    time = jnp.maximum(state.seconds - config.turn_delay, 0.0)
    share = smoothstep(state.weight) * smoothstep(jnp.clip(time, 0.0, 1.0))
    angle = 2.0 * math.pi * time
    first, second = (jnp.sin(wave * angle / shift_seconds) for wave in (1.0, SECOND_WAVE))
    shifted = (1.0 - SECOND_SHARE) * first + SECOND_SHARE * second
    return share * shift * leg_length * shifted, share * breath * jnp.sin(angle / breath_seconds)


def _places(stance: Stance, centre: jax.Array, facing: jax.Array) -> jax.Array:
    """Returns the feet [2, 2, 3] of a stance in the world."""
    return to_world(stance.feet, facing) + to_3d(centre)[None, None]


def _ground(points: jax.Array) -> jax.Array:
    """Returns points [..., 3] on the ground [..., 2]."""
    return points[..., GROUND]


def _middle(feet: jax.Array) -> jax.Array:
    """Returns the middles [2, 2] on the ground of feet [2, 2, 3]."""
    return _ground(jnp.mean(feet, axis=1))
