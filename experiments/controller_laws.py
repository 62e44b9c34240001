"""Does a character go where it is sent, as fast as it is sent, in every style, and at what price to its feet?

Parent    Mason 2018 §5.1 and Mason 2022 §4.4 describe a trajectory blended with the user's command; neither measures
          whether the character obeys. The loop of their demos is the one that is compared with (`--published`).
Question  what share of commands is reached, with the published loop and with command tracking (`control.tracking`)?
Data      the runs given. Every style walks off from its start, is told to go on, to turn by 45 or 90 degrees to either
          side or to walk a circle of 45 degrees per second, at 0.75, 1 and 1.25 times its own speed, and to stop. And,
          at its own speed, to go to either side or back while it faces ahead.
Measure   over the two seconds around the third after the command: speed within 20 %, the way made good and the mean
          facing within 10 degrees; on circles the speed along the way, and the turn rate within 20 %. Aside and back:
          speed and way over the two seconds around the fifth, as networks that were not shown that turn about first.
          Two seconds after it is told to stop, the root moves less than 2 cm/s and the feet less than 1 cm/s; told as
          well are the seconds until the pace is 0, and how high the higher of its feet is then above the least that it
          was at while walking. Sliding is the speed of feet in contact, before and after feet are held. Pose distance
          is the mean squared normalised distance of joint positions from the run's mean pose, about 1 on its data.
Expect    on the demo's run all commands in all 9 styles (70 % with the published loop), on Bandai-Namco-2 all with an
          LPN (14 %) and with a PFNN (13 %), on 25 of the authors' 100 styles 96 % (39 %); aside and back 92 to 100 %
          (0 to 43 %); see docs/results.md. Twenty minutes on 2 cores.
Run       python -m experiments.controller_laws --runs RUN [RUN ...] --out laws.json
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from flax import struct

from pfnn_jax.control.calibration import start_standing
from pfnn_jax.control.controller import Controller, make_controller, step
from pfnn_jax.control.controller_state import ControllerParams, ControllerSetup
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.tracking import TrackingConfig
from pfnn_jax.control.vectors import to_3d
from pfnn_jax.io.files import write_whole
from pfnn_jax.motion.ground import to_local
from pfnn_jax.run import list_styles, load_run

FPS = 60
WALK_OFF, OBEY, STOP = 3 * FPS, 6 * FPS, 3 * FPS
"""Frames: straight on from standing, then under the command that is judged, then told to stand."""

JUDGED, JUDGED_ASIDE = (slice(WALK_OFF + second * FPS, WALK_OFF + (second + 2) * FPS) for second in (2, 4))
"""Two seconds around the third, and the fifth, after a command: no gait's cycle is longer, so swaying is no error."""

SPEEDS, TURNS, CIRCLES, ASIDE = (0.75, 1.0, 1.25), (0.0, 45.0, -45.0, 90.0, -90.0), (45.0, -45.0), (90.0, -90.0, 180.0)
"""Shares of the style's own speed, degrees, degrees per second, and degrees from the facing to the way."""

HEADING, SPEED, RATE = 10.0, 0.2, 0.2
"""Degrees, share of the commanded speed, and share of the turn rate, within which a command counts as reached."""

DRIFT, POSE_DRIFT = 0.02, 0.01
"""Metres per second below which root and feet stand."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        runs: run directories.
        out: JSON file of results, or None to print them only.
        styles: how many of a run's styles, evenly chosen; 0 for all.
        minutes: of random commands for every style, beside the others.
        published: use the published loop instead of command tracking.
        chunk: characters at once.
    """

    runs: tuple[Path, ...]
    out: Path | None = None
    styles: int = 0
    minutes: float = 10.0
    published: bool = False
    chunk: int = 256


@struct.dataclass(kw_only=True)
class Track:
    """What is kept of every frame: leaves [N, T, ...]."""

    root: Any  # [2]
    facing: Any  # [2]
    predicted: Any  # [4, 3] feet as the network has them
    feet: Any  # [4, 3] feet as they are drawn
    contacts: Any  # [4]
    pace: Any
    distance: Any


def commands(speed: jax.Array, turn: jax.Array, circle: jax.Array, aside: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Velocities [T, 2] and directions [T, 2] of one character: m/s, radians, radians per second, radians."""
    frame = jnp.arange(WALK_OFF + OBEY + STOP)
    since = jnp.clip(frame - WALK_OFF, 0, OBEY)
    yaw = jnp.where(frame >= WALK_OFF, turn, 0.0) + circle * since / FPS
    way = yaw + jnp.where(frame >= WALK_OFF, aside, 0.0)
    direction, going = (jnp.stack([jnp.sin(angle), jnp.cos(angle)], -1) for angle in (yaw, way))
    return going * jnp.where(frame < WALK_OFF + OBEY, speed, 0.0)[:, None], direction


@partial(jax.jit, static_argnums=0)
def walk(setup: ControllerSetup, params: ControllerParams, style: jax.Array, *asked: jax.Array) -> Track:
    """One character in a style [C] under the commands of `commands`."""
    layout, feet, statistics = setup.layout, np.array(setup.rig.feet), params.predictor
    pose = layout.output_slice("joint_position")
    mean, std = statistics.output_mean[pose], statistics.output_std[pose]

    def frame(state, row):
        state = step(setup, params, state, Command(velocity=row[0], direction=row[1], style=style))
        local = to_local(state.next.joints - to_3d(state.next.root)[None], state.next.facing) / layout.length_unit
        return state, Track(
            root=state.root,
            facing=state.facing,
            predicted=state.motion.joint_positions[feet],
            feet=state.joints[feet],
            contacts=state.contacts,
            pace=state.time_scale,
            distance=jnp.mean(((local.reshape(-1) - mean) / std) ** 2),
        )

    begin = start_standing(setup, params, jnp.zeros(2), jnp.zeros(()), style)
    return jax.lax.scan(frame, begin, commands(*asked))[1]


def walk_all(controller: Controller, chunk: int) -> dict[str, Any]:
    """The shares and means of all styles and commands, and those of every style."""
    numbers = range(len(controller.styles))
    cases = [(s, v, t, 0.0, 0.0) for s in numbers for v in SPEEDS for t in TURNS]
    cases += [(s, v, 0.0, c, 0.0) for s in numbers for v in SPEEDS for c in CIRCLES]
    cases += [(s, 1.0, 0.0, 0.0, a) for s in numbers for a in ASIDE]
    index, share, turn, circle, aside = (np.array(column) for column in zip(*cases, strict=True))
    speed = np.asarray(controller.params.speeds)[index] * share
    weights = np.eye(controller.capacity, dtype=np.float32)[index]
    many = jax.vmap(partial(walk, controller.setup), in_axes=(None, 0, 0, 0, 0, 0))
    columns = [np.asarray(c, np.float32) for c in (weights, speed, *np.deg2rad([turn, circle, aside]))]
    chunk, parts = min(chunk, len(cases)), []
    for first in range(0, len(cases), chunk):
        rows = np.minimum(np.arange(first, first + chunk), len(cases) - 1)
        parts.append(jax.tree.map(np.asarray, many(controller.params, *(c[rows] for c in columns))))
    track = jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(cases)], *parts)
    judged = judge(track, speed, turn, circle, aside)
    styles = {
        name: {key: _mean(values[index == s]) for key, values in judged.items()}
        for s, name in enumerate(controller.styles)
    }
    return {"all": {key: _mean(values) for key, values in judged.items()}, "styles": styles}


def judge(
    track: Track, speed: np.ndarray, turn: np.ndarray, circle: np.ndarray, aside: np.ndarray
) -> dict[str, np.ndarray]:
    """Measures [N] of N walks; NaN where one does not apply."""
    straight, ahead = circle == 0.0, aside == 0.0
    plain = straight & ahead
    made, way = _made_good(track.root, JUDGED)
    seconds = (JUDGED.stop - JUDGED.start) / FPS
    along = np.linalg.norm(np.diff(track.root[:, JUDGED.start : JUDGED.stop + 1], axis=1), axis=-1).sum(1) / seconds
    made = np.where(straight, made, along)
    made_aside, way_aside = _made_good(track.root, JUDGED_ASIDE)
    yaw = np.unwrap(np.arctan2(track.facing[..., 0], track.facing[..., 1]), axis=1)
    rate = np.rad2deg(yaw[:, JUDGED.stop] - yaw[:, JUDGED.start]) / seconds
    off, faced = (np.abs(_short(value - turn)) for value in (way, np.rad2deg(yaw[:, JUDGED].mean(1))))
    obeys_speed, obeys_way = np.abs(made / speed - 1.0) <= SPEED, off <= HEADING
    obeys_aside = (np.abs(made_aside / speed - 1.0) <= SPEED) & (np.abs(_short(way_aside - aside)) <= HEADING)
    told = WALK_OFF + OBEY
    drift, pose_drift = (
        np.linalg.norm(np.diff(values[:, told + 2 * FPS :], axis=1), axis=-1).reshape(len(speed), -1).max(1) * FPS
        for values in (track.root, track.feet)
    )
    raised = track.predicted[..., 1].reshape(*track.pace.shape, 2, 2).min(-1).max(-1)
    moving = slice(FPS, told)
    return {
        "speed": np.where(plain, obeys_speed, np.nan),
        "way": np.where(plain, obeys_way, np.nan),
        "speed and way": np.where(plain, obeys_speed & obeys_way, np.nan),
        "facing": np.where(plain, faced <= HEADING, np.nan),
        "speed on circles": np.where(straight, np.nan, obeys_speed),
        "rate on circles": np.where(straight, np.nan, np.abs(rate / np.where(straight, 1.0, circle) - 1.0) <= RATE),
        "aside and back": np.where(ahead, np.nan, obeys_aside),
        "stops": ((drift < DRIFT) & (pose_drift < POSE_DRIFT)).astype(float),
        "seconds to a halt": (track.pace[:, told:] > 0.0).sum(1) / FPS,
        "feet at a halt, m": raised[:, -1] - raised[:, moving].min(1),
        "finite": np.isfinite(track.feet).all((1, 2, 3)).astype(float),
        "degrees off": np.where(plain, off, np.nan),
        "share of speed": np.where(ahead, made / speed, np.nan),
        "pace": track.pace[:, JUDGED].mean(1),
        "sliding, predicted": _sliding(track.predicted[:, moving], track.contacts[:, moving]),
        "sliding, drawn": _sliding(track.feet[:, moving], track.contacts[:, moving]),
        "pose distance": track.distance[:, moving].mean(1),
    }


def _made_good(root: np.ndarray, frames: slice) -> tuple[np.ndarray, np.ndarray]:
    """Metres per second [N] and degrees [N] of the straight lines between the ends of tracks [N, T, 2]."""
    line = root[:, frames.stop] - root[:, frames.start]
    return np.linalg.norm(line, axis=-1) * FPS / (frames.stop - frames.start), np.rad2deg(np.arctan2(*line.T))


def _sliding(feet: np.ndarray, contacts: np.ndarray) -> np.ndarray:
    """[N] m/s, mean horizontal speed of feet [N, T, 4, 3] between frames both in contact."""
    both = (contacts[:, 1:] >= 0.5) & (contacts[:, :-1] >= 0.5)
    speed = np.linalg.norm(np.diff(feet, axis=1)[..., [0, 2]], axis=-1) * FPS
    return (speed * both).sum((1, 2)) / np.maximum(both.sum((1, 2)), 1)


def _short(degrees: np.ndarray) -> np.ndarray:
    return (degrees + 180.0) % 360.0 - 180.0


def _mean(values: np.ndarray) -> float:
    return round(float(np.nanmean(values)), 4)


WORST = ("pose distance", "speed of a joint, m/s", "height of a joint, m", "not finite")
"""What must stay bounded under random commands."""


def random_commands(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Velocities [T, 2], 1 being a style's own speed, and directions [T, 2]: another every one to three seconds, one in
    six of them to stand."""
    rng, frames = np.random.default_rng(seed), round(seconds * FPS)
    lengths = rng.integers(FPS, 3 * FPS, frames // FPS + 1)
    yaw, speed = rng.uniform(-np.pi, np.pi, len(lengths)), rng.uniform(0.3, 1.5, len(lengths))
    speed = np.where(rng.random(len(lengths)) < 1 / 6, 0.0, speed)
    yaw, speed = (np.repeat(values, lengths)[:frames].astype(np.float32) for values in (yaw, speed))
    direction = np.stack([np.sin(yaw), np.cos(yaw)], -1)
    return speed[:, None] * direction, direction


@partial(jax.jit, static_argnums=0)
def wander(setup: ControllerSetup, params: ControllerParams, style: jax.Array, *asked: jax.Array) -> dict[str, Any]:
    """The worst of a character in a style [C] under commands [T, 2]: what must stay bounded."""
    statistics, pose = params.predictor, setup.layout.output_slice("joint_position")
    mean, std = statistics.output_mean[pose], statistics.output_std[pose]

    def frame(carry, row):
        before, worst = carry
        state = step(setup, params, before, Command(velocity=row[0], direction=row[1], style=style))
        local = to_local(state.next.joints - to_3d(state.next.root)[None], state.next.facing)
        now = {
            "pose distance": jnp.mean(((local.reshape(-1) / setup.layout.length_unit - mean) / std) ** 2),
            "speed of a joint, m/s": FPS * jnp.max(jnp.linalg.norm(state.joints - before.joints, axis=-1)),
            "height of a joint, m": jnp.max(jnp.abs(state.joints[:, 1])),
            "not finite": 1.0 - jnp.isfinite(state.joints).all().astype(jnp.float32),
        }
        return (state, jax.tree.map(jnp.maximum, worst, now)), None

    begin = start_standing(setup, params, jnp.zeros(2), jnp.zeros(()), style)
    zero: dict[str, Any] = {name: jnp.zeros(()) for name in WORST}
    return jax.lax.scan(frame, (begin, zero), asked)[0][1]


def wander_all(controller: Controller, minutes: float) -> dict[str, Any]:
    """The worst of every style under random commands, and over all styles."""
    count, (velocity, direction) = len(controller.styles), random_commands(60.0 * minutes, 0)
    weights = jnp.eye(count, controller.capacity)
    velocities = velocity[None] * np.asarray(controller.params.speeds)[:count, None, None]
    many = jax.vmap(partial(wander, controller.setup), in_axes=(None, 0, 0, None))
    worst = jax.tree.map(np.asarray, many(controller.params, weights, velocities, jnp.asarray(direction)))
    return {name: round(float(values.max()), 3) for name, values in worst.items()}


def chosen(names: Sequence[str], count: int) -> list[str]:
    """Some of the names, evenly; all where the count is 0."""
    places = np.linspace(0, len(names) - 1, min(count or len(names), len(names)))
    return [str(names[round(float(place))]) for place in places]


def main(config: Config) -> dict[str, Any]:
    """Walks every run and prints what it finds."""
    result = {}
    for path in config.runs:
        run = load_run(path)
        names = chosen(list_styles(run.path), config.styles)
        controller = make_controller(run, names, tracking=None if config.published else TrackingConfig())
        found = walk_all(controller, config.chunk)
        found["random"] = wander_all(controller, config.minutes)
        result[str(path)] = found
        print(path, json.dumps(found["all"]), json.dumps(found["random"]))
    if config.out is not None:
        write_whole(config.out, json.dumps(result, indent=1))
    return result


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
