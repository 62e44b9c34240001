"""Pictures of training, errors and motion. Every function returns a Figure and leaves matplotlib's state alone."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.files import write_whole
from pfnn_jax.viewer.body import Capsule, body_capsules, body_points, capsule_ends

INK, MUTED, GRID = "#1f2733", "#6b7685", "#dfe4ea"
SERIES = ("#2f6fde", "#e0662f", "#2f9e77", "#9a5bd0", "#c2892b", "#d04a78", "#4aa3c4", "#7a8699", "#5b7f2b", "#a0522d")
SIDES = {"left": "#2f6fde", "right": "#e0662f", "middle": "#8a94a3"}
"""Colours of the body: left limbs blue, right limbs orange, trunk grey."""


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
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


def png_bytes(figure: Figure, dpi: int = 144) -> bytes:
    """The figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, facecolor=figure.get_facecolor())
    return buffer.getvalue()


def save_figure(figure: Figure, path: str | Path, dpi: int = 144) -> None:
    """Write the figure as a PNG file, whole or not at all.

    Raises:
        InputError: if it cannot be written.
    """
    write_whole(Path(path), png_bytes(figure, dpi))


def loss_curves(
    curves: Mapping[str, Sequence[float] | tuple[Sequence[float], Sequence[float]]],
    title: str = "Loss",
    x_label: str = "step",
    logarithmic: bool = True,
) -> Figure:
    """Losses over training, one line each, its name beside its end.

    Args:
        curves: name -> values, or (steps, values).
        title: title of the picture.
        x_label: what the horizontal axis counts.
        logarithmic: whether the losses are drawn on a logarithmic axis.
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
    """Errors by method, as horizontal bars grouped by measure, so that long names of methods can be read.

    Args:
        table: method -> measure -> value, or several values (seeds, clips): the bar is their mean, dots show each.
        title: title of the picture.
        x_label: what the bars measure, with its unit.
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


def filmstrip(clip: MotionClip, moments: int = 8, title: str = "", span: tuple[int, int] | None = None) -> Figure:
    """A clip at several moments: figures seen from the side above, and where they are on the ground below.

    Each figure is turned to its own heading, seen three quarters from its right, so that turns do not hide the pose;
    the lower picture shows the root's path from above with the same numbers.

    Args:
        clip: the motion.
        moments: number of figures.
        title: title of the picture.
        span: first and last frame shown; the whole clip by default.
    """
    first, last = span if span is not None else (0, clip.num_frames - 1)
    frames = np.unique(np.linspace(first, last, moments).round().astype(int))
    points, capsules = body_points(clip), body_capsules(clip.skeleton)
    heading = _headings(clip, points)
    tops = [max(end[..., 1].max() for end in capsule_ends(points[frames], c)) + c.end_radius for c in capsules]
    height = float(max(tops))
    spacing = 0.62 * height
    path = _laid_out(points[:, 0][:, [0, 2]], heading, first, last)
    width = 1.25 * len(frames) + 0.4
    drop = float(np.clip(0.9 * width * np.ptp(path[0][:, 1]) / max(np.ptp(path[0][:, 0]), 0.1), 0.45, 2.4))
    figure = _figure(width, 2.7 + drop)
    side, top = figure.subplots(2, 1, height_ratios=(2.7, drop))
    for number, frame in enumerate(frames):
        local = _to_view(points[frame] - [points[frame, 0, 0], 0, points[frame, 0, 2]], float(heading[frame]))
        draw_body(side, local + [spacing * number, 0, 0], capsules)
        label = f"{number + 1}   {(frame - first) / clip.fps:.2f} s"
        side.annotate(label, (spacing * number, -0.1 * height), ha="center", fontsize=8, color=MUTED)
    _finish_strip(side, height, spacing * (len(frames) - 1), title)
    _draw_path(top, *path, frames - first)
    return figure


def draw_body(axes: Axes, points: np.ndarray, capsules: Sequence[Capsule]) -> None:
    """Draw a body seen along its third coordinate.

    Args:
        axes: where to draw, in metres.
        points: [P, 3] metres: across, up, and towards the viewer.
        capsules: from `body_capsules`.
    """
    order = sorted(capsules, key=lambda c: float(points[c.start, 2] + points[c.end, 2]))
    ends = [capsule_ends(points[:, :2], c) for c in order]
    outlines = [_outline(a, b, c.start_radius, c.end_radius) for (a, b), c in zip(ends, order, strict=True)]
    colours = [SIDES[c.side] for c in order]
    edges = [colour if c.side == "middle" else "white" for c, colour in zip(order, colours, strict=True)]
    axes.add_collection(PolyCollection(outlines, facecolors=colours, edgecolors=edges, linewidths=0.6))


def _outline(a: np.ndarray, b: np.ndarray, ra: float, rb: float) -> np.ndarray:
    """Outline [24, 2] of a tapered capsule in the plane."""
    along = b - a
    angle = np.arctan2(along[1], along[0])
    far = angle + np.linspace(-np.pi / 2, np.pi / 2, 12)
    near = angle + np.linspace(np.pi / 2, 3 * np.pi / 2, 12)
    ends = [b + rb * np.stack([np.cos(far), np.sin(far)], -1), a + ra * np.stack([np.cos(near), np.sin(near)], -1)]
    return np.concatenate(ends)


def _headings(clip: MotionClip, points: np.ndarray) -> np.ndarray:
    """[T] radians: where the hips face, or zero where the skeleton's parts are unknown."""
    roles = clip.skeleton.roles
    if roles is None:
        return np.zeros(clip.num_frames)
    across = points[:, roles.left_hip] - points[:, roles.right_hip]
    across = across + points[:, roles.left_shoulder] - points[:, roles.right_shoulder]
    return np.arctan2(-across[:, 2], across[:, 0])


def _to_view(points: np.ndarray, heading: float, turn: float = np.deg2rad(62)) -> np.ndarray:
    """Points [P, 3] in the picture: across (ahead is right), up, towards the viewer, who stands at the figure's right.

    With `turn` 0 it would face the viewer, with 90 degrees it is seen exactly from its right.
    """
    yaw = heading - turn
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = points.T
    return np.stack([c * x - s * z, y, s * x + c * z], axis=-1)


def _finish_strip(axes: Axes, height: float, width: float, title: str) -> None:
    axes.axhline(0.0, color=GRID, linewidth=1.2, zorder=0)
    axes.set_xlim(-0.5 * height, width + 0.55 * height)
    axes.set_ylim(-0.16 * height, 1.08 * height)
    axes.set_aspect("equal")
    axes.axis("off")
    axes.set_title(title, loc="left", color=INK, fontsize=11, fontweight="bold")


def _laid_out(root: np.ndarray, heading: np.ndarray, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
    """Path [T, 2] and facing directions [T, 2] as on a page: seen from above, its longer way across."""
    path = root[first : last + 1] * [-1.0, 1.0]  # from above, with +Z up the page, +X lies to the left
    facing = np.stack([-np.sin(heading), np.cos(heading)], axis=-1)[first : last + 1]
    if np.ptp(path[:, 1]) > np.ptp(path[:, 0]):
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])  # clockwise, so that ahead becomes right
        path, facing = path @ quarter, facing @ quarter
    if path[-1, 0] < path[0, 0]:  # and it leads to the right, as the figures walk
        path, facing = -path, -facing
    return path, facing


def _draw_path(axes: Axes, path: np.ndarray, facing: np.ndarray, frames: np.ndarray) -> None:
    """The path from above, a triangle pointing where the body faces at each frame, and a bar of one metre."""
    axes.plot(*path.T, color=SIDES["middle"], linewidth=1.5)
    for number, frame in enumerate(frames):
        angle = np.rad2deg(np.arctan2(-facing[frame, 0], facing[frame, 1]))
        axes.plot(*path[frame], marker=(3, 0, angle), color=SIDES["left"], markersize=9, markeredgecolor="white")
        (x, y), (ahead_x, ahead_y) = path[frame].tolist(), facing[frame].tolist()
        axes.annotate(
            str(number + 1), (x, y), textcoords="offset points", xytext=(-10 * ahead_y, 10 * ahead_x), ha="center",
            va="center", fontsize=8, color=INK,
        )  # fmt: skip
    left, low = path.min(axis=0) - [0.0, 0.45]
    axes.plot([left, left + 1.0], [low, low], color=INK, linewidth=2.0, solid_capstyle="butt")
    axes.annotate("1 m", (left + 1.1, low), va="center", fontsize=8, color=MUTED)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)
    axes.axis("off")
