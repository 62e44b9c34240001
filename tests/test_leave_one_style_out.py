"""The leave-one-style-out experiment on real data for two training steps: rows, measures, resuming, tables."""

from __future__ import annotations

import json

import numpy as np
import pytest

from experiments.common.leave_one_style_out_table import COLUMNS, compare_takes, pooled_choice
from experiments.common.style_takes import load_takes
from experiments.leave_one_style_out import Config, main, make_fold
from pfnn_jax.evaluation.style_methods import CONSERVATIVE_ROW, GRIDS

STYLES = ("elderly", "normal", "youthful")


@pytest.fixture(scope="module")
def config(mocap, tmp_path_factory) -> Config:
    folder = tmp_path_factory.mktemp("takes")
    for style in STYLES:
        for content in ("walk", "walk-turn-left"):
            for file in sorted((mocap / "bandai-namco-2").glob(f"dataset-2_{content}_{style}_*.bvh"))[:2]:
                (folder / file.name).symlink_to(file)
    return Config(
        data=folder,
        out=tmp_path_factory.mktemp("result"),
        styles=("elderly",),
        seeds=1,
        steps=2,
        batch_size=16,
        hidden=8,
        epochs=1,
        circle_seconds=2,
    )


def test_adaptation_clip_and_test_takes_are_disjoint(config):
    takes, layout, skeleton = load_takes(config.data)
    fold = make_fold(takes, "elderly", 1, layout, skeleton, np.ones(layout.output_size), config)
    names = (*fold.test.straight.names, *fold.test.turning.names)
    walks = [take.name for take in takes if take.style == "elderly" and take.content == "walk"]
    assert len(fold.clip[0].x) <= config.seconds * layout.fps
    assert walks[1] not in names and walks[0] in names
    assert all("turn" in name for name in fold.test.turning.names)


@pytest.mark.slow
def test_two_steps_give_every_row_and_measure(config):
    main(config)
    result = json.loads((config.out / "result.json").read_text())
    rows = {"no adapter", *GRIDS, CONSERVATIVE_ROW, "CP, pretrained on one style", "CP on its own turns (bound)"}
    assert set(result["rows"]) == rows
    for name, row in result["rows"].items():
        assert set(COLUMNS) <= set(row), name
        assert np.isfinite(row["turning"]), name
    assert "| CP |" in (config.out / "table.md").read_text()
    assert (config.out / "errors.png").stat().st_size > 10_000


@pytest.mark.slow
def test_finished_folds_are_not_run_again(config):
    (fold,) = config.out.glob("fold_*.json")
    before = fold.stat().st_mtime_ns
    main(config)
    assert fold.stat().st_mtime_ns == before


def synthetic_fold(style: str, errors: dict[str, float], reference: float) -> dict:
    candidates = [
        {"learning_rate": rate, "main_dropout": 0.0, "adapter_dropout": 0.3, "epochs": 5, "held_out_error": 1.0}
        | {"turning_error": error}
        for rate, error in ((1e-4, 2.0), (1e-3, 1.0))
    ]
    rows: dict[str, dict] = {
        name: {"measures": {"turning": {"per_take": {"a": error, "b": error}}}} for name, error in errors.items()
    }
    rows["CP"] = {
        "measures": {"turning": {"per_take": {"a": reference, "b": reference}}},
        "choice": {key: candidates[0][key] for key in candidates[0] if key != "turning_error"},
        "candidates": candidates,
    }
    return {"style": style, "seed": 0, "rows": rows}


def test_paired_comparison_is_the_ratio_of_errors_on_the_same_takes():
    folds = [synthetic_fold(style, {"bias": 0.5, "full": 4.0}, 1.0) for style in STYLES]
    assert compare_takes(folds, "bias") == {"worse": 0.0, "ratio": 0.5, "low": 0.5, "high": 0.5}
    assert compare_takes(folds, "full")["worse"] == 1.0


def test_pooled_setting_is_chosen_on_the_other_styles():
    found = pooled_choice([synthetic_fold(style, {}, 1.0) for style in STYLES])["CP"]
    assert found["turning"] == 1.0 == found["oracle"]
    assert found["held_out"] == 2.0
    assert found["setting"].startswith("lr 0.001")
