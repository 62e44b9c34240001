"""Finds the speed at which a style walks, and the speed to command for it in the published loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp

from pfnn_jax.control.controller import make_controller
from pfnn_jax.control.controller_state import style_speed
from pfnn_jax.control.run_settings import default_speed
from pfnn_jax.control.tracking import TrackingConfig
from pfnn_jax.inference.mixture import choice_weights
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.run import Run


@dataclass(frozen=True)
class Walk:
    """Speeds of a walk, in metres per second.

    Attributes:
        speed: speed at which the style walks.
        asked_speed: speed to command for it in the published loop; networks do not walk exactly at that.
        tracked_speed: speed that command tracking, which also limits the look-ahead, commands for it.
    """

    speed: float
    asked_speed: float
    tracked_speed: float


def walks_of(run: Run, choices: Sequence[StyleChoice]) -> list[Walk]:
    """Measures the walks of choices of style, without and with command tracking (`calibration.calibrate_speeds`).

    A skeleton without roles cannot have a controller; its walks are the recorded speeds of the styles.

    Args:
        run: a loaded run.
        choices: as `load_choice` takes them.

    Raises:
        InputError: for an unknown style, or a FiLM run without styles.
    """
    if run.skeleton.roles is None:
        speeds = [default_speed(run, choice) for choice in choices]
        return [Walk(speed, speed, speed) for speed in speeds]
    published, tracked = (_speeds(run, choices, tracking) for tracking in (None, TrackingConfig()))
    return [Walk(speed, asked, held) for (speed, asked), (_, held) in zip(published, tracked, strict=True)]


def _speeds(run: Run, choices: Sequence[StyleChoice], tracking: TrackingConfig | None) -> list[tuple[float, float]]:
    """Returns the natural speed of each choice, and the speed to command for it, in metres per second."""
    weights = [choice_weights(run, choice) for choice in choices]
    names = tuple(dict.fromkeys(name for each in weights for name in each))
    styled = make_controller(run, names, foot_ik=False, tracking=tracking) if names else None
    plain = make_controller(run, (), foot_ik=False, tracking=tracking) if not all(weights) else None
    found = []
    for each in weights:
        controller = styled if each else plain
        assert controller is not None
        speed = style_speed(controller.params, jnp.asarray(controller.style_weights(each or 0)))
        found.append((float(speed.natural), float(speed.natural) * float(speed.gain)))
    return found
