"""Does a character reach the commanded speed and heading in every style, and how does this affect its feet?

Parent    Mason 2018 §5.1 and Mason 2022 §4.4 blend the trajectory with the user's command; neither measures whether
          the character reaches it. The baseline is the loop of their demos (`--published`).
Question  what share of commands is reached, with the published loop and with command tracking (`control.tracking`)?
Data      the given runs. Every style starts to walk and is then commanded to walk straight on, to turn by 45 or 90
          degrees to either side, or to walk a circle at 45 degrees per second, at 0.75, 1 and 1.25 times its natural
          speed, and finally to stop. At its natural speed it is also commanded to strafe to either side and to walk
          backward.
Measure   over the two seconds around the third after the command: speed within 20 %, heading and mean facing within 10
          degrees; on circles the speed along the path, and the turn rate within 20 %. Strafing and backward: speed and
          heading over the two seconds around the fifth, because networks that were not trained on such motion turn
          around first. Two seconds after the command to stop, the root must move at less than 2 cm/s and the feet at
          less than 1 cm/s for a second; a character that could not strafe has to turn to the commanded facing first,
          and must be at rest half a second before the end. Also reported are the seconds in which the root moves at
          more than 2 cm/s, and the height of the higher foot at the end above its minimum while walking. Sliding is the
          speed of feet in contact, before and after foot IK. Pose distance is the mean squared normalised distance of
          joint positions from the run's mean pose, about 1 on its data.
Expect    on the demo's run all commands in all 9 styles (70 % with the published loop), on Bandai-Namco-2 all with an
          LPN (14 %) and with a PFNN (13 %), on 25 of the authors' 100 styles 96 % (39 %); strafing and backward 92 to
          100 % (0 to 43 %); see docs/results_appendix.md. Twenty minutes on 2 cores.
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
from pfnn_jax.run import load_run
from pfnn_jax.run_config import list_styles

FPS = 60
WALK_OFF, OBEY, STOP = 3 * FPS, 6 * FPS, 4 * FPS
"""Frames of walking straight from standing, then of the evaluated command, then of the command to stop."""

WINDOW, STRAFE_WINDOW = (slice(WALK_OFF + second * FPS, WALK_OFF + (second + 2) * FPS) for second in (2, 4))
"""Evaluated frames: two seconds around the third, or the fifth, second of a command. No gait cycle is longer, so that
swaying within a cycle averages out."""

SPEEDS, TURNS, CIRCLES = (0.75, 1.0, 1.25), (0.0, 45.0, -45.0, 90.0, -90.0), (45.0, -45.0)
"""Multiples of the style's natural speed, degrees, and degrees per second."""

STRAFES = (90.0, -90.0, 180.0)
"""Degrees from the facing to the heading."""

HEADING, SPEED, RATE = 10.0, 0.2, 0.2
"""Degrees, share of the commanded speed, and share of the turn rate, within which a command is reached."""

DRIFT, POSE_DRIFT = 0.02, 0.01
"""Speeds in m/s below which the root and the feet are at rest."""


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        runs: run directories.
        out: JSON file of results, or None to print them only.
        styles: number of a run's styles, evenly spaced; 0 for all.
        minutes: minutes of additional random commands for every style.
        published: use the published loop instead of command tracking.
        chunk: characters simulated at once.
    """

    runs: tuple[Path, ...]
    out: Path | None = None
    styles: int = 0
    minutes: float = 10.0
    published: bool = False
    chunk: int = 256


@struct.dataclass(kw_only=True)
class Recording:
    """The signals recorded in every frame: leaves [N, T, ...]."""

    root: Any  # [2]
    facing: Any  # [2]
    predicted: Any  # [4, 3] feet as predicted by the network
    feet: Any  # [4, 3] feet after foot IK
    contacts: Any  # [4]
    time_scale: Any
    distance: Any


def commands(speed: jax.Array, turn: jax.Array, circle: jax.Array, strafe: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Returns velocities [T, 2] and directions [T, 2] of one character.

    Args:
        speed: m/s.
        turn: radians, yaw of the turn at the start of the evaluated command.
        circle: radians per second.
        strafe: radians from the facing to the heading.
    """
    frame = jnp.arange(WALK_OFF + OBEY + STOP)
    since = jnp.clip(frame - WALK_OFF, 0, OBEY)
    yaw = jnp.where(frame >= WALK_OFF, turn, 0.0) + circle * since / FPS
    travel = yaw + jnp.where(frame >= WALK_OFF, strafe, 0.0)
    direction, heading = (jnp.stack([jnp.sin(angle), jnp.cos(angle)], -1) for angle in (yaw, travel))
    return heading * jnp.where(frame < WALK_OFF + OBEY, speed, 0.0)[:, None], direction


@partial(jax.jit, static_argnums=0)
def walk(setup: ControllerSetup, params: ControllerParams, style: jax.Array, *command: jax.Array) -> Recording:
    """Simulates one character in a style [C] under the commands that `commands` returns for `command`."""
    layout, feet, statistics = setup.layout, np.array(setup.rig.feet), params.predictor
    pose = layout.output_slice("joint_position")
    mean, std = statistics.output_mean[pose], statistics.output_std[pose]

    def frame(state, row):
        state = step(setup, params, state, Command(velocity=row[0], direction=row[1], style=style))
        local = to_local(state.next.joints - to_3d(state.next.root)[None], state.next.facing) / layout.length_unit
        return state, Recording(
            root=state.root,
            facing=state.facing,
            predicted=state.motion.joint_positions[feet],
            feet=state.joints[feet],
            contacts=state.contacts,
            time_scale=state.time_scale,
            distance=jnp.mean(((local.reshape(-1) - mean) / std) ** 2),
        )

    begin = start_standing(setup, params, jnp.zeros(2), jnp.zeros(()), style)
    return jax.lax.scan(frame, begin, commands(*command))[1]


def walk_all(controller: Controller, chunk: int) -> dict[str, Any]:
    """Simulates all styles under all commands; returns the measures over all of them and for every style."""
    numbers = range(len(controller.styles))
    cases = [(s, v, t, 0.0, 0.0) for s in numbers for v in SPEEDS for t in TURNS]
    cases += [(s, v, 0.0, c, 0.0) for s in numbers for v in SPEEDS for c in CIRCLES]
    cases += [(s, 1.0, 0.0, 0.0, a) for s in numbers for a in STRAFES]
    index, share, turn, circle, strafe = (np.array(column) for column in zip(*cases, strict=True))
    speed = np.asarray(controller.params.speeds)[index] * share
    weights = np.eye(controller.capacity, dtype=np.float32)[index]
    many = jax.vmap(partial(walk, controller.setup), in_axes=(None, 0, 0, 0, 0, 0))
    columns = [np.asarray(c, np.float32) for c in (weights, speed, *np.deg2rad([turn, circle, strafe]))]
    chunk, parts = min(chunk, len(cases)), []
    for first in range(0, len(cases), chunk):
        rows = np.minimum(np.arange(first, first + chunk), len(cases) - 1)
        parts.append(jax.tree.map(np.asarray, many(controller.params, *(c[rows] for c in columns))))
    recording = jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(cases)], *parts)
    found = measure(recording, speed, turn, circle, strafe)
    styles = {
        name: {key: _mean(values[index == s]) for key, values in found.items()}
        for s, name in enumerate(controller.styles)
    }
    return {"all": {key: _mean(values) for key, values in found.items()}, "styles": styles}


def measure(
    recording: Recording, speed: np.ndarray, turn: np.ndarray, circle: np.ndarray, strafe: np.ndarray
) -> dict[str, np.ndarray]:
    """Returns measures [N] of N walks; NaN where a measure does not apply."""
    straight, ahead = circle == 0.0, strafe == 0.0
    plain = straight & ahead
    achieved, heading = _net_motion(recording.root, WINDOW)
    seconds = (WINDOW.stop - WINDOW.start) / FPS
    along = np.linalg.norm(np.diff(recording.root[:, WINDOW.start : WINDOW.stop + 1], axis=1), axis=-1).sum(1) / seconds
    achieved = np.where(straight, achieved, along)
    strafe_speed, strafe_heading = _net_motion(recording.root, STRAFE_WINDOW)
    yaw = np.unwrap(np.arctan2(recording.facing[..., 0], recording.facing[..., 1]), axis=1)
    rate = np.rad2deg(yaw[:, WINDOW.stop] - yaw[:, WINDOW.start]) / seconds
    off, faced = (np.abs(_short(value - turn)) for value in (heading, np.rad2deg(yaw[:, WINDOW].mean(1))))
    obeys_speed, obeys_heading = np.abs(achieved / speed - 1.0) <= SPEED, off <= HEADING
    obeys_strafe = (np.abs(strafe_speed / speed - 1.0) <= SPEED) & (np.abs(_short(strafe_heading - strafe)) <= HEADING)
    stop = WALK_OFF + OBEY
    drift, pose_drift = (
        np.where(ahead, _fastest(values[:, stop + 2 * FPS : stop + 3 * FPS]), _fastest(values[:, -FPS // 2 :]))
        for values in (recording.root, recording.feet)
    )
    raised = recording.feet[..., 1].reshape(*recording.time_scale.shape, 2, 2).min(-1).max(-1)
    slowing = np.linalg.norm(np.diff(recording.root[:, stop:], axis=1), axis=-1) * FPS
    moving = slice(FPS, stop)
    return {
        "speed": np.where(plain, obeys_speed, np.nan),
        "heading": np.where(plain, obeys_heading, np.nan),
        "speed and heading": np.where(plain, obeys_speed & obeys_heading, np.nan),
        "facing": np.where(plain, faced <= HEADING, np.nan),
        "speed on circles": np.where(straight, np.nan, obeys_speed),
        "rate on circles": np.where(straight, np.nan, np.abs(rate / np.where(straight, 1.0, circle) - 1.0) <= RATE),
        "strafe and backward": np.where(ahead, np.nan, obeys_strafe),
        "stops": ((drift < DRIFT) & (pose_drift < POSE_DRIFT)).astype(float),
        "seconds to stop": np.where(ahead, (slowing > DRIFT).sum(1) / FPS, np.nan),
        "feet at stop, m": raised[:, -1] - raised[:, moving].min(1),
        "finite": np.isfinite(recording.feet).all((1, 2, 3)).astype(float),
        "heading error, degrees": np.where(plain, off, np.nan),
        "share of speed": np.where(ahead, achieved / speed, np.nan),
        "time scale": recording.time_scale[:, WINDOW].mean(1),
        "sliding, predicted": _sliding(recording.predicted[:, moving], recording.contacts[:, moving]),
        "sliding, after foot IK": _sliding(recording.feet[:, moving], recording.contacts[:, moving]),
        "pose distance": recording.distance[:, moving].mean(1),
    }


def _fastest(values: np.ndarray) -> np.ndarray:
    """Returns the largest speeds [N] in m/s of points [N, T, ...]."""
    return np.linalg.norm(np.diff(values, axis=1), axis=-1).reshape(len(values), -1).max(1) * FPS


def _net_motion(root: np.ndarray, frames: slice) -> tuple[np.ndarray, np.ndarray]:
    """Returns the speed [N] in m/s and yaw [N] in degrees of the straight line between the ends of root [N, T, 2]."""
    line = root[:, frames.stop] - root[:, frames.start]
    return np.linalg.norm(line, axis=-1) * FPS / (frames.stop - frames.start), np.rad2deg(np.arctan2(*line.T))


def _sliding(feet: np.ndarray, contacts: np.ndarray) -> np.ndarray:
    """Returns the mean horizontal speed [N] in m/s of feet [N, T, 4, 3] between adjacent frames in contact."""
    both = (contacts[:, 1:] >= 0.5) & (contacts[:, :-1] >= 0.5)
    speed = np.linalg.norm(np.diff(feet, axis=1)[..., [0, 2]], axis=-1) * FPS
    return (speed * both).sum((1, 2)) / np.maximum(both.sum((1, 2)), 1)


def _short(degrees: np.ndarray) -> np.ndarray:
    return (degrees + 180.0) % 360.0 - 180.0


def _mean(values: np.ndarray) -> float:
    return round(float(np.nanmean(values)), 4)


WORST = ("pose distance", "speed of a joint, m/s", "height of a joint, m", "not finite")
"""Quantities that must stay bounded under random commands."""


def random_commands(seconds: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns random velocities [T, 2], as multiples of the natural speed, and directions [T, 2].

    The command changes every one to three seconds; one in six is to stand.
    """
    rng, frames = np.random.default_rng(seed), round(seconds * FPS)
    lengths = rng.integers(FPS, 3 * FPS, frames // FPS + 1)
    yaw, speed = rng.uniform(-np.pi, np.pi, len(lengths)), rng.uniform(0.3, 1.5, len(lengths))
    speed = np.where(rng.random(len(lengths)) < 1 / 6, 0.0, speed)
    yaw, speed = (np.repeat(values, lengths)[:frames].astype(np.float32) for values in (yaw, speed))
    direction = np.stack([np.sin(yaw), np.cos(yaw)], -1)
    return speed[:, None] * direction, direction


@partial(jax.jit, static_argnums=0)
def wander(setup: ControllerSetup, params: ControllerParams, style: jax.Array, *command: jax.Array) -> dict[str, Any]:
    """Returns the largest values of `WORST` of a character in a style [C] under commands [T, 2]."""
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
    return jax.lax.scan(frame, (begin, zero), command)[0][1]


def wander_all(controller: Controller, minutes: float) -> dict[str, Any]:
    """Returns the largest values of `WORST` over all styles under random commands."""
    count, (velocity, direction) = len(controller.styles), random_commands(60.0 * minutes, 0)
    weights = jnp.eye(count, controller.capacity)
    velocities = velocity[None] * np.asarray(controller.params.speeds)[:count, None, None]
    many = jax.vmap(partial(wander, controller.setup), in_axes=(None, 0, 0, None))
    worst = jax.tree.map(np.asarray, many(controller.params, weights, velocities, jnp.asarray(direction)))
    return {name: round(float(values.max()), 3) for name, values in worst.items()}


def chosen(names: Sequence[str], count: int) -> list[str]:
    """Returns `count` evenly spaced names, or all if it is 0."""
    positions = np.linspace(0, len(names) - 1, min(count or len(names), len(names)))
    return [str(names[round(float(position))]) for position in positions]


def main(config: Config) -> dict[str, Any]:
    """Simulates and measures every run; prints the results."""
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
