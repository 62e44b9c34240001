"""Tables and figure of the public drive test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.common.markdown import markdown_table
from pfnn_jax.evaluation.drive_preset import PRESET_FPS, DrivePreset, preset_commands
from pfnn_jax.evaluation.drive_test import PARTS, SWAY_SECONDS
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


@dataclass(frozen=True, eq=False)
class Example:
    """What one style did.

    Attributes:
        style: name.
        paths: controller -> positions of the hips [T, 2] in metres, at any multiple of the preset's rate.
    """

    style: str
    paths: Mapping[str, np.ndarray]


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
        if "locked" not in kind:  # the lock of the feet does not change the way
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


def draw(rows: Sequence[Mapping[str, Any]], preset: DrivePreset, example: Example) -> Figure:
    """Returns the figure: commanded and walked way, commanded and walked heading, and the errors by style."""
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    (ground, errors), (heading, ratios) = figure.subplots(2, 2, width_ratios=(1.0, 1.1))
    _draw_ground(ground, preset, example)
    _draw_heading(heading, preset, example)
    _draw_errors(errors, rows, "error", "mean angle between commanded and walked heading, °")
    _draw_errors(ratios, rows, "published error", "trajectory error by CAMDM's formula, °", PUBLISHED_ERROR)
    for axes in (ground, heading, errors, ratios):
        axes.tick_params(colors=MUTED, labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_ground(axes: Axes, preset: DrivePreset, example: Example) -> None:
    wanted = preset_commands(preset, PRESET_FPS)[0].astype(float)
    length = np.linalg.norm(np.diff(next(iter(example.paths.values())), axis=0), axis=-1).sum()
    wanted = np.cumsum(wanted, axis=0) * length / np.linalg.norm(wanted, axis=-1).sum()
    axes.plot(-wanted[:, 0], wanted[:, 1], color=INK, linewidth=1.2, linestyle=":", label="commanded")
    for number, (name, path) in enumerate(example.paths.items()):
        axes.plot(-path[:, 0], path[:, 1], color=SERIES[number], linewidth=1.2, label=name)
    axes.set_aspect("equal")
    axes.set_title(f"The way of {example.style}, from above, m", loc="left", fontsize=10, color=INK)
    axes.legend(frameon=False, fontsize=8)


def _draw_heading(axes: Axes, preset: DrivePreset, example: Example) -> None:
    wanted, direction = preset_commands(preset, PRESET_FPS)
    seconds = np.arange(len(wanted)) / PRESET_FPS
    angle = np.where(is_travel(wanted), np.rad2deg(yaw_of(wanted)), np.nan)
    axes.plot(seconds, _gaps(np.rad2deg(yaw_of(direction))), color=MUTED, linewidth=0.9, label="facing, commanded")
    axes.plot(seconds, _gaps(angle), color=INK, linewidth=1.6, linestyle=":", label="heading, commanded")
    for number, (name, path) in enumerate(example.paths.items()):
        fps = len(path) / preset.seconds
        steps = np.diff(gaussian_filter(path, SWAY_SECONDS * fps), axis=0)
        time = np.arange(len(steps)) / fps
        axes.plot(time, _gaps(np.rad2deg(yaw_of(steps))), color=SERIES[number], linewidth=1.0, label=f"heading, {name}")
    axes.set(yticks=(-180, -90, 0, 90, 180), xlabel="seconds")
    axes.set_title("Angle from the first facing, °", loc="left", fontsize=10, color=INK)
    axes.legend(frameon=False, fontsize=7, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.16))


def _gaps(angle: np.ndarray) -> np.ndarray:
    """Returns angles [T] in degrees with NaN where a line would cross the plot from -180 to 180."""
    return np.where(np.abs(np.diff(angle, prepend=angle[:1])) > 180.0, np.nan, angle)


def _draw_errors(
    axes: Axes, rows: Sequence[Mapping[str, Any]], key: str, title: str, published: float | None = None
) -> None:
    """Draws the values of all styles of each run and controller, sorted."""
    number, runs = 0, list(dict.fromkeys(title for title, _, _ in groups(rows)))
    for name, kind, own in groups(rows):
        if "locked" in kind or not own:
            continue
        values, published_loop = np.sort([row[key] for row in own]), "published" in kind
        colour, share = SERIES[runs.index(name) % len(SERIES)], (np.arange(len(values)) + 0.5) / len(values)
        axes.plot(
            100 * share,
            values,
            "." if len(values) > 1 else "o",
            markersize=4,
            linestyle="--" if published_loop else "-",
            linewidth=0.9,
            color=colour,
            markerfacecolor="none" if published_loop else colour,
            label=f"{name}, {kind.split(',')[0]}",
        )
        number += 1
    if published is not None:
        axes.axhline(published, color=MUTED, linewidth=0.9, linestyle=":")
        axes.annotate("CAMDM, published", (0, published), fontsize=7, color=MUTED, va="bottom")
    axes.set(xlabel="styles, sorted, %", ylim=(0, None))
    axes.set_title(title, loc="left", fontsize=10, color=INK)
    axes.legend(frameon=False, fontsize=7)
