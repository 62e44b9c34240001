"""A figure of a clip's local phases: bodies, source functions, phases and contacts over time.

After Figure 4 of Mason et al. 2022.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.ground import facing_of, to_local
from pfnn_jax.motion.labels.local_phase import (
    END_EFFECTORS,
    EndEffectors,
    LocalPhaseConfig,
    PrincipalAxes,
    clip_local_phases,
    end_effectors,
    fit_axes,
    goes_by_contacts,
    smooth_sources,
    toe_contacts,
)
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.viewer.draw.body_picture import body_image
from pfnn_jax.viewer.draw.drawing import blank_figure, place_picture
from pfnn_jax.viewer.draw.palette import GRID, INK, MUTED, SERIES
from pfnn_jax.viewer.draw.scene import PERSON, make_scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PHASE, CONTACT, AXIS = SERIES[0], SERIES[2], SERIES[3]
LEFT, RIGHT, TOP, BODIES, PANEL, GAP, BOTTOM = 1.0, 0.55, 0.62, 2.0, 0.85, 0.12, 0.5  # inches
WIDTH = 11.0
DPI = 288  # of the bodies, twice that of the file
VIEW = np.deg2rad(62)  # angle of the view from the front, towards the right of the figure
ARROW = 0.2  # half the length of a principal axis's arrow, metres
REACH = 2.4  # limit of the vertical axis: normalised sources rarely exceed it (standard deviations)


@dataclass(frozen=True, eq=False)
class _Shown:
    """The signals of a clip, and the range of frames to draw, `first` to `last`."""

    clip: MotionClip
    ends: EndEffectors
    axes: PrincipalAxes
    sources: np.ndarray  # [T, 4] normalised and smoothed
    phases: np.ndarray  # [T, 4, 2]
    contacts: np.ndarray  # [T, 2] left, right
    by_contacts: np.ndarray  # [4] bool
    first: int
    last: int

    @property
    def seconds(self) -> np.ndarray:
        return np.arange(self.first, self.last + 1) / self.clip.fps

    def part(self, values: np.ndarray) -> np.ndarray:
        return values[self.first : self.last + 1]


def phase_plot(
    clip: MotionClip,
    *,
    axes: PrincipalAxes | None = None,
    config: LocalPhaseConfig | None = None,
    span: tuple[int, int] | None = None,
    moments: int = 8,
    title: str = "",
) -> Figure:
    """Returns a figure of the local phases of a clip's hands and toes.

    The top row shows the body at several moments, with the principal axes (violet arrows) of the bones whose source
    function is their movement. A panel for each bone shows its source function, normalised and smoothed (dark curve),
    its phase from 0 to 2π (blue, fading with the length of the phase vector), and for toes the contacts (green bars).
    A legend above the bodies explains the colours.

    Args:
        clip: the motion.
        axes: principal axes; fitted on the clip by default.
        config: thresholds of the contacts.
        span: first and last frame shown; the whole clip by default. Phases are always computed from the whole clip.
        moments: number of bodies.
        title: title of the figure.

    Raises:
        InputError: if the skeleton's roles are unknown.
    """
    shown = _shown(clip, axes, config, span)
    height = TOP + BODIES + 4 * (PANEL + GAP) + BOTTOM
    figure = blank_figure(WIDTH, height)
    inner = (WIDTH - LEFT - RIGHT) / WIDTH
    bodies = figure.add_axes((LEFT / WIDTH, 1 - (TOP + BODIES) / height, inner, BODIES / height))
    frames = np.unique(np.linspace(shown.first, shown.last, 2 * moments + 1).round().astype(int)[1::2])
    _draw_bodies(bodies, shown, frames)
    figure.text(LEFT / WIDTH, 1 - 0.3 / height, title, color=INK, fontsize=11, fontweight="bold")
    _draw_legend(figure, bool(shown.by_contacts.all()), (LEFT / WIDTH, 1 - 0.42 / height))
    for bone, name in enumerate(END_EFFECTORS):
        low = BOTTOM + (3 - bone) * (PANEL + GAP)
        panel = figure.add_axes((LEFT / WIDTH, low / height, inner, PANEL / height))
        _draw_bone(panel, shown, bone, frames)
        panel.set_ylabel(name, color=INK, fontsize=9, rotation=0, ha="right", va="center")
        panel.tick_params(labelbottom=bone == 3)
    panel.set_xlabel("seconds", color=MUTED, fontsize=9)
    return figure


def _shown(
    clip: MotionClip, axes: PrincipalAxes | None, config: LocalPhaseConfig | None, span: tuple[int, int] | None
) -> _Shown:
    ends = end_effectors(clip)
    axes = axes or fit_axes([ends])
    phases = clip_local_phases(ends, axes=axes, config=config)
    contacts = toe_contacts(ends, config)
    first, last = span if span is not None else (0, clip.num_frames - 1)
    return _Shown(
        clip, ends, axes, smooth_sources(ends, axes, config), phases, contacts[:, ::-1],
        goes_by_contacts(contacts), first, last,
    )  # fmt: skip


def _draw_bodies(axes: Axes, shown: _Shown, frames: np.ndarray) -> None:
    """Draws bodies above their moments on the time axis, in metres with the same scale on both axes."""
    scene = make_scene(shown.clip)
    scale = DPI * BODIES / (PERSON * scene.tall)
    images = [body_image(scene, frame, VIEW, scale) for frame in frames]
    ground = min(0.0, *(image.bottom for image in images))
    metres = 1.1 * (max(image.top for image in images) - ground)
    across = metres * (WIDTH - LEFT - RIGHT) / BODIES
    places = across * (frames - shown.first) / max(shown.last - shown.first, 1)
    hips = need_roles(shown.clip.skeleton).hips
    for frame, place, image in zip(frames, places, images, strict=True):
        place_picture(axes, image.colours, place + image.left, image.top, image.scale)
        _draw_axes(axes, shown, np.array([place, scene.positions[frame, hips, 1], 0.0]))
    axes.axhline(0.0, color=GRID, linewidth=1.2, zorder=0)
    axes.set_xlim(0.0, across)
    axes.set_ylim(ground - 0.03 * metres, ground + 0.97 * metres)
    axes.axis("off")


def _draw_legend(figure: Figure, no_axes: bool, corner: tuple[float, float]) -> None:
    """Draws a legend of the colours in one row that starts at a corner."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    arrow = Line2D([], [], color=AXIS, linewidth=1.4, marker=">", markersize=5, label="axis of movement")
    lines = [
        Line2D([], [], color=INK, linewidth=1.3, label="movement along the axis, or contacts, smoothed"),
        Line2D([], [], color=PHASE, linewidth=2.4, label="phase, fading where the motion is less cyclic"),
        Patch(facecolor=CONTACT, alpha=0.85, label="toe on the ground"),
    ]
    style = {"frameon": False, "fontsize": 8, "labelcolor": MUTED, "borderaxespad": 0, "columnspacing": 1.4}
    handles = lines if no_axes else [arrow, *lines]
    figure.legend(handles=handles, loc="upper left", bbox_to_anchor=corner, ncols=len(handles), **style)


def _draw_axes(axes: Axes, shown: _Shown, hips: np.ndarray) -> None:
    free = ~shown.by_contacts
    turned = to_local(np.stack([shown.axes.means[free], shown.axes.directions[free]]), facing_of(-VIEW))
    for mean, direction in zip(*turned, strict=True):
        start, end = hips + mean - ARROW * direction, hips + mean + ARROW * direction
        style = {"arrowstyle": "-|>", "color": AXIS, "linewidth": 1.4, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=style)


def _draw_bone(axes: Axes, shown: _Shown, bone: int, frames: np.ndarray) -> None:
    seconds = shown.seconds
    axes.vlines(frames / shown.clip.fps, -REACH, REACH, color=GRID, linewidth=0.8)
    if bone >= 2:
        _draw_contacts(axes, seconds, shown.part(shown.contacts)[:, bone - 2])
    _draw_phase(axes, seconds, shown.part(shown.phases)[:, bone], np.linalg.norm(shown.phases[:, bone], axis=-1).max())
    axes.plot(seconds, shown.part(shown.sources)[:, bone], color=INK, linewidth=1.3)
    axes.set_xlim(seconds[0], seconds[-1] if len(seconds) > 1 else seconds[0] + 1 / shown.clip.fps)
    axes.set_ylim(-REACH, REACH)
    axes.set_yticks([])
    right = axes.twinx()
    right.set_ylim(0, 2 * np.pi)
    right.set_yticks([0, np.pi, 2 * np.pi], ["0", "π", "2π"])
    for each in (axes, right):
        each.tick_params(colors=MUTED, labelsize=8, length=0)
        each.set_frame_on(False)
    right.tick_params(axis="y", colors=PHASE)


def _draw_phase(axes: Axes, seconds: np.ndarray, phases: np.ndarray, longest: float) -> None:
    """Draws the phase as a line that breaks at the end of a cycle and fades where the phase vector is short."""
    from matplotlib.collections import LineCollection
    from matplotlib.colors import to_rgb

    angle = np.arctan2(phases[:, 0], phases[:, 1]) % (2 * np.pi)
    length = np.linalg.norm(phases, axis=-1) / max(longest, 1e-9)
    points = np.stack([seconds, (angle / np.pi - 1) * REACH], axis=-1)
    whole = np.flatnonzero(np.abs(np.diff(angle)) < np.pi)
    colours = np.empty((len(whole), 4))
    colours[:, :3], colours[:, 3] = to_rgb(PHASE), length[whole]
    segments = [points[i : i + 2] for i in whole]
    axes.add_collection(LineCollection(segments, colors=colours, linewidths=2.4, capstyle="butt"))


def _draw_contacts(axes: Axes, seconds: np.ndarray, contact: np.ndarray) -> None:
    edges = np.diff(np.concatenate([[False], contact, [False]]).astype(int))
    step = seconds[1] - seconds[0] if len(seconds) > 1 else 1.0
    bars = [
        (seconds[start], (stop - start) * step)
        for start, stop in zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1), strict=True)
    ]
    axes.broken_barh(bars, (-REACH, 0.16 * 2 * REACH), facecolors=CONTACT, alpha=0.85, linewidth=0)
