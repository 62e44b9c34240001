"""Do characters come to stand on both feet in every style, and is that smooth?

Parent    Holden 2017, Mason 2018 and Mason 2022 drive characters that always walk; only the data of the first has
          standing. The baseline is a controller that stops the network's time within a step.
Question  how far above the floor are toes and heels one second after the command to stop, at any phase of the walk, and
          how fast do joints move while a character stops, turns on the spot and walks off?
Data      the given runs. Every style walks off from standing and walks straight, on a circle at 60 degrees a second, to
          its side, or at 1.5 times its natural speed; it is commanded to stop in 16 moments over 1.3 seconds, to turn
          by 120 degrees on the spot two seconds later, and to walk again two seconds after that.
Measure   heights one second after the command over those of feet that stand flat in the run's data, or else over the
          lower quartile of the heights of the same joint in contact while the style walks straight; the share of
          stops with a toe or heel more than 1 cm off, and with a toe 3 cm above the other; the largest speed of a
          joint after the command, relative to the largest during the walk before it, and the same joint by joint.
Expect    see docs/results_appendix.md. Three minutes for 10 styles on 2 cores.
Run       python -m experiments.standing --runs RUN [RUN ...]
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from pfnn_jax.control.controller import Controller, make_controller, rollout_commands
from pfnn_jax.control.loop.step import Command
from pfnn_jax.run import load_run
from pfnn_jax.run_config import list_styles

FPS = 60
PHASES, APART = 16, 5
"""Moments of the command to stop, and frames between two of them."""

WALK = 3 * FPS
"""Frames before the first of them."""

STAND, TURN, AGAIN = 2 * FPS, 2 * FPS, FPS
"""Frames of standing, of turning on the spot, and of walking again."""

KINDS = {"straight": (1.0, 0.0, 0.0), "circle": (1.0, 60.0, 0.0), "sideways": (1.0, 0.0, 90.0), "fast": (1.5, 0.0, 0.0)}
"""Walks before a stop: multiple of the natural speed, degrees per second, degrees from the facing to the heading."""

TURN_DEGREES = 120.0


@dataclass(frozen=True)
class Config:
    """The experiment.

    Attributes:
        runs: run directories.
        chunk: characters simulated at once.
    """

    runs: tuple[Path, ...]
    chunk: int = 256


def commands(speed: float, rate: float, strafe_angle: float, stop: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns velocities [T, 2] and directions [T, 2] of a walk that is to stop at a frame."""
    frame = np.arange(WALK + PHASES * APART + STAND + TURN + AGAIN)
    yaw = np.deg2rad(rate) * np.clip(frame - FPS, 0, stop - FPS) / FPS
    yaw = yaw + np.deg2rad(TURN_DEGREES) * (frame >= stop + STAND)
    heading = yaw + np.deg2rad(strafe_angle) * (frame < stop)
    moving = (frame < stop) | (frame >= stop + STAND + TURN)
    direction, travel = (np.stack([np.sin(angle), np.cos(angle)], -1).astype(np.float32) for angle in (yaw, heading))
    return np.float32(speed) * moving[:, None] * travel, direction


def stops(controller: Controller, chunk: int, resting: np.ndarray | None) -> dict[str, np.ndarray]:
    """Returns the measures [S, K, P] of all styles, kinds of walk and moments of stopping."""
    styles = len(controller.styles)
    cases = [(s, kind, p) for s in range(styles) for kind in KINDS for p in range(PHASES)]
    weights = np.eye(styles, controller.capacity, dtype=np.float32)
    speeds = np.asarray(controller.params.speeds)

    starts = [controller.start(style=s) for s in range(styles)]
    many = jax.jit(jax.vmap(partial(_walk, controller.setup), in_axes=(None, 0, 0, 0)))
    found: dict[str, list[Any]] = {}
    for first in range(0, len(cases), chunk):
        part = cases[first : first + chunk]
        part = part + part[-1:] * (min(chunk, len(cases)) - len(part))
        walks = [commands(KINDS[k][0] * speeds[s], *KINDS[k][1:], WALK + APART * p) for s, k, p in part]
        velocity, direction = (jnp.asarray(np.stack(values)) for values in zip(*walks, strict=True))
        state = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(starts[s] for s, _, _ in part))
        joints, facing, contacts = many(
            controller.params,
            state,
            Command(velocity=velocity, direction=direction),
            jnp.asarray(weights[[s for s, _, _ in part]]),
        )
        for i in range(min(chunk, len(cases) - first)):
            walk = (np.asarray(joints[i]), np.asarray(facing[i]), np.asarray(contacts[i]))
            measured = _measure(controller, *walk, WALK + APART * part[i][2])
            for name, value in measured.items():
                found.setdefault(name, []).append(value)
    shape = (styles, len(KINDS), PHASES)
    arrays = {name: np.array(values).reshape(*shape, *np.shape(values[0])) for name, values in found.items()}
    floor = np.median(arrays.pop("floor")[:, 0], axis=1)[:, None, None]
    if resting is not None:
        floor = np.broadcast_to(resting.reshape(4), floor.shape)
    heights = arrays["heights"] = arrays.pop("feet") - floor
    toes = heights[..., [1, 3]]
    arrays["toe above 1 cm"] = (np.abs(toes).max(-1) > 0.01).astype(float)
    arrays["heel above 1 cm"] = (np.abs(heights[..., [0, 2]]).max(-1) > 0.01).astype(float)
    arrays["toes 3 cm apart"] = (np.abs(toes[..., 0] - toes[..., 1]) > 0.03).astype(float)
    return arrays


def _walk(setup, params, state, command, style):
    rows = jnp.broadcast_to(style, (len(command.velocity), *style.shape))
    command = Command(velocity=command.velocity, direction=command.direction, style=rows)
    states = rollout_commands(setup, params, state, command)[1]
    return states.joints, states.facing, states.contacts


def _measure(
    controller: Controller, joints: np.ndarray, facing: np.ndarray, contacts: np.ndarray, stop: int
) -> dict[str, Any]:
    feet = joints[:, list(controller.setup.rig.feet)]
    speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * FPS  # row t: from t to t + 1
    walking = speed[2 * FPS : stop - 1].max(0)
    parts = {
        "stop": slice(stop - 1, stop + STAND - 1),
        "turn": slice(stop + STAND - 1, stop + STAND + TURN - 1),
        "off": slice(stop + STAND + TURN - 1, stop + STAND + TURN + FPS - 1),
        "first start": slice(0, FPS),
    }
    touching = np.where(contacts[FPS:stop] > 0.5, feet[FPS:stop, :, 1], np.nan)
    floor = np.nanquantile(touching, 0.25, axis=0)
    accelerations = np.linalg.norm(np.diff(joints, n=2, axis=0), axis=-1) * FPS**2
    measured: dict[str, Any] = {"floor": floor, "feet": feet[stop + FPS, :, 1]}
    for name, frames in parts.items():
        peak = speed[frames].max(0)
        measured[f"{name}: speed"] = peak.max() / walking.max()
        measured[f"{name}: speed of one joint"] = (peak / walking).max()
        measured[f"{name}: acceleration"] = accelerations[frames].max() / accelerations[2 * FPS : stop - 2].max()
    at = stop + STAND + TURN - 1
    yaw = np.unwrap(np.arctan2(facing[:, 0], facing[:, 1]))
    measured["turned"] = np.rad2deg(yaw[at] - yaw[stop + STAND - 1])
    hips = joints[:, 0]
    measured["distance"] = np.linalg.norm((hips[stop + FPS] - hips[stop])[[0, 2]])
    after = speed[stop + FPS : stop + STAND - 1]
    measured["speed while standing"] = after.max()
    measured["lowest"] = feet[stop:, :, 1].min()
    return measured


def main(config: Config) -> None:
    """Measures every run; prints the results."""
    for path in config.runs:
        run = load_run(path)
        controller = make_controller(run, list_styles(run.path))
        found = stops(controller, config.chunk, run.skeleton.resting_heights)
        print(path, len(controller.styles), "styles")
        for index, kind in enumerate(KINDS):
            row = {}
            for name, values in found.items():
                if name == "heights":
                    row["highest, cm"] = round(100 * float(np.abs(values[:, index]).max()), 2)
                elif "cm" in name:
                    row[name] = f"{int(values[:, index].sum())}/{values[:, index].size}"
                elif name in ("turned", "lowest"):
                    row[name] = [round(float(np.quantile(values[:, index], q)), 3) for q in (0, 0.5)]
                else:
                    row[name] = [round(float(np.quantile(values[:, index], q)), 2) for q in (0.5, 0.95, 1.0)]
            print(kind, json.dumps(row), flush=True)


if __name__ == "__main__":
    main(tyro.cli(Config, description=__doc__))
