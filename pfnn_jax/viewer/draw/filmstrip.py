"""Clips as one picture: poses along time from the side, contacts and phases below them, paths from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Annotation

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, cut_frames
from pfnn_jax.viewer.draw.drawing import blank_figure, draw_body, draw_strip, strip_height
from pfnn_jax.viewer.draw.palette import GRID, INK, MUTED, SIDES
from pfnn_jax.viewer.draw.scene import Scene, make_scene

TURN = np.deg2rad(62)  # from a body's front to its right, where the viewer stands
BODY, MAP, NAMES = 1.75, 1.9, 0.85  # inches: height of the bodies, width of the map, names of a time line's rows
STEP, LEAST = 1.12, 3  # inches from body to body, and for how many there is room at least
HEADROOM = 1.1  # of the highest body: height of the row
CLOSE, APART_BODIES = 0.78, 1.05  # of the widest body: least way to the next, where arms and legs may interlock or not
EDGE, TITLE, CAPTION, LABELS, APART = 0.2, 0.4, 0.27, 0.28, 0.22  # inches
TRAVELS = 0.5  # metres; a clip that stays in place needs no map


@dataclass(frozen=True, eq=False)
class _Row:
    annotated: AnnotatedClip
    scene: Scene
    frames: np.ndarray  # those drawn
    seconds: np.ndarray


def filmstrip(
    *clips: MotionClip | AnnotatedClip, moments: int = 8, title: str = "", span: tuple[int, int] | None = None
) -> Figure:
    """Clips at several moments, a row each: figures seen from the side, and where they are on the ground.

    Each figure is turned to its own heading, seen three quarters from its right, so that turns do not hide the pose.
    The picture at the right shows the root's path from above with the same numbers; it is left out where nobody
    travels. Tracks with contacts or phases have them below, each figure above its own moment.

    Args:
        clips: the motions. All rows have the same moments; shorter clips end earlier.
        moments: number of figures in the longest clip.
        title: title of the picture.
        span: first and last frame shown; the whole clips by default.

    Raises:
        ValueError: without clips, or fewer than one moment.
        InputError: if the span does not lie in every clip, or a clip cannot be shown.
    """
    if not clips or moments < 1:
        raise ValueError(f"A filmstrip needs a clip and a moment, got {len(clips)} and {moments}.")
    shown = [clip if isinstance(clip, AnnotatedClip) else AnnotatedClip("", clip) for clip in clips]
    if span is not None:
        shown = [cut_frames(annotated, span[0], span[1] + 1) for annotated in shown]
    longest = max(annotated.seconds for annotated in shown)
    times = np.linspace(0, longest, moments) if longest > 0 else np.zeros(1)
    rows = [_row(annotated, times) for annotated in shown]
    left = NAMES if any(strip_height(annotated) for annotated in shown) else EDGE
    wide = STEP * max(len(times), LEAST)
    with_map = any(np.ptp(row.scene.points[:, 0][:, [0, 2]], axis=0).max() > TRAVELS for row in rows)
    width = left + wide + (MAP + APART if with_map else 0) + EDGE
    height = (TITLE if title else EDGE / 2) + sum(_height(row.annotated) for row in rows)
    figure = blank_figure(width, height)
    top = height
    if title:
        figure.text(EDGE / width, 1 - 0.26 / height, title, color=INK, fontsize=11.5, fontweight="bold")
        top -= TITLE
    else:
        top -= EDGE / 2
    for row in rows:
        _draw_row(figure, row, times, top, left, wide, with_map)
        top -= _height(row.annotated)
    return figure


def _row(annotated: AnnotatedClip, times: np.ndarray) -> _Row:
    there = times[times <= annotated.seconds + 0.5 / annotated.clip.fps]
    frames = np.minimum(np.round(there * annotated.clip.fps).astype(int), annotated.clip.num_frames - 1)
    return _Row(annotated, make_scene(annotated.clip), frames, there)


def _height(annotated: AnnotatedClip) -> float:
    strip = strip_height(annotated)
    return (CAPTION if annotated.name else 0.0) + BODY + LABELS + (strip + 0.06 if strip else 0.0) + APART


def _draw_row(
    figure: Figure, row: _Row, times: np.ndarray, top: float, left: float, wide: float, with_map: bool
) -> None:
    width, height = figure.get_size_inches()
    span = (times[-1] - times[0]) or 1.0
    pad = span / max(1, len(times) - 1) / 2 if len(times) > 1 else 0.5

    def place(x: float, y: float, w: float, h: float) -> Axes:
        return figure.add_axes((x / width, y / height, w / width, h / height))

    if row.annotated.name:
        style = {"color": INK, "fontsize": 9.5, "fontweight": "bold", "va": "baseline"}
        caption = figure.text(EDGE / width, (top - 0.17) / height, row.annotated.name, **style)
        beside = {"xycoords": caption, "xytext": (9, 0), "textcoords": "offset points", "va": "bottom"}
        note = Annotation(row.annotated.note, (1, 0), **beside, fontsize=8.5, color=MUTED, annotation_clip=False)
        figure.add_artist(note)
        top -= CAPTION
    side = place(left, top - BODY - LABELS, wide, BODY + LABELS)
    _draw_bodies(side, row, (row.seconds - times[0] + pad) / (span + 2 * pad), wide)
    if with_map:
        _draw_path(place(left + wide + APART, top - BODY - LABELS, MAP, BODY + LABELS), row)
    if strip := strip_height(row.annotated):
        before = wide * pad / (span + 2 * pad)  # so that the rows' names stand beside their first second
        line = place(left + before, top - BODY - LABELS - strip - 0.06, wide - before, strip)
        draw_strip(line, row.annotated)
        line.vlines(row.seconds, *line.get_ylim(), color=INK, alpha=0.25, linewidth=0.8)
        line.set_xlim(times[0], times[0] + span + pad)
        line.set_xticks([])


def _draw_bodies(axes: Axes, row: _Row, across: np.ndarray, inches: float) -> None:
    """Bodies at their shares [N] of the way across axes of so many inches."""
    scene = row.scene
    views = []
    for frame in row.frames:
        points = scene.points[frame]
        views.append(to_view(points - points[0] * [1.0, 0.0, 1.0], float(scene.headings[frame])))
    radius = max(max(c.start_radius, c.end_radius) for c in scene.capsules)
    low, high = min(0.0, *(v[:, 1].min() for v in views)), max(v[:, 1].max() for v in views) + radius
    reach = max(np.ptp(v[:, 0]) for v in views) + 2 * radius
    known = row.annotated.clip.skeleton.roles is not None
    tall = max((high - low) * HEADROOM, (CLOSE if known else APART_BODIES) * reach * BODY / STEP, 1e-6)
    per_inch = tall / BODY
    wide = per_inch * inches
    axes.axhline(0.0, color=GRID, linewidth=1.2, zorder=0)
    for number, (view, share, second) in enumerate(zip(views, across, row.seconds, strict=True)):
        middle = (0.3 if known else 1.0) * (view[:, 0].min() + view[:, 0].max()) / 2  # partly that of arms held out
        draw_body(axes, view + [share * wide - middle, 0.0, 0.0], scene.capsules)
        text = axes.annotate(
            f"{number + 1}", (share * wide, low - 0.35 * LABELS * per_inch), ha="right", va="top", fontsize=8,
            color=INK, fontweight="bold", xytext=(-3, 0), textcoords="offset points",
        )  # fmt: skip
        axes.annotate(f"{second:.2f} s", text.xy, ha="left", va="top", fontsize=8, color=MUTED)
    axes.set_xlim(0, wide)
    axes.set_ylim(low - LABELS * per_inch, low + tall)
    axes.axis("off")


def to_view(points: np.ndarray, heading: float, turn: float = TURN) -> np.ndarray:
    """Points [P, 3] in the picture: across (ahead is right), up, towards the viewer, who stands at the figure's right.

    With `turn` 0 it would face the viewer, with 90 degrees it is seen exactly from its right.
    """
    yaw = heading - turn
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, z = points.T
    return np.stack([c * x - s * z, y, s * x + c * z], axis=-1)


def _laid_out(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Path [T, 2] and facing directions [T, 2] as on a page: seen from above, its longer way across."""
    path = scene.points[:, 0][:, [0, 2]] * [-1.0, 1.0]  # from above, with +Z up the page, +X lies to the left
    facing = np.stack([-np.sin(scene.headings), np.cos(scene.headings)], axis=-1)
    if np.ptp(path[:, 1]) > np.ptp(path[:, 0]):
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])  # clockwise, so that ahead becomes right
        path, facing = path @ quarter, facing @ quarter
    if path[-1, 0] < path[0, 0]:  # and it leads to the right, as the figures walk
        path, facing = -path, -facing
    return path, facing


def _draw_path(axes: Axes, row: _Row) -> None:
    """The path from above, a triangle pointing where the body faces at each moment, and a bar of one metre."""
    path, facing = _laid_out(row.scene)
    axes.plot(*path.T, color=SIDES["middle"], linewidth=1.5)
    knows = row.annotated.clip.skeleton.roles is not None
    for number, frame in enumerate(row.frames):
        angle = np.rad2deg(np.arctan2(-facing[frame, 0], facing[frame, 1]))
        marker = (3, 0, angle) if knows else "o"
        axes.plot(*path[frame], marker=marker, color=SIDES["left"], markersize=8, markeredgecolor="white")
        (x, y), (ahead_x, ahead_y) = path[frame].tolist(), facing[frame].tolist()
        axes.annotate(
            str(number + 1), (x, y), textcoords="offset points", xytext=(-9 * ahead_y, 9 * ahead_x), ha="center",
            va="center", fontsize=7.5, color=INK,
        )  # fmt: skip
    low, high = path.min(axis=0), path.max(axis=0)
    # equal scales, with room for triangles, numbers and the bar
    scale = max(*((high - low) / [MAP - 0.5, BODY + LABELS - 0.8]), 0.25)  # metres per inch
    (x, y), half = (low + high) / 2, scale * np.array([MAP, BODY + LABELS]) / 2
    axes.set_xlim(x - half[0], x + half[0])
    axes.set_ylim(y - half[1] - 0.1 * scale, y + half[1] - 0.1 * scale)
    metre = 10.0 ** np.floor(np.log10(scale * MAP * 0.8))
    left, bottom = x - half[0] + 0.1 * scale, y - half[1]
    axes.plot([left, left + metre], [bottom, bottom], color=INK, linewidth=2.0, solid_capstyle="butt")
    axes.annotate(f"{metre:g} m", (left, bottom), xytext=(0, 5), textcoords="offset points", fontsize=7.5, color=MUTED)
    axes.axis("off")
