"""What a style of a run can do when it is commanded to, found out by commanding it.

A run does not record whether its data held side steps, and its statistics do not tell side steps from turns. Command
tracking notices while it walks (`TrackingState.strafe_failure`), and releases the facing constraint then.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pfnn_jax.control.controller import Controller
from pfnn_jax.control.loop.step import Command

STRAFE_SECONDS = 4.0
"""Seconds of a trial: four times the time after which command tracking gives up."""


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
    speed = float(controller.params.speeds[controller.styles.index(style)]) or float(controller.params.default_speed)
    for side in (1.0, -1.0):
        arrays: dict[str, Any] = {
            "velocity": np.asarray([side * speed, 0.0], np.float32),
            "direction": np.asarray([0.0, 1.0], np.float32),
            "style": weights,
        }
        command = Command(**arrays)
        state = controller.start(style=controller.styles.index(style))
        for _ in range(math.ceil(seconds * tracking.fps)):
            state = controller.step(state, command)
            if float(state.tracking.strafe_failure) >= tracking.strafe_timeout:
                return False
    return True
