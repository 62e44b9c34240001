"""Plots of losses and errors. Every function returns a Figure and leaves matplotlib's global state unchanged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.viewer.draw.drawing import blank_figure
from pfnn_jax.viewer.draw.palette import GRID, INK, MUTED, SERIES

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def _figure(width: float, height: float) -> Figure:
    figure = blank_figure(width, height)
    figure.set_layout_engine("constrained")
    return figure


def _style(axes: Axes, title: str = "", x: str = "", y: str = "") -> None:
    axes.set_title(title, loc="left", color=INK, fontsize=11, fontweight="bold")
    axes.set_xlabel(x, color=MUTED, fontsize=9)
    axes.set_ylabel(y, color=MUTED, fontsize=9)
    axes.tick_params(which="both", colors=MUTED, labelsize=8.5, length=0)
    axes.set_axisbelow(True)
    axes.grid(True, color=GRID, linewidth=0.8)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(GRID)


def loss_curves(
    curves: Mapping[str, Sequence[float] | tuple[Sequence[float], Sequence[float]]],
    title: str = "Loss",
    x_label: str = "step",
    logarithmic: bool = True,
) -> Figure:
    """Returns a figure of losses over training, one line per curve.

    Args:
        curves: name -> values, or (steps, values).
        title: title of the figure.
        x_label: label of the horizontal axis.
        logarithmic: whether the vertical axis is logarithmic.
    """
    figure = _figure(7.2, 3.6)
    axes = figure.subplots()
    _style(axes, title, x_label)
    for number, (name, curve) in enumerate(curves.items()):
        steps, values = curve if isinstance(curve, tuple) else (np.arange(len(curve)), curve)
        axes.plot(steps, values, color=SERIES[number % len(SERIES)], linewidth=1.8, label=name)
    if logarithmic:
        axes.set_yscale("log")
    if len(curves) > 1:
        axes.legend(frameon=False, fontsize=8.5, labelcolor=INK, ncols=1 + len(curves) // 6)
    return figure


def error_bars(
    table: Mapping[str, Mapping[str, float | Sequence[float]]], title: str = "Error", x_label: str = ""
) -> Figure:
    """Returns a figure of errors by method, as horizontal bars that leave room for long names of methods.

    Args:
        table: method -> measure -> value, or several values (seeds, clips): a bar shows their mean, dots the values.
        title: title of the figure.
        x_label: label of the horizontal axis, with the unit.
    """
    methods = list(table)
    measures = list(dict.fromkeys(measure for row in table.values() for measure in row))
    figure = _figure(7.2, 0.9 + 0.28 * len(methods) * max(1, len(measures)) * 0.8 + 0.12 * len(methods))
    axes = figure.subplots()
    _style(axes, title, x_label)
    axes.grid(False, axis="y")
    thickness = 0.8 / max(1, len(measures))
    for number, measure in enumerate(measures):
        place = np.arange(len(methods)) + (number - (len(measures) - 1) / 2) * thickness
        values = [np.atleast_1d(np.asarray(table[method].get(measure, np.nan), float)) for method in methods]
        means = np.array([value.mean() for value in values])
        colour = SERIES[number % len(SERIES)]
        axes.barh(place, means, thickness * 0.88, color=colour, alpha=0.85, label=measure)
        for y, value, mean in zip(place, values, means, strict=True):
            if len(value) > 1:
                axes.plot(value, np.full(len(value), y), "o", color=INK, markersize=2.6, alpha=0.55)
            if np.isfinite(mean):
                axes.annotate(f" {mean:.3g}", (value.max(), y), va="center", fontsize=8, color=INK)
    axes.set_yticks(np.arange(len(methods)), methods, color=INK, fontsize=9)
    axes.invert_yaxis()
    axes.margins(x=0.12)
    if len(measures) > 1:
        axes.legend(frameon=False, fontsize=8.5, labelcolor=INK, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=4)
    return figure
