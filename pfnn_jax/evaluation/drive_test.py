"""Drives the styles of a controller by a preset, and measures how well they follow and how much their feet slide."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.control.calibration import start_standing
from pfnn_jax.control.controller import Controller, step
from pfnn_jax.control.controller_state import ControllerParams, ControllerSetup, style_speed
from pfnn_jax.control.loop.step import Command
from pfnn_jax.evaluation.drive_preset import PRESET_FPS, DrivePreset, preset_commands
from pfnn_jax.motion.ground import facing_of


@struct.dataclass(kw_only=True)
class Drive:
    """What S characters did in T frames.

    Attributes:
        hips: [S, T, 3] metres.
        toes: [S, T, 2, 3] metres, left and right.
        facing: [S, T, 2] unit vectors.
        time_scale: [S, T].
    """

    hips: jax.Array
    toes: jax.Array
    facing: jax.Array
    time_scale: jax.Array


def drive(controller: Controller, preset: DrivePreset, chunk: int = 128) -> Drive:
    """Returns what every style of a controller does under a preset, from standing at the origin.

    Args:
        controller: with or without command tracking and foot locking.
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
    """Returns the drive of styles [S, C] under relative velocities [T, 2] and directions [T, 2]."""
    toes = np.array([setup.rig.feet[1], setup.rig.feet[3]])

    def one(style: jax.Array) -> Drive:
        natural = style_speed(params, style).natural

        def frame(state, row):
            state = step(setup, params, state, Command(velocity=natural * row[0], direction=row[1], style=style))
            joints = state.joints
            return state, Drive(hips=joints[0], toes=joints[toes], facing=state.facing, time_scale=state.time_scale)

        yaw = jnp.arctan2(direction[0, 0], direction[0, 1])
        return jax.lax.scan(frame, start_standing(setup, params, jnp.zeros(2), yaw, style), (velocity, direction))[1]

    return jax.vmap(one)(styles)
