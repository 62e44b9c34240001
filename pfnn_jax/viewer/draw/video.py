"""Clips as the frames of a video: the scene of the HTML player, drawn by matplotlib instead of a browser."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.body_picture import draw_body
from pfnn_jax.viewer.draw.camera import Camera
from pfnn_jax.viewer.draw.drawing import blank_figure, draw_strip, strip_height
from pfnn_jax.viewer.draw.palette import GROUND, INK, MUTED, PANEL, rgb
from pfnn_jax.viewer.draw.scene import make_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PER_ROW = 4
PANES = {1: (6.4, 4.2), 2: (4.4, 4.2), 3: (3.6, 3.8), 4: (3.0, 3.5)}  # size in inches, by the number of columns
EDGE, APART, CAPTION, NAMES, SECONDS, ABOVE_STRIP = 0.12, 0.16, 0.28, 0.75, 0.2, 0.08  # inches
WINDOW = 10.0  # seconds of a time line; for longer clips it shows the part around the present moment
REACH = 7  # number of the ground's lines in every direction
TRAIL, TRAIL_STEP = 20.0, 0.1  # seconds of the path drawn before and after the present, and between its points
PALE = 0.62  # fraction of the background colour in a clip that has ended
# WINDOW, REACH, TRAIL and the height of the rows are the same in player_scene.js and player_strip.js


class Video:
    """The frames of clips shown next to each other, in step.

    Args:
        clips: what to show; shorter ones hold their last frame and turn pale.
        fps: frames per second.
        dpi: pixels per inch; a video of one clip is about 6.6 inches wide.

    Raises:
        ValueError: without clips.
    """

    def __init__(self, clips: Sequence[AnnotatedClip], fps: float, dpi: int):
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        if not clips:
            raise ValueError("A video needs at least one clip.")
        columns = min(len(clips), PER_ROW)
        rows = math.ceil(len(clips) / columns)
        wide, high = PANES[columns]
        strip = max(strip_height(annotated) for annotated in clips)
        below = strip + SECONDS + ABOVE_STRIP if strip else 0.0
        row = CAPTION + high + below
        inches = (2 * EDGE + columns * wide + (columns - 1) * APART, 2 * EDGE + rows * row + (rows - 1) * APART)
        size = [2 * math.ceil(length * dpi / 2) for length in inches]  # even, as video needs
        self.fps, self.seconds = fps, max(annotated.seconds for annotated in clips)
        self.width, self.height = size
        figure = blank_figure(size[0] / dpi, size[1] / dpi)
        figure.set_dpi(dpi)
        self._canvas = FigureCanvasAgg(figure)
        self._panes: list[_Pane | _Strip] = []
        self._background = None
        for number, annotated in enumerate(clips):
            left = EDGE + (number % columns) * (wide + APART)
            top = inches[1] - EDGE - (number // columns) * (row + APART)
            box = np.array([left, top - CAPTION - high, wide, high]) / [*inches, *inches]
            self._panes.append(_Pane(figure.add_axes(tuple(box)), annotated, dpi))
            if strip_height(annotated):
                at = [left + NAMES, top - CAPTION - high - ABOVE_STRIP - strip_height(annotated)]
                box = np.array([*at, wide - NAMES, strip_height(annotated)]) / [*inches, *inches]
                self._panes.append(_Strip(figure.add_axes(tuple(box)), annotated, self.seconds))

    @property
    def num_frames(self) -> int:
        """Number of frames, from the start to the end of the longest clip."""
        return int(math.floor(self.seconds * self.fps + 1e-6)) + 1

    def frames(self) -> Iterator[np.ndarray]:
        """Yields every frame as bytes [height, width, 3]."""
        return (self.frame_at(number / self.fps) for number in range(self.num_frames))

    def frame_at(self, second: float) -> np.ndarray:
        """Returns the frame at a second as bytes [height, width, 3]."""
        if self._background is None:
            self._canvas.draw()  # what is the same in every frame
            self._background = self._canvas.copy_from_bbox(self._canvas.figure.bbox)
        self._canvas.restore_region(self._background)
        for pane in self._panes:
            pane.draw(second, self._canvas.get_renderer())
        picture = np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
        for pane in self._panes:
            if isinstance(pane, _Pane):
                pane.paint_body(second, picture)
        return picture


class _Pane:
    """One clip's scene, redrawn in pixels for every frame."""

    def __init__(self, axes: Axes, annotated: AnnotatedClip, dpi: int):
        from matplotlib.collections import LineCollection
        from matplotlib.patches import FancyBboxPatch

        self.scene, self.annotated, self.pixel = make_scene(annotated.clip, annotated.mesh), annotated, dpi / 100
        box, whole = axes.get_window_extent(), axes.figure.bbox
        self.size = (box.width, box.height)
        self.origin = (box.x0, whole.height - box.y0)
        self.frame = (math.ceil(box.x0), math.ceil(whole.height - box.y1), int(box.x1), int(whole.height - box.y0))
        axes.set_xlim(0, box.width)
        axes.set_ylim(0, box.height)
        axes.axis("off")
        axes.annotate(
            annotated.name, (0, 1), (2, 6), "axes fraction", "offset points", color=INK, fontsize=9.5, weight="bold"
        )
        if annotated.note:
            place = {"xycoords": axes.texts[0], "xytext": (8, 0), "textcoords": "offset points"}
            axes.annotate(annotated.note, (1, 0), **place, fontsize=8.5, color=MUTED, va="bottom")
        rounding = f"round,pad=0,rounding_size={8 * self.pixel}"
        panel = axes.add_patch(FancyBboxPatch((0, 0), *self.size, boxstyle=rounding, facecolor=PANEL, linewidth=0))
        self.grid = LineCollection([], linewidths=0.8)
        self.past = LineCollection([], linewidths=1.6, colors=[_rgba(INK, 0.55)])
        self.future = LineCollection([], linewidths=1.6, colors=[_rgba(INK, 0.18)])
        self.artists: list[Any] = [self.grid, self.past, self.future]
        for artist in self.artists:
            artist.set_animated(True)
            axes.add_artist(artist)
            artist.set_clip_path(panel)
        self.clock = axes.text(0.985, 0.025, "", transform=axes.transAxes, ha="right", color=MUTED, fontsize=8.5)
        self.clock.set_animated(True)
        self.artists.append(self.clock)

    def draw(self, time: float, renderer: Any) -> None:
        """Draws everything but the body, which `paint_body` paints over it."""
        scene = self.scene
        camera = scene.camera(scene.pose_at(time)[2], *self.size)
        ended = time > self.annotated.end
        self._draw_ground(camera)
        self._draw_trail(camera, int(min(time * scene.fps, scene.num_frames - 1)))
        self.clock.set_text(f"ended at {self.annotated.seconds:.1f} s" if ended else f"{time:.1f} s")
        for artist in self.artists:
            artist.draw(renderer)

    def paint_body(self, time: float, picture: np.ndarray) -> None:
        """Paints the body and its shadow onto a picture [height, width, 3] of bytes of the whole video."""
        positions, rotations, focus = self.scene.pose_at(time)
        pale = _rgba(PANEL, PALE if time > self.annotated.end else 0.0)
        camera, tall = self.scene.camera(focus, *self.size), self.scene.tall
        for part in draw_body(
            self.scene.mesh, positions, rotations, camera, self.origin, self.frame, pale=pale, shadow=tall
        ):
            part.paint_on(picture)

    def _draw_ground(self, camera: Camera) -> None:
        step = 1.0 if 0.3 <= self.scene.tall <= 3 else 10.0 ** round(math.log10(self.scene.tall))
        centre = np.round(camera.target[[0, 2]] / step)
        i, j = np.meshgrid(np.arange(-REACH, REACH + 1), np.arange(-REACH, REACH), indexing="ij")
        one = np.stack([i, j], axis=-1).reshape(-1, 2)
        starts = np.concatenate([one, one[:, ::-1]])
        ends = starts + np.repeat([[0, 1], [1, 0]], len(one), axis=0)
        away = np.linalg.norm((starts + ends) / 2 + centre - camera.target[[0, 2]] / step, axis=-1)
        near = away < REACH
        lines = (np.stack([starts[near], ends[near]], axis=1) + centre) * step
        xy, size, _ = camera.project(np.stack([lines[..., 0], np.zeros(lines.shape[:-1]), lines[..., 1]], axis=-1))
        seen = np.isfinite(size).all(axis=1)
        colours = [_rgba(GROUND, alpha) for alpha in (1 - away[near] / REACH)[seen].tolist()]
        self.grid.set_segments(list(xy[seen]))
        self.grid.set_color(colours)

    def _draw_trail(self, camera: Camera, now: int) -> None:
        scene = self.scene
        reach, step = round(TRAIL * scene.fps), max(1, round(TRAIL_STEP * scene.fps))
        for lines, first, last in (
            (self.past, max(0, now - reach), now),
            (self.future, now, min(scene.num_frames - 1, now + reach)),
        ):
            frames = np.unique([*range(first, last, step), last])
            xy, size, _ = camera.project(scene.focus[frames] * [1.0, 0.0, 1.0])
            lines.set_segments([xy[np.isfinite(size)]])


class _Strip:
    """One clip's time line with a cursor at the present moment; in a long video it scrolls."""

    def __init__(self, axes: Axes, annotated: AnnotatedClip, seconds: float):
        self.axes, self.seconds = axes, seconds
        draw_strip(axes, annotated)
        self.cursor = axes.axvline(0.0, color=INK, linewidth=1.3, zorder=3)
        self.moves = seconds > WINDOW
        axes.set_xlim(0, min(seconds, WINDOW) or 1.0)
        (axes if self.moves else self.cursor).set_animated(True)

    def draw(self, time: float, renderer: Any) -> None:
        self.cursor.set_xdata([time, time])
        if not self.moves:
            self.cursor.draw(renderer)
            return
        first = max(0.0, min(time - WINDOW / 2, self.seconds - WINDOW))
        self.axes.set_xlim(first, first + WINDOW)
        self.axes.draw(renderer)


def _rgba(colour: str, opacity: float = 1.0) -> tuple[float, float, float, float]:
    """Returns a colour like `#3b7ae6` in 0..1, as matplotlib takes it."""
    red, green, blue = rgb(colour)
    return red / 255.0, green / 255.0, blue / 255.0, opacity
