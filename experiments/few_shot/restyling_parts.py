"""Which parts of restyling are needed?

Question  how many restyled rows are enough, which of the known styles' rows are needed, and do scaling by the walking
          speed and by the joints' shares help?
Method    the default's rows, of all takes of the known styles; rows of their turning takes alone, as many, 300 and
          4,800; turning takes without scaling differences by speed, and without the joints' shares; no restyled rows.
          All are learned in the same loop.
Verdict   (elderly, controller / loop in cm) the clip alone 2.88 / 4.55; the default's rows 2.73 / 2.64, turning takes
          alone 2.72 / 2.64, 300 of their rows 2.72 / 2.76, 4,800 rows 2.72 / 2.58; not scaled by speed 2.70 / 2.84,
          without joints' shares 2.71 / 2.68. Restyled rows make the walk in the loop. More than 300 rows and the scale
          by speed matter in the loop alone, by .1 to .2; the shares make no difference that could be measured. Runs
          must be left out: feminine 3.18 / 3.10 with them, 3.03 / 2.98 without.
Run       python -m experiments.few_shot.restyling_parts --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import tyro

from experiments.common.few_shot_recipes import clip_rows, learn_rows
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, draw_rows, learn_base, restyle_turns, straight_and_turning
from pfnn_jax.models.style import Style
from pfnn_jax.training.data import join_batches
from pfnn_jax.training.restyling import COUNT

COUNTS = (300, 4800)
"""Numbers of restyled rows next to the default."""


def learn_with(
    fold: Fold, kind: NetworkKind, count: int = COUNT, by_speed: bool = True, by_joint: bool = True
) -> Style:
    """Returns the style that is learned from the clip and restyled rows, of which parts are left out."""
    network, parts = fold.network(kind), straight_and_turning(fold.known_takes(kind))
    turns = draw_rows(parts, count, fold.seed)
    restyled = restyle_turns(fold, network, parts, turns, by_speed=by_speed, by_joint=by_joint)
    return learn_rows(fold, network, join_batches([clip_rows(fold, network), restyled]))


def learn_clip(fold: Fold, kind: NetworkKind) -> Style:
    """Returns the style that is learned from the clip alone."""
    network = fold.network(kind)
    return learn_rows(fold, network, clip_rows(fold, network))


METHODS = {
    BASE: Method(learn_base),
    "turning takes alone": Method(learn_with),
    **{f"{count} rows": Method(partial(learn_with, count=count)) for count in COUNTS},
    "not scaled by speed": Method(partial(learn_with, by_speed=False)),
    "without joints' shares": Method(partial(learn_with, by_joint=False)),
    "clip alone": Method(learn_clip),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "restyling_parts", METHODS, (PAPER,))
