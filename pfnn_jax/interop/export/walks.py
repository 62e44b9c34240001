"""Finds the speed at which a style walks, and the speed to command for it in the published loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp

from pfnn_jax.control.controller import Controller, make_controller
from pfnn_jax.control.controller_state import style_speed
from pfnn_jax.control.run_settings import default_speed
from pfnn_jax.inference.mixture import choice_weights
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.run import Run


@dataclass(frozen=True)
class Walk:
    """Speeds of a walk, in metres per second.

    Attributes:
        speed: speed at which the style walks.
        asked_speed: speed to command for it; networks do not walk exactly at the commanded speed.
    """

    speed: float
    asked_speed: float


def walks_of(run: Run, choices: Sequence[StyleChoice]) -> list[Walk]:
    """Measures the walks of choices of style in the published loop (`control.calibration.calibrate_speeds`).

    A skeleton without roles cannot have a controller; its walks are the recorded speeds of the styles.

    Args:
        run: a loaded run.
        choices: as `load_choice` takes them.

    Raises:
        InputError: for an unknown style, or a FiLM run without styles.
    """
    if run.skeleton.roles is None:
        speeds = [default_speed(run, choice) for choice in choices]
        return [Walk(speed, speed) for speed in speeds]
    weights = [choice_weights(run, choice) for choice in choices]
    names = tuple(dict.fromkeys(name for each in weights for name in each))
    styled = _controller(run, names) if names else None
    plain = _controller(run, ()) if not all(weights) else None
    found = []
    for each in weights:
        controller = styled if each else plain
        assert controller is not None
        speed = style_speed(controller.params, jnp.asarray(controller.style_weights(each or 0)))
        found.append(Walk(float(speed.natural), float(speed.natural) * float(speed.gain)))
    return found


def _controller(run: Run, names: Sequence[str]) -> Controller:
    return make_controller(run, names, foot_ik=False, tracking=None)
