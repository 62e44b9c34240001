"""Which schedule of the learning rate?

Question  does a learning rate that falls to zero, or an average of the parameters, make better walks than a constant
          rate?
Method    restyled rows in 600 steps: at a constant 5e-3 and 1e-3; at 5e-3 with the parameters averaged over the last
          third; falling along half a cosine from 1e-2, 5e-3 (the default) and 2e-3; 1,500 steps from 5e-3.
Verdict   (elderly, on networks without noise in pretraining) half a cosine from 5e-3 2.76 / 2.59, from 1e-2
          2.78 / 2.60, from 2e-3 2.75 / 2.74; a constant 1e-3 for 1,500 steps 2.89 / 2.74. A rate that falls to zero
          reaches in 600 steps what a constant one does not in 1,500.
Run       python -m experiments.few_shot.schedule --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import tyro

from experiments.common.few_shot_recipes import Learning
from experiments.common.turning_folds import FoldConfig, Method, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, learn_base

SCHEDULES = {
    "constant 5e-3": Learning(decay=False),
    "constant 1e-3": Learning(decay=False, learning_rate=1e-3),
    "constant 5e-3, averaged": Learning(decay=False, average=1 / 3),
    "cosine from 1e-2": Learning(learning_rate=1e-2),
    "cosine from 2e-3": Learning(learning_rate=2e-3),
    "cosine, 1,500 steps": Learning(steps=1500),
}
"""Schedules next to the default, half a cosine from 5e-3 in 600 steps."""


METHODS = {name: Method(partial(learn_base, learning=learning)) for name, learning in SCHEDULES.items()}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "schedule", METHODS, (PAPER, BASE))
