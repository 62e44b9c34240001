"""Matplotlib drawing shared by pictures and videos: the body and its time line of contacts and phases.

Matplotlib is imported inside the functions that draw, so that importing the viewer costs nothing.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.io.files import write_whole
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.body import Capsule, capsule_ends
from pfnn_jax.viewer.draw.palette import MUTED, PANEL, PHASE, SIDES, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LIGHT = np.array([-0.5, 0.85])  # direction of the light on the page: from above left
SMALLER = np.linspace(0.0, 0.72, 9)  # nested outlines of a capsule: the fraction by which each is smaller
WHITE = np.interp(SMALLER, [0.3, 0.72], [0.0, 0.3])  # ... and its admixture of white
BLACK = np.interp(SMALLER, [0.0, 0.3], [0.22, 0.0])  # ... and of black
ARC = 11  # corners of each of an outline's two ends
FOOT_ROW, PHASE_ROW, BONE_ROW, ROW_GAP = 0.11, 0.3, 0.17, 0.035  # inches


def blank_figure(width: float, height: float) -> Figure:
    """Returns a white figure of a size in inches, without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def png_bytes(figure: Figure, dpi: int = 144) -> bytes:
    """Returns the figure as the bytes of a PNG file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, facecolor=figure.get_facecolor())
    return buffer.getvalue()


def save_figure(figure: Figure, path: str | Path, dpi: int = 144) -> None:
    """Writes the figure as a PNG file atomically.

    Raises:
        InputError: if it cannot be written.
    """
    write_whole(Path(path), png_bytes(figure, dpi))


def draw_body(axes: Axes, points: np.ndarray, capsules: Sequence[Capsule]) -> None:
    """Draws a body in parallel projection along its third coordinate.

    Args:
        axes: target, in metres.
        points: [P, 3] metres: across, up, and towards the viewer.
        capsules: from `body_capsules`.
    """
    from matplotlib.collections import PolyCollection

    starts, ends = all_ends(points, capsules)
    radii = radii_of(capsules)
    shapes, colours = body_shapes(starts[:, :2], ends[:, :2], radii, starts[:, 2] + ends[:, 2], tones(capsules))
    # not clipped: an outstretched arm may leave the axes
    axes.add_collection(PolyCollection(list(shapes), facecolors=colours, edgecolors="none", clip_on=False, zorder=2))


def all_ends(points: np.ndarray, capsules: Sequence[Capsule]) -> tuple[np.ndarray, np.ndarray]:
    """Returns the centres [..., C, 3] of the first and of the second ends of all capsules, from points [..., P, 3]."""
    ends = [capsule_ends(points, capsule) for capsule in capsules]
    return np.stack([a for a, _ in ends], axis=-2), np.stack([b for _, b in ends], axis=-2)


def radii_of(capsules: Sequence[Capsule]) -> np.ndarray:
    """Returns the radii [C, 2] of both ends in metres."""
    return np.array([(capsule.start_radius, capsule.end_radius) for capsule in capsules])


def tones(capsules: Sequence[Capsule]) -> np.ndarray:
    """Returns the colours [C, S, 3] in 0..1 of every capsule's nested outlines, from the dark rim to the light."""
    base = np.array([rgb(SIDES[capsule.side]) for capsule in capsules])[:, None] / 255.0
    return (base + WHITE[:, None] * (1.0 - base)) * (1.0 - BLACK[:, None])


def body_shapes(
    starts: np.ndarray, ends: np.ndarray, radii: np.ndarray, nearness: np.ndarray, colours: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the polygons of a body on the page, the farthest first.

    Every capsule is a dark outline with lighter ones nested inside it, shifted towards the light, so that it looks
    round.

    Args:
        starts: [C, 2] first ends on the page.
        ends: [C, 2] second ends.
        radii: [C, 2] on the page.
        nearness: [C] greater for nearer capsules.
        colours: [C, S, 3] from `tones`.

    Returns:
        (polygons [C * S, N, 2], colours [C * S, 3]).
    """
    order = np.argsort(nearness, kind="stable")
    starts, ends, radii = starts[order], ends[order], radii[order]
    along = ends - starts
    length = np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-9)
    along = along / length
    # lit from the side if the limb is long on the page, from the light's own direction if it points at the viewer
    seen = np.minimum(1.0, length / np.maximum(radii.sum(axis=-1, keepdims=True), 1e-9))
    towards = LIGHT - seen * np.sum(LIGHT * along, axis=-1, keepdims=True) * along
    inner = radii[:, None] * (1.0 - SMALLER[:, None])  # [C, S, 2]
    shift = radii[:, None] * SMALLER[:, None]
    a = starts[:, None] + shift[..., :1] * towards[:, None]
    b = ends[:, None] + shift[..., 1:] * towards[:, None]
    shapes = outlines(a, b, inner[..., 0], inner[..., 1])
    return shapes.reshape(-1, *shapes.shape[-2:]), colours[order].reshape(-1, 3)


def outlines(a: np.ndarray, b: np.ndarray, ra: np.ndarray, rb: np.ndarray) -> np.ndarray:
    """Returns the convex outlines [..., N, 2] of pairs of circles, counter-clockwise.

    Args:
        a, b: [..., 2] centres.
        ra, rb: [...] radii.
    """
    along = b - a
    length = np.maximum(np.linalg.norm(along, axis=-1), 1e-9)
    angle = np.arctan2(along[..., 1], along[..., 0])[..., None]
    spread = np.arccos(np.clip((ra - rb) / length, -1.0, 1.0))[..., None]  # where the tangents touch
    far = angle + spread * np.linspace(-1, 1, ARC)
    near = angle + spread + (2 * np.pi - 2 * spread) * np.linspace(0, 1, ARC)

    def circle(centre: np.ndarray, radius: np.ndarray, angles: np.ndarray) -> np.ndarray:
        return centre[..., None, :] + radius[..., None, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)

    return np.concatenate([circle(b, rb, far), circle(a, ra, near)], axis=-2)


def strip_height(annotated: AnnotatedClip) -> float:
    """Returns the height of a clip's time line in inches; zero if it has neither contacts nor phases."""
    heights = _row_heights(annotated)
    return sum(heights) + ROW_GAP * max(0, len(heights) - 1)


def _row_heights(annotated: AnnotatedClip) -> list[float]:
    lines = annotated.phase_lines()
    return [FOOT_ROW] * len(annotated.foot_bars()) + [PHASE_ROW if len(lines) == 1 else BONE_ROW] * len(lines)


def draw_strip(axes: Axes, annotated: AnnotatedClip) -> None:
    """Draws a clip's time line: a bar while a foot is down, and a line that rises from 0 to 2π in every cycle.

    Args:
        axes: `strip_height` inches high; its x axis is in seconds.
        annotated: the clip.
    """
    bars, lines = annotated.foot_bars(), annotated.phase_lines()
    fps, frames = annotated.clip.fps, annotated.clip.num_frames
    top = strip_height(annotated)
    axes.set_ylim(0, top)
    names = [*(f"{name} foot" for name, _ in bars), *(line.name for line in lines)]
    for row, (name, height) in enumerate(zip(names, _row_heights(annotated), strict=True)):
        top -= height
        # the background ends with the clip: nothing is known about the time after it
        axes.broken_barh([(0.0, frames / fps)], (top, height), color=PANEL, lw=0, zorder=0)
        scaled = height == PHASE_ROW
        _write_left(axes, name, top + height / 2, -14 if scaled else -6, 7.5)
        if scaled:
            _write_left(axes, "2π", top + 0.84 * height, -3, 6)
            _write_left(axes, "0", top + 0.16 * height, -3, 6)
        if row < len(bars):
            spans = [(first / fps, (past - first) / fps) for first, past in bars[row][1]]
            axes.broken_barh(spans, (top, height), facecolors=SIDES[bars[row][0]], linewidth=0, zorder=1)
        else:
            line = lines[row - len(bars)]
            draw_phase(axes, np.arange(frames) / fps, line.angle, line.weight, top, height)
        top -= ROW_GAP
    axes.set_yticks([])
    axes.set_frame_on(False)
    axes.tick_params(colors=MUTED, labelsize=7.5, length=0, pad=2)
    axes.xaxis.set_major_formatter(lambda second, _: f"{second:g} s")


def _write_left(axes: Axes, text: str, y: float, points: float, size: float) -> None:
    """Writes text that ends this many points from the left edge of the axes."""
    place = {"xytext": (points, 0), "textcoords": "offset points", "ha": "right", "va": "center"}
    axes.annotate(text, (0, y), xycoords=("axes fraction", "data"), fontsize=size, color=MUTED, **place)


def draw_phase(
    axes: Axes,
    seconds: np.ndarray,
    angle: np.ndarray,
    weight: np.ndarray,
    low: float,
    height: float,
    width: float = 1.5,
) -> None:
    """Draws a phase as a line that rises by `height` in every cycle, more transparent where the phase is weaker.

    Args:
        axes: target.
        seconds: [T].
        angle: [T] radians in [0, 2π), NaN in frames without a phase.
        weight: [T] in [0, 1].
        low: y of phase 0.
        height: of a cycle.
        width: of the line, points.
    """
    from matplotlib.collections import LineCollection

    points = np.stack([seconds, low + height * (0.06 + 0.88 * angle / (2 * np.pi))], axis=-1)
    with np.errstate(invalid="ignore"):
        whole = np.flatnonzero(np.abs(np.diff(angle)) < np.pi)
    colours = np.empty((len(whole), 4))
    colours[:, :3], colours[:, 3] = np.array(rgb(PHASE)) / 255.0, weight[whole]
    segments = np.stack([points[whole], points[whole + 1]], axis=1)
    axes.add_collection(LineCollection(list(segments), colors=colours, linewidths=width, capstyle="butt", zorder=1))
