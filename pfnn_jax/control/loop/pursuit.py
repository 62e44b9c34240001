"""Path following: the progress of a character along a path, and the command that keeps it there (pure pursuit)."""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.loop.state import ROOT, CharacterState
from pfnn_jax.control.loop.step import Command, LoopConfig
from pfnn_jax.control.vectors import lerp
from pfnn_jax.motion.ground import angle_between, turn_towards
from pfnn_jax.motion.paths import Path, resample_path

SEARCH = np.arange(0.0, 1.0, 0.05, dtype=np.float32)
"""Metres ahead of the progress at which the nearest point on the path is searched."""

ARRIVAL = 0.1
"""Metres before the end of an open path at which the command is to stop."""

LEAST_POINTS = 512
"""Points that every path has at least, and powers of two beyond: paths of other lengths are not compiled again. They
are 25 metres at the usual spacing."""

FULL_STEERING = 0.6
"""Radians between a character's facing and the direction to its target at which it is turned in full."""


@struct.dataclass(kw_only=True)
class TimedPath:
    """A path to follow at a speed, as arrays.

    Attributes:
        points: [N, 2] metres at equal distances along the path; a closed one repeats its first point at the end.
            After the last point follow copies of it.
        last: [] number of the last point.
        length: [] metres.
        closed: [] bool.
        speed: [] metres per second to request.
    """

    points: jax.Array
    last: jax.Array
    length: jax.Array
    closed: jax.Array
    speed: jax.Array


def make_timed_path(path: Path, speed: float, num_points: int | None = None) -> TimedPath:
    """Returns a path with a speed in metres per second.

    Args:
        path: in metres.
        speed: to request.
        num_points: to resample it to. A batch of paths for `vmap` needs arrays of one size: one `num_points` for all,
            or at most `LEAST_POINTS` points in each.
    """
    if num_points is not None:
        path = resample_path(path.points, path.closed, num_points)
    points = np.concatenate([path.points, path.points[:1]]) if path.closed else path.points
    count = len(points)
    size = max(LEAST_POINTS, 2 ** math.ceil(math.log2(count)))
    return TimedPath(
        points=jnp.asarray(points[np.minimum(np.arange(size), count - 1)], jnp.float32),
        last=jnp.asarray(np.int32(count - 1)),
        length=jnp.asarray(np.float32(path.length)),
        closed=jnp.asarray(path.closed),
        speed=jnp.asarray(np.float32(speed)),
    )


def point_at(path: TimedPath, distance: jax.Array) -> jax.Array:
    """Returns the points [..., 2] at distances [...] metres along a path: open paths end, closed ones repeat."""
    last = path.last
    along = jnp.where(path.closed, jnp.mod(distance, path.length), jnp.clip(distance, 0.0, path.length))
    place = along * (last / path.length)
    first = jnp.clip(place.astype(jnp.int32), 0, last - 1)
    return lerp(path.points[first], path.points[first + 1], (place - first)[..., None])


def advance_progress(path: TimedPath, root: jax.Array, progress: jax.Array) -> jax.Array:
    """Returns the progress [] metres of the point just ahead that is nearest to the root; it never decreases."""
    stations = progress + SEARCH
    candidates = point_at(path, stations)
    nearest = stations[jnp.argmin(jnp.sum((candidates - root[None]) ** 2, axis=-1))]
    # Between two stations the path is almost straight, so projecting the root on the chord is accurate enough.
    half = 0.5 * float(SEARCH[1])
    before, after = point_at(path, nearest - half), point_at(path, nearest + half)
    chord = after - before
    share = jnp.dot(root - before, chord) / jnp.maximum(jnp.dot(chord, chord), 1e-12)
    refined = nearest + half * (2.0 * jnp.clip(share, 0.0, 1.0) - 1.0)
    furthest = jnp.where(path.closed, jnp.inf, path.length)
    return jnp.minimum(jnp.maximum(refined, progress), furthest)


def pursue(path: TimedPath, state: CharacterState, progress: jax.Array, config: LoopConfig) -> Command:
    """Returns the command that leads from a character's root to the path's point `config.look_ahead` seconds ahead.

    With `config.steering` below 1 a small heading error is corrected gently, and one of `FULL_STEERING` in full. The
    requested velocity then follows the smoothed target direction, as in the published demo: kept to a line more
    strictly, styles that sway lose their gait.
    """
    toward = point_at(path, progress + path.speed * config.look_ahead) - state.positions[ROOT]
    squared = jnp.dot(toward, toward)
    going = squared > 1e-8
    direction = jnp.where(going, toward * jax.lax.rsqrt(jnp.where(going, squared, 1.0)), state.target_direction)
    course = direction
    if config.steering < 1.0:
        facing = state.directions[ROOT]
        off = jnp.abs(angle_between(facing, direction))
        direction = turn_towards(facing, direction, jnp.clip(off / FULL_STEERING, config.steering, 1.0))
        course = turn_towards(state.target_direction, direction, config.direction_rate)
    arrived = ~path.closed & (progress > path.length - ARRIVAL)
    direction = jnp.where(arrived, state.target_direction, direction)
    return Command(velocity=jnp.where(arrived, 0.0, path.speed) * course, direction=direction)
