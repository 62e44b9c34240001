"""Judges ways of learning the ninth style by walks along exact turns of it that no network has seen."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pfnn_jax.control.controller import Controller
from pfnn_jax.evaluation.driven_takes import DrivenTake, make_driven_take, track_takes
from pfnn_jax.evaluation.turning_judge import judge_style, judge_walk, mean_measures
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.synthetic.styles import STYLES
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import Run

NO_ADAPTER, LEARNED, PAPER = "no adapter", "restyled turns, the default", "the paper's recipe"
"""Characters of the ninth style: ways of learning it."""

KNOWN = "neutral"
"""A style of pretraining, whose own turns show what a character can reach without having to learn."""

TURN_RATES = (-60.0, -45.0, -30.0, 30.0, 45.0, 60.0)
"""Turn rates of the takes in degrees per second, to the left positive; the adaptation clip does not turn. All are well
above the rate from which the judge counts a frame as turning, although hips sway."""

TAKE_SECONDS = 6.0
"""Length of each take, as much as is judged; the first and the last quarter are straight."""


def turning_takes(style: str, run: Run, seed: int) -> list[DrivenTake]:
    """Returns exact turns of a procedural style at its natural speed, one at each of the `TURN_RATES`.

    Args:
        style: name of the procedural style.
        run: whose characters are to walk along them.
        seed: of the noise and the first phase of the first take; those of the others follow it.
    """
    frames = round(TAKE_SECONDS * run.layout.fps)
    turning = np.zeros(frames)
    turning[frames // 4 : -(frames // 4)] = 1.0
    speed = np.full(frames, STYLES[style].speed)
    return [
        make_driven_take(LabelledClip(*synthesise(style, np.deg2rad(rate) * turning, speed, seed=seed + number)), run)
        for number, rate in enumerate(TURN_RATES)
    ]


def judge_characters(
    controller: Controller, run: Run, takes: Mapping[str, list[DrivenTake]]
) -> dict[str, dict[str, float]]:
    """Returns the mean measures of each style of a controller along its takes (`MEASURES`, `STYLE_MEASURES`).

    Args:
        controller: of characters in the styles; it is compiled once for all of them.
        run: whose characters they are.
        takes: of each style, as many for each.
    """
    judged = {}
    for name, own in takes.items():
        walks = track_takes(controller, controller.style_weights(name), run, own)
        measures = [judge_walk(*pair) for pair in zip(own, walks, strict=True)]
        judged[name] = mean_measures(measures) | judge_style(own, walks)
    return judged
