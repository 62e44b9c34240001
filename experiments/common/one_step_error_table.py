"""Tables and plots of `one_step_error`: means and standard deviations over seeds, and results by style."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from experiments.common.markdown import markdown_table
from pfnn_jax.evaluation.plots import error_bars
from pfnn_jax.io.files import write_whole
from pfnn_jax.viewer.draw.drawing import save_figure

COLUMNS: dict[str, tuple[tuple[str, ...], float]] = {
    "MSE": (("test", "mse"), 1.0),
    "trajectory": (("test", "trajectory"), 1.0),
    "pose": (("test", "pose"), 1.0),
    "velocity": (("test", "velocity"), 1.0),
    "contacts": (("test", "contacts"), 1.0),
    "bones, mm": (("test", "bones"), 1000.0),
    "BLL (Eq. 5b), mm": (("test", "bone_loss"), 1000.0),
    "MSE, training takes": (("train", "mse"), 1.0),
    "stable walks, %": (("rollouts", "sound"), 100.0),
    "finite, %": (("rollouts", "finite"), 100.0),
    "pose peak": (("rollouts", "pose_peak"), 1.0),
    "off path, m": (("rollouts", "path_error"), 1.0),
    "skating, cm/s": (("rollouts", "skating"), 100.0),
    "bones walking, mm": (("rollouts", "bones"), 1000.0),
    "recognised, %": (("rollouts", "recognition"), 100.0),
    "Fréchet": (("rollouts", "frechet"), 1.0),
    "training, s": (("train_seconds",), 1.0),
}
"""Columns of the table: the path to the number in a result, and a factor."""

Result = Mapping[str, Any]


def write_tables(out: Path, result: Result) -> None:
    """Writes `table.md`, `per_style.md` and the plots into `out`."""
    models = list(dict.fromkeys(entry["model"] for entry in result["models"].values()))
    if not models:
        return
    write_whole(out / "table.md", table(result, models))
    write_whole(out / "per_style.md", per_style(result, models))
    for column, file in (("MSE", "mse.png"), ("BLL (Eq. 5b), mm", "bones.png")):
        bars = {name: {column: values(result, name, column).tolist()} for name in models}
        save_figure(error_bars(bars, "Held-out takes, one step", column), out / file)
    seen = {
        name: {"recognised": (values(result, name, "recognised, %") / 100).tolist()}
        | {"stable walks": (values(result, name, "stable walks, %") / 100).tolist()}
        for name in models
    }
    save_figure(error_bars(seen, "Walks on circles", "share"), out / "walks.png")


def values(result: Result, model: str, column: str) -> np.ndarray:
    """Returns one column [seeds] of one model; NaN where it is not available."""
    path, scale = COLUMNS[column]
    found = []
    for entry in result["models"].values():
        if entry["model"] == model:
            value: Any = entry
            for key in path:
                value = value[key]
            found.append(np.nan if value is None else scale * value)
    return np.array(found, float)


def table(result: Result, models: list[str]) -> str:
    """Returns a table of mean ± standard deviation over seeds for all models; the last row is real motion."""
    rows = [[name, *(_spread(values(result, name, column)) for column in COLUMNS)] for name in models]
    real = result["real"]
    known = {
        "skating, cm/s": 100 * real["skating"],
        "recognised, %": 100 * real["recognition"],
        "Fréchet": real["frechet"],
    }
    rows.append(["real test takes", *(f"{known[c]:.3g}" if c in known else None for c in COLUMNS)])
    return markdown_table(["model", *COLUMNS], rows)


def per_style(result: Result, models: list[str]) -> str:
    """Returns a table of the error and recognition of every style by every model, means over seeds."""
    styles = result["data"]["styles"]
    rows = []
    for name in models:
        entries = [entry for entry in result["models"].values() if entry["model"] == name]
        errors = [np.mean([e["test"]["per_style"].get(s, np.nan) for e in entries]) for s in styles]
        rows.append([f"{name}, MSE", *(f"{error:.3f}" for error in errors)])
        shares = [[e["rollouts"]["per_style"][s]["recognition"] for e in entries] for s in styles]
        known = [[share for share in some if share is not None] for some in shares]
        rows.append([f"{name}, recognised", *(f"{np.mean(some):.2f}" if some else None for some in known)])
    return markdown_table(["", *styles], rows)


def _spread(found: np.ndarray) -> str | None:
    found = found[np.isfinite(found)]
    if not found.size:
        return None
    spread = f" ± {found.std(ddof=1):.2g}" if found.size > 1 else ""
    return f"{found.mean():.3g}{spread}"
