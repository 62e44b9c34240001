"""What a style of a run can do when it is commanded to, found out by commanding it.

A run does not record whether its data held side steps, and its statistics do not tell side steps from turns. Some
networks walk elsewhere when they must not turn: command tracking notices (`TrackingState.strafe_failure`), and releases
the facing constraint then. Others turn all the same, and walk where they are commanded to.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.controller import Controller
from pfnn_jax.control.controller_state import style_speed
from pfnn_jax.control.loop.step import Command
from pfnn_jax.control.tracking import TrackingConfig
from pfnn_jax.motion.ground import angle_between

STRAFE_SECONDS = 4.0
"""Seconds of a trial: four times the time after which command tracking gives up."""

MAX_FACING_ERROR = np.deg2rad(30.0)
"""Mean error of the facing direction above which a character does not do what it is commanded to."""


def can_strafe(controller: Controller, style: str, seconds: float = STRAFE_SECONDS) -> bool:
    """Returns whether a style walks to both sides without turning there.

    Nothing is compiled that driving a character does not need as well. A trial ends as soon as it fails, after one to
    two seconds of motion.

    Args:
        controller: with command tracking.
        style: name.
        seconds: of motion to each side.

    Raises:
        InputError: for an unknown style.
        ValueError: for a controller without command tracking, which obeys no facing.
    """
    tracking = controller.setup.tracking
    if tracking is None:
        raise ValueError("`controller` must have command tracking.")
    weights = controller.style_weights(style)
    speed = float(style_speed(controller.params, jnp.asarray(weights)).natural)
    for side in (1.0, -1.0):
        arrays: dict[str, Any] = {
            "velocity": np.asarray([side * speed, 0.0], np.float32),
            "direction": np.asarray([0.0, 1.0], np.float32),
            "style": weights,
        }
        command = Command(**arrays)
        state, facing = controller.start(style=controller.styles.index(style)), []
        for _ in range(math.ceil(seconds * tracking.fps)):
            state = controller.step(state, command)
            if float(state.tracking.strafe_failure) >= tracking.strafe_timeout:
                return False
            facing.append(np.asarray(state.facing))
        late = np.stack(facing[len(facing) // 2 :])
        if not keeps_facing(late, arrays["direction"][None], float(state.tracking.strafe_failure), tracking):
            return False
    return True


def keeps_facing(facing: np.ndarray, direction: np.ndarray, strafe_failure: float, config: TrackingConfig) -> bool:
    """Returns whether a character faces the way it is commanded to while it walks or stands.

    Args:
        facing: [T, 2] unit vectors of the root, once it has reached its speed.
        direction: [T or 1, 2] commanded.
        strafe_failure: seconds, at the end (`TrackingState.strafe_failure`).
        config: constants of command tracking.
    """
    return strafe_failure < config.strafe_timeout and facing_error(facing, direction) <= MAX_FACING_ERROR


def facing_error(facing: np.ndarray, direction: np.ndarray) -> float:
    """Returns the mean angle in radians between unit vectors [T, 2] and commanded directions [T or 1, 2]."""
    return float(np.abs(angle_between(direction, facing)).mean())
