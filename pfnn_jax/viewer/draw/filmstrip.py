"""Clips as one picture: poses along time from the side, contacts and phases below them, paths from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, Showable, as_clip, detect_phase
from pfnn_jax.viewer.draw.body_picture import body_image
from pfnn_jax.viewer.draw.drawing import blank_figure, draw_strip, place_picture, strip_height
from pfnn_jax.viewer.draw.palette import GRID, INK, MUTED, SIDES
from pfnn_jax.viewer.draw.scene import PERSON, Scene, make_scene
from pfnn_jax.viewer.draw.upright import upright

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TURN = np.deg2rad(62)  # from the body's front to its right, where the viewer is
BODY, MAP, NAMES = 1.75, 1.9, 0.85  # inches: height of the bodies, width of the map, names of a time line's rows
STEP, LEAST = 1.12, 3  # inches from body to body, and the least number of bodies there is room for
HEADROOM = 1.1  # height of the row, in heights of the highest body
CLOSE, APART_BODIES = 0.78, 1.05  # least distance to the next body, in widths of the widest: limbs may interlock or not
EDGE, TITLE, CAPTION, LABELS, APART = 0.2, 0.4, 0.27, 0.28, 0.22  # inches
TRAVELS = 0.5  # metres; a clip that travels less has no map
NUMBER_SIZE, NUMBER_AHEAD = 7.5, 9.0  # points: font size of the map's numbers, and their distance from the path

DPI = 288  # of the bodies, twice that of the file: they are drawn before the figure's own is known

SHORTEST_SPAN = 0.75  # of the longest clip: the moments of a picture cover at least this much
TRIED = 101  # spans that are compared
GOOD = 0.8  # of the best spread of phases: the longest span with this spread is taken


@dataclass(frozen=True, eq=False)
class _Row:
    """One clip of a filmstrip.

    Attributes:
        annotated: the clip.
        scene: its scene.
        frames: [N] frames that are drawn.
        seconds: [N] their moments.
    """

    annotated: AnnotatedClip
    scene: Scene
    frames: np.ndarray
    seconds: np.ndarray


def filmstrip(*clips: Showable, moments: int = 8, title: str = "", span: tuple[int, int] | None = None) -> Figure:
    """Draws clips at several moments, one row for each: bodies seen from the side, and their paths on the ground.

    Every body is turned to its own facing direction and seen from three quarters to its right, so that turns do not
    hide the pose. A map to the right shows the root's path from above with the numbers of the bodies; it is omitted if
    no clip travels. Annotated clips with contacts or phases have them below, each body above its own moment.

    Args:
        clips: clips, records with a clip, or paths of files. All rows have the same moments (`even_moments`);
            shorter clips end earlier.
        moments: number of bodies in the longest clip.
        title: title of the picture.
        span: first and last frame shown; by default the whole clips.

    Raises:
        ValueError: without clips, or for fewer than one moment.
        InputError: for anything that is not a clip, a file that cannot be read, a clip that cannot be shown, or a span
            that does not lie in every clip.
    """
    if not clips or moments < 1:
        raise ValueError(f"A filmstrip needs a clip and a moment, got {len(clips)} and {moments}.")
    shown = [_annotated(clip, number) for number, clip in enumerate(clips)]
    if span is not None:
        shown = [annotated.cut_frames(span[0], span[1] + 1) for annotated in shown]
    times = even_moments(shown, moments)
    rows = [_row(annotated, times) for annotated in shown]
    left = NAMES if any(strip_height(annotated) for annotated in shown) else EDGE
    wide = STEP * max(len(times), LEAST)
    with_map = any(np.ptp(row.scene.positions[:, 0][:, [0, 2]], axis=0).max() > TRAVELS for row in rows)
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


def even_moments(clips: Sequence[AnnotatedClip], moments: int) -> np.ndarray:
    """Returns evenly spaced seconds at which periodic motion shows different poses.

    Moments whose spacing is near a whole number of gait cycles would show the same pose again and again. The last
    moment is therefore moved forward, to a span over which the phases of all clips are nearly as evenly spread over
    the cycle as they can be; of several such spans the longest is taken. Phases are those of the clips, or found from
    their steps; without any phase the moments span the longest clip.

    Args:
        clips: the clips that share the moments.
        moments: how many.

    Returns:
        [N] seconds from 0, at least `SHORTEST_SPAN` of the longest clip; only 0 for clips of one frame.
    """
    longest = max(annotated.seconds for annotated in clips)
    if longest <= 0:
        return np.zeros(1)
    times = np.linspace(0, longest, moments)
    phases = [(annotated.clip.fps, _gait_phase(annotated)) for annotated in clips]
    shares = np.linspace(1.0, SHORTEST_SPAN, TRIED)
    spreads = np.array([min(_phase_spread(phase, fps, share * times) for fps, phase in phases) for share in shares])
    return shares[np.argmax(spreads >= GOOD * spreads.max())] * times


def _gait_phase(annotated: AnnotatedClip) -> np.ndarray:
    """Returns the phase [T] of the gait cycle in radians, NaN where it is unknown."""
    phase = annotated.phase
    if phase is None or phase.ndim != 1:  # local phases do not tell where in its cycle the whole body is
        phase = detect_phase(annotated.clip)
    return np.full(annotated.clip.num_frames, np.nan) if phase is None else phase


def _phase_spread(phase: np.ndarray, fps: float, times: np.ndarray) -> float:
    """Returns the least distance between phases at some moments, relative to evenly spread ones; 1 if unknown."""
    frames = np.round(times * fps).astype(int)
    angles = phase[frames[frames < len(phase)]]
    angles = np.sort(angles[np.isfinite(angles)] % (2 * np.pi))
    if len(angles) < 2:
        return 1.0
    gaps = np.diff(np.append(angles, angles[0] + 2 * np.pi))
    return float(gaps.min() * len(angles) / (2 * np.pi))


def _annotated(clip: Showable, number: int) -> AnnotatedClip:
    if isinstance(clip, AnnotatedClip):
        return clip
    motion = as_clip(clip, number)
    return AnnotatedClip("", motion if motion is clip else upright(motion))


def _row(annotated: AnnotatedClip, times: np.ndarray) -> _Row:
    there = times[times <= annotated.seconds + 0.5 / annotated.clip.fps]
    frames = np.minimum(np.round(there * annotated.clip.fps).astype(int), annotated.clip.num_frames - 1)
    return _Row(annotated, make_scene(annotated.clip, annotated.mesh), frames, there)


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
        _draw_caption(figure, row.annotated, top)
        top -= CAPTION
    side = place(left, top - BODY - LABELS, wide, BODY + LABELS)
    _draw_bodies(side, row, (row.seconds - times[0] + pad) / (span + 2 * pad), wide)
    if with_map:
        _draw_map(place(left + wide + APART, top - BODY - LABELS, MAP, BODY + LABELS), row)
    if strip := strip_height(row.annotated):
        before = wide * pad / (span + 2 * pad)  # so that the names of the rows end at second 0
        line = place(left + before, top - BODY - LABELS - strip - 0.06, wide - before, strip)
        draw_strip(line, row.annotated)
        line.vlines(row.seconds, *line.get_ylim(), color=INK, alpha=0.25, linewidth=0.8)
        line.set_xlim(times[0], times[0] + span + pad)
        line.set_xticks([])


def _draw_caption(figure: Figure, annotated: AnnotatedClip, top: float) -> None:
    from matplotlib.text import Annotation

    width, height = figure.get_size_inches()
    style = {"color": INK, "fontsize": 9.5, "fontweight": "bold", "va": "baseline"}
    caption = figure.text(EDGE / width, (top - 0.17) / height, annotated.name, **style)
    behind = {"xycoords": caption, "xytext": (9, 0), "textcoords": "offset points", "va": "bottom"}
    note = Annotation(annotated.note, (1, 0), **behind, fontsize=8.5, color=MUTED, annotation_clip=False)
    figure.add_artist(note)


def _draw_bodies(axes: Axes, row: _Row, across: np.ndarray, inches: float) -> None:
    """Draws the bodies at the fractions `across` [N] of the width of axes that are this many inches wide."""
    scene = row.scene
    scale = DPI * BODY / (PERSON * scene.tall)
    images = [body_image(scene, frame, TURN, scale) for frame in row.frames]
    low, high = min(0.0, *(image.bottom for image in images)), max(image.top for image in images)
    reach = max(image.right - image.left for image in images)
    known = row.annotated.clip.skeleton.roles is not None
    tall = max((high - low) * HEADROOM, (CLOSE if known else APART_BODIES) * reach * BODY / STEP, 1e-6)
    per_inch = tall / BODY
    wide = per_inch * inches
    axes.axhline(0.0, color=GRID, linewidth=1.2, zorder=0)
    for number, (image, share, second) in enumerate(zip(images, across, row.seconds, strict=True)):
        middle = (0.3 if known else 1.0) * (image.left + image.right) / 2  # partly that of spread arms
        place_picture(axes, image.colours, share * wide - middle + image.left, image.top, image.scale)
        text = axes.annotate(
            f"{number + 1}", (share * wide, low - 0.35 * LABELS * per_inch), ha="right", va="top", fontsize=8,
            color=INK, fontweight="bold", xytext=(-3, 0), textcoords="offset points",
        )  # fmt: skip
        axes.annotate(f"{second:.2f} s", text.xy, ha="left", va="top", fontsize=8, color=MUTED)
    axes.set_xlim(0, wide)
    axes.set_ylim(low - LABELS * per_inch, low + tall)
    axes.axis("off")


def _path_on_page(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Returns the path [T, 2] and the facing directions [T, 2] seen from above, the longer extent across the page."""
    path = scene.positions[:, 0][:, [0, 2]] * [-1.0, 1.0]  # from above, with +Z up the page, +X is to the left
    facing = np.stack([-np.sin(scene.facings), np.cos(scene.facings)], axis=-1)
    if np.ptp(path[:, 1]) > np.ptp(path[:, 0]):
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])  # clockwise, so that ahead becomes right
        path, facing = path @ quarter, facing @ quarter
    if path[-1, 0] < path[0, 0]:  # and it leads to the right, as the bodies walk
        path, facing = -path, -facing
    return path, facing


def _draw_map(axes: Axes, row: _Row) -> None:
    """Draws the path from above, a triangle pointing in the facing direction at each moment, and a scale bar."""
    path, facing = _path_on_page(row.scene)
    axes.plot(*path.T, color=SIDES["middle"], linewidth=1.5)
    known = row.annotated.clip.skeleton.roles is not None
    for frame in row.frames:
        angle = np.rad2deg(np.arctan2(-facing[frame, 0], facing[frame, 1]))
        marker = (3, 0, angle) if known else "o"
        axes.plot(*path[frame], marker=marker, color=SIDES["left"], markersize=8, markeredgecolor="white")
    low, high = path.min(axis=0), path.max(axis=0)
    # equal scales, with room for triangles, numbers and the bar
    scale = max(*((high - low) / [MAP - 0.5, BODY + LABELS - 0.8]), 0.25)  # metres per inch
    offsets = NUMBER_AHEAD * np.stack([-facing[row.frames, 1], facing[row.frames, 0]], axis=-1)
    for number in apart(path[row.frames] / scale * 72.0 + offsets):
        axes.annotate(
            str(number + 1), path[row.frames[number]].tolist(), textcoords="offset points",
            xytext=offsets[number].tolist(), ha="center", va="center", fontsize=NUMBER_SIZE, color=INK,
        )  # fmt: skip
    (x, y), half = (low + high) / 2, scale * np.array([MAP, BODY + LABELS]) / 2
    axes.set_xlim(x - half[0], x + half[0])
    axes.set_ylim(y - half[1] - 0.1 * scale, y + half[1] - 0.1 * scale)
    metre = 10.0 ** np.floor(np.log10(scale * MAP * 0.8))
    left, bottom = x - half[0] + 0.1 * scale, y - half[1]
    axes.plot([left, left + metre], [bottom, bottom], color=INK, linewidth=2.0, solid_capstyle="butt")
    axes.annotate(f"{metre:g} m", (left, bottom), xytext=(0, 5), textcoords="offset points", fontsize=7.5, color=MUTED)
    axes.axis("off")


def apart(centres: np.ndarray) -> list[int]:
    """Returns the numbers that can be written without overlap: the first, the last, then whatever fits in between.

    Args:
        centres: [N, 2] positions of the numbers 1 to N, points of the page.
    """
    kept: list[int] = []
    sizes = np.array([[0.66 * len(str(number + 1)), 1.0] for number in range(len(centres))]) * NUMBER_SIZE
    for number in sorted(range(len(centres)), key=lambda number: (number != 0, number != len(centres) - 1, number)):
        gaps = np.abs(centres[kept] - centres[number]) - (sizes[kept] + sizes[number]) / 2
        if (gaps > 0.0).any(axis=1).all():
            kept.append(number)
    return sorted(kept)
