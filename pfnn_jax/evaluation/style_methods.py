"""Comparison of methods of learning a style from one adaptation clip, each with its grid (Mason 2018 §8.1)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from pfnn_jax.control.stability import make_stability_check, predictor_of
from pfnn_jax.evaluation.style_test import StyleTest, pose_and_velocity_error
from pfnn_jax.inference.rows import evaluate_rows
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.network import Network, config_of
from pfnn_jax.models.style import init_style
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.training.config import MASON2018_FEW_SHOT, FewShotConfig
from pfnn_jax.training.data import hold_out, to_batch
from pfnn_jax.training.few_shot_learning import Candidate, choose, error_without_style, refit, train_grid

CONSERVATIVE_ROW = "CP, most conservative within 50 %, refit"
"""The row of the most conservative CP candidate within the tolerance, refit on the clip: the best choice by held-out
frames of the clip alone."""

SEARCH = FewShotConfig(
    learning_rates=(1e-4, 1e-3),
    main_dropouts=(0.0, 0.3),
    adapter_dropouts=(0.3,),
    eval_epochs=(5, 10, 25, 50, 100),
    tolerance=0.5,
)
"""Settings of every kind of adapter, from which its row is chosen."""

GRIDS: dict[str, FewShotConfig] = {
    "CP": SEARCH,
    "CP, the paper's recipe": MASON2018_FEW_SHOT,
    "bias": replace(SEARCH, method="bias", learning_rates=(1e-3, 3e-3), main_dropouts=(0.0,)),
    "diagonal": replace(SEARCH, method="diagonal", learning_rates=(1e-3, 3e-3), main_dropouts=(0.0,)),
    "full": replace(SEARCH, method="full", main_dropouts=(0.0,), eval_epochs=(2, 5, 10, 25, 50)),
    "fine-tune, stopped early": replace(
        SEARCH,
        method="fine_tune",
        learning_rates=(1e-4,),
        main_dropouts=(0.3,),
        eval_epochs=(1, 2, 5, 10, 25, 50, 100),
    ),
    "from scratch": replace(
        SEARCH, method="scratch", learning_rates=(1e-3,), main_dropouts=(0.3,), eval_epochs=(10, 25, 50, 100)
    ),
}
"""Grids trained on the clip; the row of a grid is its candidate with the least error on the held-out frames."""

FIXED: dict[str, tuple[str, dict[str, float]]] = {
    "CP, 1e-4, dropout 0.3, 100 epochs": ("CP", {"learning_rate": 1e-4, "main_dropout": 0.3, "epochs": 100}),
    "CP, 1e-4, no dropout, 100 epochs": ("CP", {"learning_rate": 1e-4, "main_dropout": 0.0, "epochs": 100}),
    "fine-tune, 5 epochs": ("fine-tune, stopped early", {"epochs": 5}),
    "fine-tune, 25 epochs": ("fine-tune, stopped early", {"epochs": 25}),
    "fine-tune, 100 epochs": ("fine-tune, stopped early", {"epochs": 100}),
}
"""Rows at a setting fixed in advance, taken from the candidates of a grid."""

SAMPLE = 2000
"""Turning rows on which every candidate is evaluated."""


def compare_methods(
    shared: Network,
    normaliser: Normaliser,
    parts: Sequence[Features],
    test: StyleTest,
    *,
    grids: dict[str, FewShotConfig] = GRIDS,
    epochs: int = 100,
    seed: int = 0,
    on_row: Callable[[str], None] = lambda row: None,
) -> dict[str, dict[str, Any]]:
    """Trains every method on one clip and returns its chosen setting and its measures.

    Nothing is chosen on the test takes: settings and numbers of epochs are ranked by the error on the last part of the
    clip, and their rollouts on circles must be stable.

    Args:
        shared, normaliser: results of pretraining.
        parts: rows of the clip and, for a symmetric style, of its mirror image.
        test: takes that no method was trained on.
        grids: methods to run.
        epochs: longest training; later `eval_epochs` are dropped.
        seed: seed of every grid.
        on_row: called with the name of each grid once it is finished.

    Returns:
        row -> `measures`; a trained row also has `choice` and `stable`, and the row of a grid `grid_seconds` and all
        `candidates` with their error on turns, which shows afterwards how good the choice was.
    """
    clip = test.clip
    is_stable = make_stability_check(shared, normaliser, test.layout, clip.x, clip.y, clip.phase)
    rows: dict[str, dict[str, Any]] = {"no adapter": {"measures": test.measure(without_adapter(shared, normaliser))}}
    for name, grid in grids.items():
        started = time.perf_counter()
        grid = _shortened(grid, epochs, seed)
        candidates = train_on_clip(shared, normaliser, parts, grid)
        seconds = time.perf_counter() - started
        chosen = _rows_of(name, candidates, is_stable)
        if name == "CP":
            held = to_batch(hold_out(parts, grid.held_out)[1], normaliser)
            without = error_without_style(shared, held)
            choice = choose(candidates, grid.tolerance, is_stable, without=without).choice
            trained = refit(shared, to_batch(parts, normaliser), choice, grid)
            chosen[CONSERVATIVE_ROW] = Candidate(choice, trained)
        for row, candidate in chosen.items():
            rows[row] = {
                "choice": candidate.choice._asdict(),
                "stable": is_stable(candidate.trained),
                "measures": test.measure(predictor_of(candidate.trained, shared, normaliser)),
            }
        rows[name] |= {
            "grid_seconds": seconds,
            "candidates": candidate_errors(candidates, shared, normaliser, test),
        }
        on_row(name)
    return rows


def train_on_clip(
    shared: Network, normaliser: Normaliser, parts: Sequence[Features], grid: FewShotConfig
) -> list[Candidate]:
    """Trains all settings of a grid on the first part of the clip and ranks them, at every epoch, on the last part."""
    learn, held = hold_out(parts, grid.held_out)
    return train_grid(shared, to_batch(learn, normaliser), to_batch(held, normaliser), grid)


def without_adapter(shared: Network, normaliser: Normaliser):
    """Returns the style-agnostic predictor, with a zero adapter for the same tree structure as other predictors."""
    sizes = config_of(shared)
    zero = init_style(AdapterConfig("bias"), sizes, key=jax.random.key(0))
    return predictor_of(zero, shared, normaliser)


def candidate_errors(
    candidates: Sequence[Candidate], shared: Network, normaliser: Normaliser, test: StyleTest
) -> list[dict[str, float]]:
    """Returns the setting of every candidate and its error on evenly spaced rows of the turning takes."""
    truth = test.turning.rows
    rows = np.linspace(0, len(truth.x) - 1, SAMPLE).astype(int)
    result = []
    for candidate in candidates:
        predictor = predictor_of(candidate.trained, shared, normaliser)
        predicted = evaluate_rows(predictor, truth.x[rows], truth.phase[rows])
        error = pose_and_velocity_error(truth.y[rows], predicted, test.layout, test.std).mean()
        result.append({**candidate.choice._asdict(), "turning_error": float(error)})
    return result


def _shortened(grid: FewShotConfig, epochs: int, seed: int) -> FewShotConfig:
    eval_epochs = tuple(epoch for epoch in grid.eval_epochs if epoch <= epochs) or (epochs,)
    return replace(grid, eval_epochs=eval_epochs, seed=seed)


def _rows_of(name: str, candidates: list[Candidate], is_stable) -> dict[str, Candidate]:
    """Returns the rows of one grid: the chosen candidate, and those at a setting fixed in advance."""
    rows = {name: choose(candidates, 0.0, is_stable)}
    for row, (grid, setting) in FIXED.items():
        found = [c for c in candidates if all(np.isclose(c.choice._asdict()[k], v) for k, v in setting.items())]
        if grid == name and found:
            rows[row] = found[0]
    return rows
