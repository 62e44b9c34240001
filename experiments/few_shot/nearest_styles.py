"""Do the known styles that are nearest to the clip help more than all of them?

Question  is it better to begin with the adapter of the nearest known style, or to restyle turns of the nearest alone?
Method    the known styles are ranked by the error of their adapters on the clip; restyled rows, begun with the first
          style's adapter; and restyled rows of the first three styles alone.
Verdict   (present heading correction) start from the nearest style: elderly 2.64 / 2.68, feminine 3.03 / 2.97; turns of
          the nearest three: 2.66 / 2.65 and 3.07 / 2.97; without either 2.59 / 2.62 and 3.07 / 2.97: no difference.
Run       python -m experiments.few_shot.nearest_styles --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

import numpy as np
import tyro

from experiments.common.few_shot_recipes import clip_rows, learn_rows
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods, style_of
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import (
    BASE,
    draw_rows,
    learn_base,
    restyle_turns,
    straight_and_turning,
)
from pfnn_jax.models.style import Style
from pfnn_jax.training.data import join_batches
from pfnn_jax.training.few_shot_learning import row_errors
from pfnn_jax.training.restyling import COUNT

NEAREST = 3
"""Styles whose turns alone are restyled."""


def ranking(fold: Fold, kind: NetworkKind) -> list[int]:
    """Returns the numbers of the known styles, the one whose adapter fits the clip best first."""
    network = fold.network(kind)
    errors = row_errors(network.bank, network.shared, clip_rows(fold, network)).mean(axis=1)
    return [int(number) for number in np.argsort(errors)]


def learn_from_nearest_start(fold: Fold, kind: NetworkKind) -> Style:
    """Returns the style that is learned from restyled rows, begun with the nearest style's adapter."""
    return learn_base(fold, kind, start=style_of(fold.network(kind), ranking(fold, kind)[0]))


def learn_from_nearest_turns(fold: Fold, kind: NetworkKind) -> Style:
    """Returns the style that is learned from turns of the nearest styles alone."""
    network, styles = fold.network(kind), fold.known_styles(kind)
    known = {styles[number]: fold.known_takes(kind)[styles[number]] for number in ranking(fold, kind)[:NEAREST]}
    parts = straight_and_turning(known)
    restyled = restyle_turns(fold, network, parts, draw_rows(parts, COUNT, fold.seed))
    return learn_rows(fold, network, join_batches([clip_rows(fold, network), restyled]))


METHODS = {
    "start from the nearest style": Method(learn_from_nearest_start),
    "turns of the nearest three": Method(learn_from_nearest_turns),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "nearest_styles", METHODS, (PAPER, BASE))
