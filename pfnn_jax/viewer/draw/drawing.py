"""Matplotlib drawing shared by pictures and videos: figures, and time lines of contacts and phases.

Matplotlib is imported inside the functions that draw, so that importing the viewer costs nothing.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.io.files import write_whole
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.palette import MUTED, PANEL, PHASE, SIDES, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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


def place_picture(axes: Axes, picture: np.ndarray, left: float, top: float, scale: float) -> None:
    """Places a picture in axes, of which it may leave the edges, as an outstretched arm does.

    Args:
        axes: target, in metres.
        picture: [H, W, 4] in 0..1.
        left, top: of the picture's upper left corner, metres in the axes.
        scale: pixels of the picture per metre.
    """
    from matplotlib.image import AxesImage

    height, width = picture.shape[:2]
    extent = (left, left + width / scale, top - height / scale, top)
    image = AxesImage(axes, extent=extent, origin="upper", interpolation="antialiased", zorder=2)
    image.set_data(picture)
    axes.add_artist(image)
    image.set_clip_on(False)


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
