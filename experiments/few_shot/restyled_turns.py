"""Do the known styles' turns, restyled, close the gap between a straight walk and a style's own turns?

Question  how much of what the paper's recipe leaves open on real turns do restyled rows close, and how much noise on
          poses in pretraining?
Method    a style is learned from its clip and from restyled rows of the known styles (`pfnn_jax.training.restyling`),
          with the settings that `few-shot` has by default, on the paper's network and on one that was pretrained with
          noise on poses. The full-data network, pretrained with the same noise on the style too and on half of its
          turning takes, is the honest upper bound.
Run       python -m experiments.few_shot.restyled_turns --data FOLDER --out runs/few_shot
          chosen on active, elderly, feminine and normal with seed 0; confirmed once with
          --styles exhausted masculine youthful --seeds 0 1 2
"""

from __future__ import annotations

import tyro

from experiments.common.few_shot_recipes import known_differences, learn_paper, learn_restyled
from experiments.common.turning_folds import (
    FULL_NOISY,
    NOISY,
    WITHOUT,
    Fold,
    FoldConfig,
    TurningFolds,
    load_results,
    no_style,
)
from experiments.common.turning_table import FULL_DATA, NONE, PAPER, write_tables

NOISY_NONE, NOISY_PAPER = "no adapter, pose noise", "paper's recipe, pose noise"
RESTYLED, DEFAULT = "restyled rows", "restyled rows, pose noise"

METHODS = (NONE, PAPER, NOISY_NONE, NOISY_PAPER, RESTYLED, DEFAULT, FULL_DATA)


def judge_methods(fold: Fold) -> None:
    """Judges the methods on one fold."""
    fold.judge(NONE, lambda: no_style(fold.network()))
    fold.judge(PAPER, lambda: learn_paper(fold))
    fold.judge(RESTYLED, lambda: learn_restyled(fold, WITHOUT, known_differences(fold)))
    fold.judge(DEFAULT, lambda: learn_restyled(fold, NOISY, known_differences(fold, NOISY)), NOISY)
    fold.judge(FULL_DATA, lambda: fold.own_style(FULL_NOISY), FULL_NOISY)
    fold.judge(NOISY_NONE, lambda: no_style(fold.network(NOISY)), NOISY)
    fold.judge(NOISY_PAPER, lambda: learn_paper(fold, NOISY), NOISY)


def main(config: FoldConfig) -> None:
    """Judges the methods on all folds, and writes their tables."""
    for fold in TurningFolds(config).folds():
        judge_methods(fold)
    write_tables(config.out, "restyled_turns", load_results(config, METHODS))


if __name__ == "__main__":
    main(tyro.cli(FoldConfig, description=__doc__))
