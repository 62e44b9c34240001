"""Drives the styles of a controller by a preset, and measures how well they follow and how much their feet slide."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.calibration import start_standing
from pfnn_jax.control.controller import Controller, step
from pfnn_jax.control.controller_state import (
    ControllerParams,
    ControllerSetup,
    ControllerState,
    style_speed,
    walking_pose,
)
from pfnn_jax.control.ik.pose import forward_kinematics
from pfnn_jax.control.loop.step import Command
from pfnn_jax.evaluation.actor_test import SWAY_SECONDS
from pfnn_jax.evaluation.drive_preset import PRESET_FPS, DrivePreset, preset_commands
from pfnn_jax.evaluation.heading_metrics import (
    angle_errors,
    find_lag,
    heading_errors,
    mean_of_numbers,
    published_trajectory_error,
    seconds_since_change,
)
from pfnn_jax.evaluation.metrics import contact_sliding, sliding_over_travel
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.ground import turn, yaw_of

LOW_TOE = 0.01
"""Metres above the lowest toe of a motion below which CAMDM counts a toe."""

LONGEST_LAG = 2.0
"""Seconds within which a lag is looked for."""

SETTLED = 1.0
"""Seconds after a change of the commanded heading from which a character counts as settled."""

PARTS = {"ahead": (0.0, 45.0), "sideways": (45.0, 135.0), "backward": (135.0, 180.1)}
"""Degrees between the commanded heading and the commanded facing."""


@struct.dataclass(kw_only=True)
class Drive:
    """What S characters did in T frames.

    Attributes:
        hips: [S, T, 3] metres.
        toes: [S, T, 2, 3] metres, left and right.
        free_toes: [S, T, 2, 3] metres, of the walking body before its feet are locked.
        contacts: [S, T, 2] in [0, 1], of the toes.
        facing: [S, T, 2] unit vectors.
        time_scale: [S, T].
    """

    hips: np.ndarray | jax.Array
    toes: np.ndarray | jax.Array
    free_toes: np.ndarray | jax.Array
    contacts: np.ndarray | jax.Array
    facing: np.ndarray | jax.Array
    time_scale: np.ndarray | jax.Array


def drive(controller: Controller, preset: DrivePreset, chunk: int = 128) -> Drive:
    """Returns what every style of a controller does under a preset, from standing at the origin.

    Args:
        controller: with or without command tracking.
        preset: of commands.
        chunk: styles simulated at once.
    """
    setup, count = controller.setup, len(controller.styles)
    velocity, direction = map(jnp.asarray, preset_commands(preset, setup.layout.fps))
    weights = np.eye(count, controller.capacity, dtype=np.float32)
    chunk, parts = min(chunk, count), []
    for first in range(0, count, chunk):
        rows = np.minimum(np.arange(first, first + chunk), count - 1)
        parts.append(jax.device_get(_drive_all(setup, controller.params, weights[rows], velocity, direction)))
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[:count], *parts)


@partial(jax.jit, static_argnums=0)
def _drive_all(
    setup: ControllerSetup, params: ControllerParams, styles: jax.Array, velocity: jax.Array, direction: jax.Array
) -> Drive:
    """Returns what styles [S, C] do under relative velocities [T, 2] and directions [T, 2]."""

    def one(style: jax.Array) -> Drive:
        natural = style_speed(params, style).natural

        def frame(state: ControllerState, row: tuple[jax.Array, jax.Array]):
            state = step(setup, params, state, Command(velocity=natural * row[0], direction=row[1], style=style))
            return state, _recorded(setup, state)

        start = start_standing(setup, params, jnp.zeros(2), yaw_of(direction[0]), style)
        return jax.lax.scan(frame, start, (velocity, direction))[1]

    return jax.vmap(one)(styles)


def _recorded(setup: ControllerSetup, state: ControllerState) -> Drive:
    """Returns what is recorded of one character in one frame."""
    toes = np.array([setup.rig.feet[1], setup.rig.feet[3]])
    free = forward_kinematics(setup.rig, walking_pose(replace(setup, foot_lock=None), state)[0])[0]
    return Drive(
        hips=state.joints[0],
        toes=state.joints[toes],
        free_toes=free[toes],
        contacts=state.contacts[np.array([1, 3])],
        facing=state.facing,
        time_scale=state.time_scale,
    )


def measure_drive(driven: Drive, preset: DrivePreset, natural: float, fps: float, free: bool = False) -> dict:
    """Returns how well one character followed a preset, and how much its feet slid.

    Args:
        driven: leaves [T, ...], of one character.
        preset: that it was driven by.
        natural: its natural speed in metres per second.
        fps: frames per second of `driven`.
        free: take the toes before they are locked.

    Returns:
        `sliding`: CAMDM's, dimensionless, of the share `counted` of all toes and frames; `contact sliding`: the same
        ratio over toes in contact. `published error`: CAMDM's, in degrees; `turned`: the same with the world turned by
        90 degrees, which turns the cut of its angles. Angles of heading in degrees: `error`; `without sway`, of the
        smoothed path; `lag`, in seconds; `without lag`, of the smoothed path with the lag removed; `changing`, in the
        `SETTLED` seconds after a change of the commanded heading; and after that for each of `PARTS`. `facing ...`, in
        degrees, likewise. `speed`: reached over commanded. `time scale`: the mean.
    """
    toes, hips = (np.asarray(x, float) for x in (driven.free_toes if free else driven.toes, driven.hips))
    low = toes[:-1, :, 1] - toes[..., 1].min() < LOW_TOE
    travel = np.linalg.norm(np.diff(hips[:, [0, 2]], axis=0), axis=-1).mean() * fps
    return {
        "sliding": sliding_over_travel(toes, hips, LOW_TOE),
        "counted": float(low.mean()),
        "contact sliding": contact_sliding(toes, np.asarray(driven.contacts) >= 0.5, fps) / float(travel),
        "speed": float(travel / (natural * np.linalg.norm(preset_commands(preset, fps)[0], axis=-1).mean())),
        "time scale": float(np.mean(driven.time_scale)),
        **measure_headings(hips[:, [0, 2]], np.asarray(driven.facing, float), preset, fps),
    }


def measure_headings(root: np.ndarray, facing: np.ndarray, preset: DrivePreset, fps: float) -> dict[str, float]:
    """Returns the angles of `measure_drive`.

    Args:
        root: [T, 2] metres.
        facing: [T, 2] unit vectors.
        preset: of commands.
        fps: frames per second of `root` and `facing`, a multiple of the preset's.
    """
    wanted, direction = (values.astype(float) for values in preset_commands(preset, PRESET_FPS))
    every = round(fps / PRESET_FPS)
    smooth = gaussian_filter(root, SWAY_SECONDS * fps)[::every]
    root, facing = root[::every], facing[::every]
    lag = find_lag(wanted, smooth, round(LONGEST_LAG * PRESET_FPS))
    heading, faced = heading_errors(wanted, smooth), angle_errors(direction, facing)[:-1]
    since, apart = seconds_since_change(wanted, PRESET_FPS)[:-1], angle_errors(wanted, direction)[:-1]
    settled = since >= SETTLED
    found = {
        "published error": published_trajectory_error(wanted, root),
        "turned": published_trajectory_error(turn(wanted, np.pi / 2), turn(root, np.pi / 2)),
        "error": mean_of_numbers(heading_errors(wanted, root)),
        "without sway": mean_of_numbers(heading),
        "lag": lag / PRESET_FPS,
        "without lag": mean_of_numbers(heading_errors(wanted, smooth, lag)),
        "changing": mean_of_numbers(heading[since < SETTLED]),
        "settled": mean_of_numbers(heading[settled]),
        "facing": mean_of_numbers(faced),
    }
    for name, (least, most) in PARTS.items():
        part = settled & (apart >= least) & (apart < most)
        found |= {name: mean_of_numbers(heading[part]), f"facing {name}": mean_of_numbers(faced[part])}
    return found
