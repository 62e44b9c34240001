"""How far is a style that was learned from a straight walk from what its actor does in turns, and how near could it be?

Question  how large are the distances between which methods of few-shot learning are compared?
Method    on every fold: the network without an adapter; the paper's recipe on the clip (Mason 2018 §7.2); the network
          that was pretrained on the style too, with half of its turning takes (as the paper does, and with
          noise on poses, which is a better bound); the adapter learned on that half.
Run       python -m experiments.few_shot.anchors --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

import tyro

from experiments.common.few_shot_recipes import learn_own_turns, learn_paper
from experiments.common.turning_folds import FULL, FULL_NOISY, Fold, FoldConfig, TurningFolds, load_results, no_style
from experiments.common.turning_table import FULL_DATA, FULL_PAPER, NONE, OWN_TURNS, PAPER, write_tables


def judge_anchors(fold: Fold) -> None:
    """Judges the methods that others are compared with, on one fold."""
    fold.judge(NONE, lambda: no_style(fold.network()))
    fold.judge(PAPER, lambda: learn_paper(fold))
    fold.judge(FULL_PAPER, fold.own_style, FULL)
    fold.judge(FULL_DATA, lambda: fold.own_style(FULL_NOISY), FULL_NOISY)
    fold.judge(OWN_TURNS, lambda: learn_own_turns(fold))


def main(config: FoldConfig) -> None:
    """Judges the anchors on all folds, and writes their tables."""
    for fold in TurningFolds(config).folds():
        judge_anchors(fold)
    write_tables(config.out, "anchors", load_results(config, (NONE, PAPER, FULL_PAPER, FULL_DATA, OWN_TURNS)))


if __name__ == "__main__":
    main(tyro.cli(FoldConfig, description=__doc__))
