"""What a run stores for its controller: the constants of its loop, and the speeds of its styles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.control.loop.step import LOOP_CONFIGS, LoopConfig
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.motion.features.decode import root_steps
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.run import Run
from pfnn_jax.run_config import list_styles, style_note

MAX_SPEED = 1e12
"""Metres per second that no recorded speed reaches; `style.json` may hold integers that no float can."""


def loop_config(run: Run) -> LoopConfig:
    """Returns the constants of the published loop for a run: those of its layout, with the run's own command gain."""
    return replace(LOOP_CONFIGS[run.layout.name], command_gain=run.config.command_gain)


def style_label(style: StyleChoice) -> str:
    """Returns the style name of a generated clip: the name, a mixture as it is written, or `agnostic`."""
    if style is None or isinstance(style, str):
        return style or "agnostic"
    return "+".join(f"{name}:{weight:g}" for name, weight in style.items())


def default_speed(run: Run, style: StyleChoice) -> float:
    """Returns the speed to request by default, in metres per second: the one recorded in a style's `style.json`.

    For a mixture, the weighted mean over its styles. For styles without a recorded speed and for None, the mean over
    the run's data; for None on a FiLM run, whose data moves in all directions, the mean of the recorded speeds.
    """
    if style is None and run.config.adapter.kind == "film":
        recorded = [recorded_speed(run, name) for name in run.config.styles if name in list_styles(run.path)]
        speeds = [speed for speed in recorded if speed is not None]
        if speeds:
            return float(np.mean(speeds))
    weights = {style: 1.0} if isinstance(style, str) else dict(style or {})
    recorded = [(weight, recorded_speed(run, name)) for name, weight in weights.items()]
    if recorded and all(speed is not None for _, speed in recorded):
        return sum(weight * speed for weight, speed in recorded if speed is not None)
    return mean_speed(run.layout, run.normaliser)


def recorded_speed(run: Run, name: str) -> float | None:
    """Returns the speed in metres per second recorded in a style's `style.json`, or None."""
    speed = style_note(run.path, name)["info"].get("speed")
    usable = isinstance(speed, int | float) and 0.0 < speed < MAX_SPEED
    return float(speed) if usable else None


def mean_speed(layout: FrameLayout, normaliser: Normaliser) -> float:
    """Returns the speed of the mean row of the data, in metres per second."""
    velocity, _ = root_steps(layout, normaliser.outputs.mean[None])
    return float(np.hypot(*velocity[0]))
