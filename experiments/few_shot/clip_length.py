"""How much is lost because the clip is short?

Question  does the learned style come nearer to the actor's turns with more frames of straight walking?
Method    restyled rows with the first 1, 2 and 5 seconds of the walk and their mirror images, and with all straight
          walks of the style.
Verdict   (present heading correction) elderly 2.70 / 2.55, 2.61 / 2.52, 2.59 / 2.62 and, with all walks, 2.64 / 3.17;
          feminine 2.99 / 3.19, 2.98 / 3.03, 3.07 / 2.97 and 3.03 / 2.83: a second does as much as all walks.
Run       python -m experiments.few_shot.clip_length --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import tyro

from experiments.common.few_shot_recipes import learn_rows
from experiments.common.style_takes import adaptation_clip, rows_of
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, draw_rows, restyle_turns, straight_and_turning
from pfnn_jax.models.style import Style
from pfnn_jax.training.data import join_batches, to_batch
from pfnn_jax.training.restyling import COUNT


def learn_from(fold: Fold, kind: NetworkKind, seconds: float | None) -> Style:
    """Returns the style that is learned from the beginning of the walk, or all walks (None), and restyled rows."""
    network, parts = fold.network(kind), straight_and_turning(fold.known_takes(kind))
    if seconds is None:
        walks = [rows_of(fold.walks)]
    else:
        walks = adaptation_clip(fold.walks[0], round(seconds * fold.layout.fps))
    clip = to_batch(walks, network.normaliser)
    turns = restyle_turns(fold, network, parts, draw_rows(parts, COUNT, fold.seed), clip=clip)
    return learn_rows(fold, network, join_batches([clip, turns]))


METHODS = {f"{seconds:g} s": Method(partial(learn_from, seconds=seconds)) for seconds in (1.0, 2.0)} | {
    "all walks": Method(partial(learn_from, seconds=None))
}
"""Lengths of the clip next to the 5 seconds of all other experiments."""


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "clip_length", METHODS, (PAPER, BASE))
