"""Tables and plots of `leave_one_style_out`: means over styles and seeds, and comparisons paired by take."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from experiments.common.markdown import markdown_table
from pfnn_jax.evaluation.plots import error_bars
from pfnn_jax.viewer.draw.drawing import save_figure

REFERENCE = "CP"
"""The row to which the others are compared, paired by take."""

COLUMNS: dict[str, tuple[str, ...]] = {
    "straight": ("straight", "pose_velocity"),
    "turning": ("turning", "pose_velocity"),
    "turning above 20°/s": ("turning", "pose_velocity_turning"),
    "pose": ("turning", "pose"),
    "velocity": ("turning", "velocity"),
    "trajectory": ("turning", "trajectory"),
    "root": ("turning", "root"),
    "phase change": ("turning", "phase_change"),
    "locked rollout": ("locked",),
    "turn rate reached": ("turn_rate",),
    "nearest real turn, cm": ("nearest_turning_pose",),
    "skating, cm/s": ("skating",),
    "bones, mm": ("bone_error",),
}
SCALES = {"nearest real turn, cm": 100.0, "skating, cm/s": 100.0, "bones, mm": 1000.0}

Fold = Mapping[str, Any]


def write_summary(out: Path, folds: Sequence[Fold], config: Mapping[str, str]) -> None:
    """Writes `result.json`, `table.md` and the plots into `out`."""
    names = list(dict.fromkeys(name for fold in folds for name in fold["rows"]))
    rows = {name: _summary(folds, name) for name in names}
    paired = {name: compare_takes(folds, name) for name in names if name != REFERENCE}
    result = {
        "config": dict(config),
        "folds": [{key: fold[key] for key in fold if key != "rows"} for fold in folds],
        "rows": rows,
        "paired_with_cp": paired,
        "per_style": {name: _per_style(folds, name) for name in names},
        "choices": choices(folds),
        "pooled_choice": pooled_choice(folds),
    }
    (out / "result.json").write_text(json.dumps(result, indent=1))
    (out / "table.md").write_text(_markdown(rows, paired))
    errors = {name: {kind: _values(folds, name, COLUMNS[kind]) for kind in ("straight", "turning")} for name in names}
    table = {name: {kind: values.tolist() for kind, values in row.items()} for name, row in errors.items()}
    table.pop("from scratch", None)  # its error is ten times larger and would compress the other bars
    label = "normalised squared error on real takes; a dot for each style and seed"
    save_figure(error_bars(table, x_label=label), out / "errors.png")
    save_figure(held_out_against_turning(folds), out / "held_out_against_turning.png")


def _values(folds: Sequence[Fold], name: str, path: tuple[str, ...]) -> np.ndarray:
    """Returns one measure of one row over the folds that have it."""
    values = []
    for fold in folds:
        if name in fold["rows"]:
            value: Any = fold["rows"][name]["measures"]
            for key in path:
                value = value[key]
            values.append(np.nan if value is None else value)
    return np.array(values, float)


def _summary(folds: Sequence[Fold], name: str) -> dict[str, Any]:
    """Returns the mean over folds of every column, the standard deviation over seeds, and the share of stable walks."""
    found = {column: _values(folds, name, path) * SCALES.get(column, 1.0) for column, path in COLUMNS.items()}
    seeds = sorted({fold["seed"] for fold in folds})
    by_seed = [np.nanmean(_values([f for f in folds if f["seed"] == s], name, COLUMNS["turning"])) for s in seeds]
    stable = [fold["rows"][name]["stable"] for fold in folds if "stable" in fold["rows"].get(name, {})]
    return {
        **{column: float(np.nanmean(values)) for column, values in found.items()},
        "turning, spread over seeds": float(np.std(by_seed, ddof=1)) if len(seeds) > 1 else None,
        "folds": len(found["turning"]),
        "stable": sum(stable) / len(stable) if stable else None,
    }


def _per_style(folds: Sequence[Fold], name: str) -> dict[str, float]:
    """Returns the mean turning error of each style over its seeds."""
    styles = sorted({fold["style"] for fold in folds if name in fold["rows"]})
    return {
        style: float(np.mean(_values([f for f in folds if f["style"] == style], name, COLUMNS["turning"])))
        for style in styles
    }


def compare_takes(folds: Sequence[Fold], name: str) -> dict[str, float]:
    """Compares a row to `REFERENCE` on the same turning takes.

    Returns:
        `worse`: share of (take, seed) pairs on which the row's error is larger; `ratio`: geometric mean of the ratios
        of errors, with a 95 % interval over styles and seeds (bootstrap over folds, because takes of a fold correlate).
    """
    logs = []
    for fold in folds:
        if name in fold["rows"]:
            own, other = (fold["rows"][n]["measures"]["turning"]["per_take"] for n in (name, REFERENCE))
            logs.append(np.log([own[take] / other[take] for take in own]))
    means, rng = np.array([log.mean() for log in logs]), np.random.default_rng(0)
    draws = means[rng.integers(0, len(means), (2000, len(means)))].mean(axis=1)
    low, high = np.exp(np.quantile(draws, (0.025, 0.975)))
    return {
        "worse": float(np.mean(np.concatenate(logs) > 0)),
        "ratio": float(np.exp(means.mean())),
        "low": float(low),
        "high": float(high),
    }


def choices(folds: Sequence[Fold]) -> dict[str, dict[str, int]]:
    """Returns how often each setting was chosen on the held-out frames, by method."""
    counts: dict[str, dict[str, int]] = {}
    for fold in folds:
        for name, row in fold["rows"].items():
            if "choice" in row and "candidates" in row:
                key = _key(row["choice"])
                counts.setdefault(name, {})[key] = counts.setdefault(name, {}).get(key, 0) + 1
    return counts


def pooled_choice(folds: Sequence[Fold]) -> dict[str, dict[str, Any]]:
    """Evaluates one setting per method: chosen on the turns of the *other* styles, tested on the style's own turns.

    Returns:
        method -> `turning`: mean error of the setting that is best on the other styles; `setting`: the best setting
        over all styles; `held_out`: mean error, on the same rows, of the setting chosen on the held-out frames;
        `oracle`: mean error of the best setting of each fold.
    """
    result = {}
    for name in dict.fromkeys(name for fold in folds for name, row in fold["rows"].items() if "candidates" in row):
        own = [fold for fold in folds if "candidates" in fold["rows"].get(name, {})]
        tables = [{_key(c): c["turning_error"] for c in fold["rows"][name]["candidates"]} for fold in own]
        settings = sorted(set.intersection(*(set(table) for table in tables)))
        errors = np.array([[table[setting] for setting in settings] for table in tables])
        styles = np.array([fold["style"] for fold in own])
        pooled = []
        for row, style in enumerate(styles):
            others = errors[styles != style]
            pooled.append(errors[row, np.argmin((others if len(others) else errors).mean(axis=0))])
        chosen = [table[_key(fold["rows"][name]["choice"])] for fold, table in zip(own, tables, strict=True)]
        result[name] = {
            "turning": float(np.mean(pooled)),
            "setting": settings[int(np.argmin(errors.mean(axis=0)))],
            "held_out": float(np.mean(chosen)),
            "oracle": float(errors.min(axis=1).mean()),
        }
    return result


def _key(choice: Mapping[str, float]) -> str:
    return (
        f"lr {choice['learning_rate']:g}, dropout {choice['main_dropout']:g}/{choice['adapter_dropout']:g}, "
        f"{choice['epochs']:g} epochs"
    )


def _markdown(rows: Mapping[str, Mapping[str, Any]], paired: Mapping[str, Mapping[str, float]]) -> str:
    head = ["method", *COLUMNS, "± seeds", "turning, ratio to CP", "takes worse than CP"]
    lines = []
    for name, row in rows.items():
        spread = row["turning, spread over seeds"]
        pair = paired.get(name)
        cells = [name, *(f"{row[column]:.3f}" for column in COLUMNS), None if spread is None else f"{spread:.3f}"]
        cells.append(None if pair is None else f"{pair['ratio']:.2f} ({pair['low']:.2f}-{pair['high']:.2f})")
        cells.append(None if pair is None else f"{100 * pair['worse']:.0f} %")
        lines.append(cells)
    return markdown_table(head, lines)


def held_out_against_turning(folds: Sequence[Fold]) -> Figure:
    """Plots the held-out error of every candidate against its error on turns, relative to the network without adapter.

    A cloud that rises to the left means that the settings with the least held-out errors have the largest errors on
    turns.
    """
    figure = Figure(figsize=(7.2, 4.6), layout="constrained")
    axes = figure.subplots()
    names = dict.fromkeys(name for fold in folds for name, row in fold["rows"].items() if "candidates" in row)
    for name in names:
        points = []
        for fold in folds:
            none = fold["rows"]["no adapter"]["measures"]["turning"]["pose_velocity"]
            for c in fold["rows"].get(name, {}).get("candidates", ()):
                points.append((c["held_out_error"], c["turning_error"] / none))
        x, y = np.array(points).T
        axes.plot(x, y, "o", markersize=2.5, alpha=0.6, label=name)
    axes.axhline(1.0, color="0.6", linewidth=0.8)
    axes.set(
        xscale="log", yscale="log", xlabel="error on the clip's held-out frames", ylabel="turning error / no adapter"
    )
    axes.legend(frameon=False, fontsize=8)
    return figure
