"""Tables and figure of the public drive test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.markdown import markdown_table
from pfnn_jax.evaluation.actor_test import SWAY_SECONDS
from pfnn_jax.evaluation.drive_preset import PRESET_FPS, DrivePreset, preset_commands
from pfnn_jax.evaluation.drive_test import PARTS
from pfnn_jax.evaluation.heading_metrics import is_travel
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.ground import yaw_of
from pfnn_jax.viewer.draw.palette import INK, MUTED, SERIES

PUBLISHED_SLIDING, PUBLISHED_ERROR = 0.685, 22.8
"""CAMDM's foot sliding, and its trajectory error in degrees, over 100 styles."""

SUMMARY = {
    "sliding": ("sliding (CAMDM)", 2),
    "counted": ("of it counted, %", 1),
    "contact sliding": ("sliding in contact", 3),
    "published error": ("error (CAMDM), °", 1),
    "turned": ("same, world turned by 90°", 1),
    "error": ("angle, °", 1),
    "speed": ("speed reached", 2),
    "time scale": ("time scale", 2),
}
"""Measures of the first table: titles and digits."""

CAUSES = {
    "error": "angle",
    "without sway": "without sway",
    "lag": "lag, s",
    "without lag": "without lag",
    "changing": "second after a change",
    "settled": "later",
    **{name: f"later: {name}" for name in PARTS},
    **{f"facing {name}": f"facing: {name}" for name in PARTS},
}
"""Measures of the second table, in degrees."""


def summary_table(result: Mapping[str, Any]) -> str:
    """Returns the table of sliding and errors: means over styles, ± their standard deviation for the two angles."""
    head = ["run (styles)", "controller", *(title for title, _ in SUMMARY.values())]
    blank = dict.fromkeys(SUMMARY)
    published = blank | {"sliding": PUBLISHED_SLIDING, "published error": PUBLISHED_ERROR}
    lines = [["CAMDM, as published (100)", "", *published.values()]]
    for name, point in result["points"].items():
        lines.append([name, "", *(_number(point.get(key), digits) for key, (_, digits) in SUMMARY.items())])
    for title, kind, rows in groups(result["rows"]):
        lines.append([title, kind, *(_cell(rows, key, digits) for key, (_, digits) in SUMMARY.items())])
    return markdown_table(head, lines)


def cause_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Returns the table of what the angle between commanded and walked heading is made of."""
    lines = []
    for title, kind, own in groups(rows):
        if "locked" not in kind:  # the lock of the feet does not change the path
            lines.append([title, kind.split(",")[0], *(_cell(own, key, 2 if key == "lag" else 1) for key in CAUSES)])
    return markdown_table(["run (styles)", "controller", *CAUSES.values()], lines)


def groups(rows: Sequence[Mapping[str, Any]]) -> list[tuple[str, str, list[Mapping[str, Any]]]]:
    """Returns (title, controller, rows) of every run, its pretrained and its learned styles, that did not diverge."""
    found = []
    for run, learned in dict.fromkeys((row["run"], row["learned"]) for row in rows):
        own = [row for row in rows if (row["run"], row["learned"]) == (run, learned)]
        for kind in dict.fromkeys(row["controller"] for row in own):
            part = [row for row in own if row["controller"] == kind]
            finite = [row for row in part if row["finite"]]
            count = str(len(part)) if len(finite) == len(part) else f"{len(finite)} of {len(part)} finite"
            found.append((f"{run}, {'few-shot' if learned else 'pretrained'} ({count})", kind, finite))
    return found


def _cell(rows: Sequence[Mapping[str, Any]], key: str, digits: int) -> str:
    values = np.array([row[key] for row in rows], float)
    values = values[np.isfinite(values)] * (100.0 if key == "counted" else 1.0)
    if not len(values):
        return "–"
    spread = f" ± {values.std():.{digits}f}" if key in ("published error", "error") and len(values) > 1 else ""
    return f"{values.mean():.{digits}f}{spread}"


def _number(value: float | None, digits: int) -> str | None:
    return None if value is None else f"{value:.{digits}f}"


def draw(result: Mapping[str, Any], preset: DrivePreset) -> Figure:
    """Returns the figure: the commanded and the walked heading and path of one style, and the errors of all."""
    figure = Figure(figsize=(11.0, 8.0), layout="constrained")
    axes = figure.subplot_mosaic([["heading"] * 3, ["paths", "angle", "published"]], height_ratios=(1.0, 1.15))
    example = result["example"]["style"], {kind: np.array(p) for kind, p in result["example"]["paths"].items()}
    _draw_heading(axes["heading"], preset, *example)
    _draw_paths(axes["paths"], preset, *example)
    _draw_errors(axes["angle"], result["rows"], "error", "Angle between headings, °")
    _draw_errors(axes["published"], result["rows"], "published error", "Error by CAMDM's formula, °", PUBLISHED_ERROR)
    for axis in axes.values():
        axis.tick_params(colors=MUTED, labelsize=8)
        axis.spines[["top", "right"]].set_visible(False)
    handles, labels = axes["angle"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False, fontsize=8)
    return figure


def _draw_heading(axes: Axes, preset: DrivePreset, style: str, paths: Mapping[str, np.ndarray]) -> None:
    wanted, direction = preset_commands(preset, PRESET_FPS)
    seconds = np.arange(len(wanted)) / PRESET_FPS
    heading = np.where(is_travel(wanted), np.rad2deg(yaw_of(wanted)), np.nan)
    axes.plot(seconds, _gaps(np.rad2deg(yaw_of(direction))), color=MUTED, linewidth=0.9, label="commanded facing")
    axes.plot(seconds, _gaps(heading), color=INK, linewidth=2.0, linestyle=":", label="commanded heading")
    for number, (name, path) in enumerate(paths.items()):
        steps = np.diff(gaussian_filter(path, SWAY_SECONDS * PRESET_FPS), axis=0)
        walked = _gaps(np.rad2deg(yaw_of(steps)))
        axes.plot(seconds[: len(walked)], walked, color=SERIES[number], linewidth=1.2, label=f"walked, {name}")
    axes.set(yticks=(-180, -90, 0, 90, 180), xlim=(0, preset.seconds))
    axes.set_xlabel("seconds", color=MUTED, fontsize=8)
    axes.set_title(f"{style}: heading, ° from the first facing, left is positive", loc="left", fontsize=10, color=INK)
    axes.legend(frameon=False, fontsize=8, ncols=4, loc="upper left", bbox_to_anchor=(0.35, 1.14))


def _draw_paths(axes: Axes, preset: DrivePreset, style: str, paths: Mapping[str, np.ndarray]) -> None:
    """Draws the paths from above; the commanded one is as long as that of the first controller."""
    wanted = np.cumsum(preset_commands(preset, PRESET_FPS)[0].astype(float), axis=0)
    first = next(iter(paths.values()))
    length, commanded = (np.linalg.norm(np.diff(path, axis=0), axis=-1).sum() for path in (first, wanted))
    wanted *= length / commanded
    axes.plot(-wanted[:, 0], wanted[:, 1], color=INK, linewidth=2.0, linestyle=":")
    for number, path in enumerate(paths.values()):
        axes.plot(-path[:, 0], path[:, 1], color=SERIES[number], linewidth=1.2)
    shown = np.concatenate([wanted, first]) * [-1.0, 1.0]
    (left, low), (right, high) = shown.min(axis=0) - 1.0, shown.max(axis=0) + 1.0
    axes.set(xlim=(left, right), ylim=(low, high), aspect="equal")
    axes.set_title(f"{style}: path from above, m", loc="left", fontsize=10, color=INK)


def _gaps(angle: np.ndarray) -> np.ndarray:
    """Returns angles [T] in degrees with NaN where a line would cross the plot from -180 to 180."""
    return np.where(np.abs(np.diff(angle, prepend=angle[:1])) > 180.0, np.nan, angle)


def _draw_errors(
    axes: Axes, rows: Sequence[Mapping[str, Any]], key: str, title: str, published: float | None = None
) -> None:
    """Draws the values of all styles of each run, sorted; those of the published loop as open markers."""
    shown = [(name, kind, own) for name, kind, own in groups(rows) if "locked" not in kind and own]
    runs = list(dict.fromkeys(name for name, _, _ in shown))
    for name, kind, own in shown:
        values, loop, colour = np.sort([row[key] for row in own]), "published" in kind, SERIES[runs.index(name) + 2]
        place = 100 * (np.arange(len(values)) + 0.5) / len(values)
        face = "none" if loop else colour
        label = f"{name}, {kind.split(',')[0]}"
        axes.plot(place, values, "o", markersize=3, color=colour, markerfacecolor=face, label=label)
    if published is not None:
        axes.axhline(published, color=INK, linewidth=0.9, linestyle=":")
        axes.text(
            1.0,
            published,
            "CAMDM, published",
            fontsize=8,
            color=INK,
            ha="right",
            va="bottom",
            transform=axes.get_yaxis_transform(),
        )
    axes.set(ylim=(0, None))
    axes.set_xlabel("share of styles, %", color=MUTED, fontsize=8)
    axes.set_title(title, loc="left", fontsize=10, color=INK)
