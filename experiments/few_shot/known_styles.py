"""How much is lost because few styles are known?

Question  does the learned style come nearer to the actor's turns with a network that knows more styles?
Method    networks that are pretrained on 2, 4 and all 6 other styles, equally long; the paper's recipe and restyled
          turns of the styles that the network knows.
Verdict   (elderly, present heading correction) with 2, 4 and 6 styles the paper's recipe has 3.17 / 4.53, 2.75 / 3.20
          and 3.01 / 3.72, restyled rows 2.72 / 3.02, 2.56 / 2.52 and 2.59 / 2.62: two are too few, four are enough.
Run       python -m experiments.few_shot.known_styles --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from dataclasses import replace

import tyro

from experiments.common.few_shot_recipes import learn_paper
from experiments.common.turning_folds import NOISY, FoldConfig, Method, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, learn_base

KINDS = {number: replace(NOISY, num_known=number) for number in (2, 4)}
"""Networks that know some of the other styles, next to the one that knows all."""

METHODS = {f"{number} styles, {PAPER}": Method(learn_paper, kind) for number, kind in KINDS.items()} | {
    f"{number} styles, {BASE}": Method(learn_base, kind) for number, kind in KINDS.items()
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "known_styles", METHODS, (PAPER, BASE))
