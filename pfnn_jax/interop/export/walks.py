"""Finds the speed at which a style walks, and the speed to command for it in the published loop."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np

from pfnn_jax.control.controller import make_controller
from pfnn_jax.control.controller_state import style_speed
from pfnn_jax.control.run_settings import default_speed
from pfnn_jax.control.standing import mix_stances
from pfnn_jax.control.tracking import TrackingConfig
from pfnn_jax.inference.mixture import choice_weights
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.run import Run

STANCE = ("rotations", "height", "hips", "feet", "chest")
"""What of a stance is exported."""


@dataclass(frozen=True)
class Walk:
    """Speeds of a walk, in metres per second.

    Attributes:
        speed: speed at which the style walks.
        asked_speed: speed to command for it in the published loop; networks do not walk exactly at that.
        tracked_speed: speed that command tracking, which also limits the look-ahead, commands for it.
        stance: how it stands, relative to its centre and facing (`control.standing.Stance`): rotations [J, 4] of the
            joints in their parents, height of the hips, hips [2] on the ground, feet [2, 2, 3] (heel, toe), and the
            rotation of the chest [4]. None for a skeleton without roles.
    """

    speed: float
    asked_speed: float
    tracked_speed: float
    stance: dict[str, Any] | None


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
        return [Walk(speed, speed, speed, None) for speed in speeds]
    published, tracked = (_speeds(run, choices, tracking) for tracking in (None, TrackingConfig()))
    pairs = zip(published, tracked, strict=True)
    return [Walk(speed, asked, held, stance) for (speed, asked, _), (_, held, stance) in pairs]


def _speeds(
    run: Run, choices: Sequence[StyleChoice], tracking: TrackingConfig | None
) -> list[tuple[float, float, dict[str, Any]]]:
    """Returns the natural speed of each choice, the speed to command for it (both in m/s), and its stance."""
    weights = [choice_weights(run, choice) for choice in choices]
    names = tuple(dict.fromkeys(name for each in weights for name in each))
    styled = make_controller(run, names, foot_ik=False, tracking=tracking) if names else None
    plain = make_controller(run, (), foot_ik=False, tracking=tracking) if not all(weights) else None
    found = []
    for each in weights:
        controller = styled if each else plain
        assert controller is not None
        weight, params = jnp.asarray(controller.style_weights(each or 0)), controller.params
        assert params.stances is not None
        speed, stance = style_speed(params, weight), mix_stances(params.stances, weight)
        numbers = {name: np.asarray(getattr(stance, name), np.float64).tolist() for name in STANCE}
        found.append((float(speed.natural), float(speed.natural) * float(speed.gain), numbers))
    return found
