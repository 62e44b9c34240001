"""Do the known styles' turns, restyled, close the gap between a straight walk and a style's own turns?

Question  how much of what the paper's recipe leaves open on real turns do restyled rows close, and how much noise on
          poses in pretraining?
Method    a style is learned from its clip and from restyled rows of the known styles (`pfnn_jax.training.restyling`),
          with the settings that `few-shot` has by default: on the paper's network; on one that was pretrained with
          noise on poses; and there by an adapter of the last layer instead of the second. The full-data network,
          pretrained with the same noise on the style too and on half of its turning takes, is the honest upper bound;
          an adapter that is learned from that half shows what an adapter can reach.
Verdict   (present heading correction) on the styles that it was chosen on, the default is 3.19 / 3.38 cm from the
          actor, the paper's recipe 3.56 / 3.76, full data 2.74 / 4.08: 45 % (38 to 53) of what the paper's recipe
          leaves open in the controller. Confirmed: 3.83 / 3.99, 3.95 / 3.91 and 3.18 / 4.52, 16 % (-16 to 38);
          masculine is worse, by 0.3 and 0.7 cm. Its clip, and that of exhausted, are not how the actor walked in the
          turning takes, straight parts included (`mean_cycles`). Half is not reached.
Run       python -m experiments.few_shot.restyled_turns --data FOLDER --out runs/few_shot
          chosen on active, elderly, feminine and normal with seed 0; confirmed once with
          --styles exhausted masculine youthful --seeds 0 1 2
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import tyro

from experiments.common.few_shot_recipes import (
    learn_nothing,
    learn_own_turns,
    learn_paper,
    learn_restyled,
)
from experiments.common.turning_folds import FULL_NOISY, NOISY, WITHOUT, Fold, FoldConfig, Method, run_methods
from experiments.common.turning_table import FULL_DATA, NONE, OWN_TURNS, PAPER
from pfnn_jax.training.config import RESTYLED_FEW_SHOT

RESTYLED, NOISY_RESTYLED = "restyled rows", "restyled rows, pose noise"
DEFAULT = "restyled rows, pose noise, output adapter"
"""The methods in question; the last is the default of `few-shot`."""

MIDDLE = replace(RESTYLED_FEW_SHOT, method="cp")
"""The default with an adapter of the second layer, as in the paper."""


METHODS = {
    NONE: Method(learn_nothing, WITHOUT),
    PAPER: Method(learn_paper, WITHOUT),
    RESTYLED: Method(partial(learn_restyled, config=MIDDLE), WITHOUT),
    NOISY_RESTYLED: Method(partial(learn_restyled, config=MIDDLE), NOISY),
    DEFAULT: Method(learn_restyled, NOISY),
    FULL_DATA: Method(Fold.own_style, FULL_NOISY),
    OWN_TURNS: Method(learn_own_turns, NOISY),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "restyled_turns", METHODS)
