"""What keeps a learned walk on its cycle: dropout, or noise on the pose?

Question  which dropout, and which noise on the pose inputs while the adapter is learned, makes walks that do not
          diverge and stay near the actor's?
Method    restyled rows with dropout of 0, .1, .3 (the default) and .5 before the shared layers, with .3 before the
          adapter too, and with Gaussian noise of .02, .05 and .1 on the normalised pose inputs instead of dropout (a
          standard deviation of them is .1); the clip alone, and the style's own turns, with noise.
Verdict   (elderly, on networks without noise in pretraining) dropout of .3 2.76 / 2.59, of .5 2.90 / 2.85; before the
          adapter too no difference; noise of .02 besides it 2.69 / 2.54. Noise instead of dropout: .02 2.67 / 2.75, .05
          2.71 / 2.70, .1 2.78 / 2.76, on normal 2.93 / 3.70 instead of 2.86 / 2.80. The clip alone with noise of .3
          diverges in the loop (active). Something must disturb the input; dropout of .3 does, and noise adds little to
          it.
Run       python -m experiments.few_shot.dropout_and_noise --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import tyro

from experiments.common.few_shot_recipes import Learning, clip_rows, learn_own_turns, learn_rows
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, learn_base
from pfnn_jax.models.style import Style

VARIANTS = {
    "dropout 0": Learning(main_dropout=0.0),
    "dropout .1": Learning(main_dropout=0.1),
    "dropout .5": Learning(main_dropout=0.5),
    "dropout .3 everywhere": Learning(adapter_dropout=0.3),
    "noise .02, no dropout": Learning(main_dropout=0.0, noise=0.02),
    "noise .05, no dropout": Learning(main_dropout=0.0, noise=0.05),
    "noise .1, no dropout": Learning(main_dropout=0.0, noise=0.1),
    "noise .02, dropout .3": Learning(noise=0.02),
}
"""Variants next to the default, dropout of .3 before the shared layers."""

MORE_NOISE = Learning(main_dropout=0.1, noise=0.2)
"""What was tried on other rows."""


def learn_noisy_clip(fold: Fold, kind: NetworkKind) -> Style:
    """Returns the style that is learned from the clip alone, with noise."""
    network = fold.network(kind)
    return learn_rows(fold, network, clip_rows(fold, network), MORE_NOISE)


METHODS = {name: Method(partial(learn_base, learning=learning)) for name, learning in VARIANTS.items()} | {
    "clip alone, noise .2": Method(learn_noisy_clip),
    "own turns, noise .2": Method(partial(learn_own_turns, learning=MORE_NOISE)),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "dropout_and_noise", METHODS, (PAPER, BASE))
