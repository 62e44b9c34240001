"""Does a network that has seen disturbed poses walk better in a style that it learns later?

Question  how much noise on the pose inputs in pretraining, and how much dropout with it, makes the best walks?
Method    networks pretrained with noise of up to .05, .1 and .3 on the normalised pose inputs (a standard deviation of
          them is .1) and dropout of .3, .2 and .1; without an adapter, with the paper's recipe, and with restyled
          turns; and the full-data network with and without noise.
Verdict   (restyled turning takes; elderly, feminine) no noise, dropout of .3: 2.76 / 2.55, 3.16 / 2.97; .05, .3:
          2.63 / 2.53, 2.89 / 2.97; .1, .2: 2.76 / 2.69, 2.87 / 2.93; .3, .1: 2.69 / 2.59, 3.06 / 2.91. The paper's
          recipe: no noise 2.91 / 3.84, 3.15 / 3.22; .05, .3: 2.82 / 3.58, 3.06 / 3.27; .1, .2: 2.99 / 3.64,
          3.10 / 2.99. The full-data network gains most where its loop drifts: normal 4.16 / 7.43 without noise,
          2.74 / 2.59 with .3. .05 with the paper's dropout is the default.
Run       python -m experiments.few_shot.pose_noise --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

import tyro

from experiments.common.few_shot_recipes import learn_nothing, learn_paper
from experiments.common.turning_folds import FULL, Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import FULL_DATA, FULL_PAPER, NONE, PAPER
from experiments.common.varied_restyling import BASE, learn_base

KINDS = {
    f"noise {noise:g}, dropout {dropout:g}": NetworkKind(pose_noise=noise, dropout=dropout)
    for noise, dropout in ((0.0, 0.3), (0.05, 0.3), (0.1, 0.2), (0.3, 0.1))
}


METHODS = {
    f"{name}, {method}": Method(learn, kind)
    for name, kind in KINDS.items()
    for method, learn in ((NONE, learn_nothing), (PAPER, learn_paper), (BASE, learn_base))
} | {FULL_PAPER: Method(Fold.own_style, FULL)}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "pose_noise", METHODS, (NONE, PAPER, BASE, FULL_DATA))
