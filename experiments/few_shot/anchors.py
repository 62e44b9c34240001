"""How far is a style that was learned from a straight walk from what its actor does in turns, and how near could it be?

Question  how large are the distances between which methods of few-shot learning are compared?
Method    on every fold: the network without an adapter; the paper's recipe on the clip (Mason 2018 §7.2); restyled
          turns (`pfnn_jax.training.restyling`); the adapter learned on half of the style's own turns; and the network
          that was pretrained on the style too, with that half.
Run       python -m experiments.few_shot.anchors --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

import tyro

from experiments.common.few_shot_recipes import learn_own_turns, learn_paper
from experiments.common.restyled_turns import RESTYLED, learn_restyled
from experiments.common.turning_folds import FULL, WITHOUT, FoldConfig, Method, learn_nothing, own_style, run_methods
from experiments.common.turning_table import FULL_DATA, NONE, OWN_TURNS, PAPER

METHODS = {
    NONE: Method(learn_nothing, WITHOUT),
    PAPER: Method(learn_paper, WITHOUT),
    RESTYLED: Method(learn_restyled),
    OWN_TURNS: Method(learn_own_turns),
    FULL_DATA: Method(own_style, FULL),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "anchors", METHODS)
