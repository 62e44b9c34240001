"""What does a style that was learned from a walk do when it is asked to run?

Parent    Mason 2018 §9.1, which names it as an open problem: a style of one gait says little about another.
Question  a style is learned from a few seconds of its straight walk, on a network that knows other styles' walks, turns
          and runs. How far is the character from the actor's own runs, and do the known styles' runs help?
Method    on every fold, driven along every second real run of the held-out style: no adapter; the paper's recipe; the
          clip and restyled rows of the known styles' turns, which is the default of `few-shot`; of their turns and
          runs, by an adapter of the last layer and of the second; and, as a bound, an adapter of the clip and of the
          style's other runs. The paper's recipe is learned on the network as in the paper, the others on the one with
          pose noise, that of the default.
Verdict   elderly and feminine, seed 0, cm, controller / loop: no adapter 6.82 / 19.1 and 8.84 / 5.39, the paper's
          recipe 6.48 / 5.73 and 9.09 / 5.26, restyled turns (the default) 6.27 / 16.8 and 9.40 / 6.00, restyled turns
          and runs 6.22 / 5.87 and 9.38 / 6.71, by an adapter of the second layer 6.04 / 5.59 and 9.35 / 5.45, own runs
          7.00 / 2.12 and 9.34 / 3.73. No method runs in the style: known runs, restyled, do not help. The controller
          keeps characters from running: it plays the walk faster; even styles that learned their own runs leave the
          floor there in at most .02 times as many frames as the actor.
Run       python -m experiments.few_shot.walk_to_run --data FOLDER --out runs/few_shot
          Networks are shared with the other experiments of this folder.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import tyro

from experiments.common.few_shot_recipes import (
    clip_rows,
    learn_paper,
    learn_restyled,
    learn_rows,
)
from experiments.common.markdown import markdown_table
from experiments.common.style_takes import Take, rows_of
from experiments.common.turning_folds import (
    NOISY,
    WITHOUT,
    Fold,
    FoldConfig,
    NetworkKind,
    TurningFolds,
    judge_once,
    judged_file,
    load_results,
    no_style,
)
from experiments.common.turning_judged import WAYS, StyledNetwork
from experiments.common.turning_table import NOISY_NONE, NONE, PAPER, Results, distance_table
from experiments.few_shot.restyled_turns import MIDDLE
from pfnn_jax.evaluation.turning_judge import mean_measures
from pfnn_jax.io.files import write_whole
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.style import Style
from pfnn_jax.training.config import RESTYLED_FEW_SHOT
from pfnn_jax.training.data import join_batches, to_batch

RUN = "run"
"""Content of the takes that are judged."""

TURNS, MIDDLE_RUNS = "restyled turns", "restyled turns and runs, second layer"
TURNS_AND_RUNS, OWN_RUNS = "restyled turns and runs", "own runs"
METHODS = (NONE, PAPER, NOISY_NONE, TURNS, MIDDLE_RUNS, TURNS_AND_RUNS, OWN_RUNS)
"""Methods in the order of the tables."""

SHOWN = ("legs", "arms", "trunk", "speed", "airborne", "contacts", "sliding", "recognised", "failed")
"""Measures of the second table."""


def runs_config(config: FoldConfig) -> FoldConfig:
    """Returns the settings with the folder in which judged runs are kept."""
    return replace(config, out=config.out / "runs")


def runs_of(fold: Fold) -> tuple[list[Take], list[Take]]:
    """Returns the runs of the held-out style: those of the bound, and every second one, which is judged."""
    runs = [take for take in fold.own if take.content == RUN]
    return runs[0::2], runs[1::2]


def judge_runs(fold: Fold, config: FoldConfig) -> None:
    """Judges all methods on the runs of one fold."""
    methods: dict[str, tuple[NetworkKind, Callable[[], Style]]] = {
        NONE: (WITHOUT, lambda: no_style(fold.network())),
        PAPER: (WITHOUT, lambda: learn_paper(fold)),
        NOISY_NONE: (NOISY, lambda: no_style(fold.network(NOISY))),
        TURNS: (NOISY, lambda: learn_restyled(fold, NOISY)),
        MIDDLE_RUNS: (NOISY, lambda: learn_restyled(fold, NOISY, MIDDLE, math.inf)),
        TURNS_AND_RUNS: (NOISY, lambda: learn_restyled(fold, NOISY, fastest=math.inf)),
        OWN_RUNS: (NOISY, lambda: learn_own_runs(fold, NOISY)),
    }
    files = {method: judged_file(runs_config(config), fold.style, fold.seed, method) for method in methods}
    if all(file.exists() for file in files.values()):
        return
    takes = fold.drivable(runs_of(fold)[1])
    for method, (kind, learn) in methods.items():
        judge_once(files[method], partial(_styled, fold, kind, learn), takes, fold.style, fold.everything.recogniser)


def _styled(fold: Fold, kind: NetworkKind, learn: Callable[[], Style]) -> StyledNetwork:
    return fold.styled(learn(), kind)


def learn_own_runs(fold: Fold, kind: NetworkKind) -> Style:
    """Returns an adapter of the clip and of the style's own runs but those it is judged on: a bound for all others."""
    network = fold.network(kind)
    runs = to_batch([rows_of(runs_of(fold)[0])], network.normaliser)
    adapter = AdapterConfig(RESTYLED_FEW_SHOT.method, RESTYLED_FEW_SHOT.rank)
    return learn_rows(fold, network, join_batches([clip_rows(fold, network), runs]), adapter=adapter)


def shown_table(results: Results) -> str:
    """Returns the measures of `SHOWN`, controller / loop, of every method (rows), means over its folds."""
    rows = []
    for method, found in results.items():
        means = [mean_measures([walks[way].means() for walks in found.values()]) for way in WAYS[::-1]]
        rows.append([method, *(" / ".join(f"{mean[name]:.2f}" for mean in means) for name in SHOWN)])
    return markdown_table(["controller / loop", *SHOWN], rows)


def main(config: FoldConfig) -> None:
    """Judges all methods on all folds, and writes their tables."""
    for fold in TurningFolds(config).folds():
        judge_runs(fold, config)
    results = load_results(runs_config(config), METHODS)
    text = "\n".join([distance_table(results, ends=(OWN_RUNS,)), shown_table(results)])
    write_whole(config.out / "walk_to_run.md", text)
    print(text)


if __name__ == "__main__":
    main(tyro.cli(FoldConfig, description=__doc__))
