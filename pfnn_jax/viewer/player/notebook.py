"""Motion that plays in a notebook: inline, without a server, also in the saved file and in its HTML export."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, Showable, annotate_clips
from pfnn_jax.viewer.player.player import player_page

SCENE_HEIGHT, STACKED_HEIGHT = 330, 250  # pixels of a scene with one row of clips, and with several
PER_ROW = 3
AROUND = 130  # pixels of captions, controls and margins


@dataclass(frozen=True, eq=False)
class Shown:
    """A player that a notebook displays; returned by `show`.

    Attributes:
        clips: the clips with their contacts and phases.
        height: pixels.
    """

    clips: Sequence[AnnotatedClip]
    height: int

    @property
    def html(self) -> str:
        """A complete page, to be written to a file.

        Raises:
            InputError: for clips too long for a page.
        """
        return player_page(self.clips, title=", ".join(annotated.name for annotated in self.clips))

    def _repr_html_(self) -> str:
        """Returns an iframe that holds the whole page.

        The iframe isolates the player from the notebook's styles and from other players. Its sandbox allows the
        player's script and nothing else: no access to the notebook, no forms, no windows.
        """
        page = html.escape(self.html, quote=True)
        return (
            f'<iframe srcdoc="{page}" sandbox="allow-scripts" loading="lazy" title="motion" '
            f'style="width: 100%; height: {self.height}px; border: 0; display: block"></iframe>'
        )

    def __repr__(self) -> str:
        longest = max(annotated.seconds for annotated in self.clips)
        return f"Shown({', '.join(annotated.name for annotated in self.clips)}; {longest:.1f} s)"


def show(
    *clips: Showable,
    names: Sequence[str] | None = None,
    phase: Sequence[np.ndarray | None] | None = None,
    contacts: Sequence[np.ndarray | None] | None = None,
) -> Shown:
    """Plays clips in a notebook, next to each other and in step, with contacts and phases below.

    Drag to look around; press on a time line to jump there. Contacts and phases are found from the motion; if a clip
    has none, a note says why.

    Args:
        clips: clips, records with a clip, or paths of files; rates and lengths may differ.
        names: captions, one for each clip; by default style and content, or the file's name.
        phase: for each clip [T] radians (NaN in frames without a phase), or local phases [T, B, 2], or None for those
            found from the motion.
        contacts: for each clip [T, 4] or [T, 2] bool, or None for those found from the motion.

    Returns:
        An object that a notebook displays as the last value of a cell; `.html` is a complete page.

    Raises:
        ValueError: without clips, or if names, phases or contacts are not one for each clip or have another shape.
        InputError: for anything that is not a clip, a file that cannot be read, or clips without frames or with
            numbers that are not finite. Clips too long for a page are refused when the page is made: by `.html`, and
            as the result of a cell.
    """
    if not clips:
        raise ValueError("show needs at least one clip.")
    annotated = annotate_clips(clips, names)
    for field, given in (("phase", phase), ("contacts", contacts)):
        if given is not None:
            annotated = _with(annotated, field, given)
    return Shown(annotated, _height(annotated))


def _with(clips: Sequence[AnnotatedClip], field: str, given: Sequence[np.ndarray | None]) -> list[AnnotatedClip]:
    if len(given) != len(clips):
        raise ValueError(f"There are {len(clips)} clips and {len(given)} entries of {field}.")
    changed: list[AnnotatedClip] = []
    for annotated, values in zip(clips, given, strict=True):
        new: dict[str, Any] = {} if values is None else {field: np.asarray(values)}
        if "phase" in new:  # the note is about the phase that was found
            new["note"] = ""
        changed.append(replace(annotated, **new))
    return changed


def _height(clips: Sequence[AnnotatedClip]) -> int:
    rows = math.ceil(len(clips) / PER_ROW)
    strip = max(14 * len(clip.foot_bars()) + 34 * min(2, len(clip.phase_lines())) for clip in clips)
    return rows * ((SCENE_HEIGHT if rows == 1 else STACKED_HEIGHT) + strip) + AROUND
