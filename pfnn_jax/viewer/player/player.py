"""Motion that plays inside a web page: one file, no server, nothing loaded from elsewhere.

The page gets quantised joint positions and a small script (`SCRIPTS`) that draws bodies of capsules on a ground grid,
several clips side by side and in step, with their foot contacts and phases on a time line below.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, foot_bars, phase_lines
from pfnn_jax.viewer.draw.body import Capsule
from pfnn_jax.viewer.draw.palette import BRIGHT, DARK, css_variables
from pfnn_jax.viewer.draw.scene import make_scene

MILLIMETRE = 0.001  # finest step of a position; wider scenes than ±32 m get a coarser one
INT16 = 32767
RATES = ("0.25", "0.5", "1", "2")
FPS = 30.0
SCRIPTS = ("player_scene.js", "player_strip.js", "player.js")  # what a later one uses stands in an earlier one
HINT = "Drag to look around, Ctrl + wheel to come nearer; space pauses, arrow keys step through frames"
MOST = 32_000_000  # characters of a page; browsers and notebooks become slow beyond


def player_html(clips: Sequence[AnnotatedClip], *, fps: float = FPS, assets: bool = True) -> str:
    """A piece of HTML that plays clips side by side, in step.

    A second of one clip of 28 points takes about 7 kB at 30 frames per second.

    Args:
        clips: clips to show; shorter ones hold their last frame.
        fps: frames per second kept, as near as whole steps of the clip's rate allow; the page interpolates.
        assets: include style and script. They are needed once in a page: `player_assets`.

    Returns:
        HTML to be put inside a page's body.

    Raises:
        ValueError: no clips.
        InputError: clips too long for a page.
    """
    if not clips:
        raise ValueError("A player needs at least one annotated.")
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}.")
    data = {"clips": [_track_data(annotated, fps) for annotated in clips]}
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    text = text.replace("<", "\\u003c")  # no name may end the script
    _require_small(clips, len(text))
    panes = "".join(_pane(number, annotated) for number, annotated in enumerate(clips))
    options = "".join(f'<option value="{r}"{" selected" if r == "1" else ""}>{r}×</option>' for r in RATES)
    return (
        f"{player_assets() if assets else ''}"
        f'<div class="motion-player" tabindex="0"><script type="application/json">{text}</script>'
        f'<div class="panes">{panes}</div>'
        '<div class="controls"><button type="button" class="play">Play</button>'
        '<input type="range" min="0" max="1000" step="any" value="0" aria-label="time"><output></output>'
        f'<select aria-label="speed">{options}</select>'
        '<button type="button" class="reset">Reset view</button></div></div>'
    )


def player_page(clips: Sequence[AnnotatedClip], *, title: str, fps: float = FPS) -> str:
    """A whole page with a player that fills its window.

    Args:
        clips: clips to show.
        title: the page's title.
        fps: as in `player_html`.

    Raises:
        ValueError, InputError: as `player_html`.
    """
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{html.escape(title)}</title>{player_assets()}</head><body class="motion-page">'
        f"{player_html(clips, fps=fps, assets=False)}</body></html>\n"
    )


def player_assets() -> str:
    """Style and script of the player, once for a page."""
    folder = files("pfnn_jax.viewer.player")
    style = folder.joinpath("player.css").read_text(encoding="utf-8")
    script = "".join(folder.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    # a function of its own: its names are not the page's
    return f'<style>{_colours()}{style}</style><script>(() => {{\n"use strict";\n{script}}})();</script>'


def _colours() -> str:
    dark = f"@media (prefers-color-scheme: dark) {{ .motion-player {{ {css_variables(DARK)} }} }}"
    return f".motion-player {{ {css_variables(BRIGHT)} }}\n{dark}\n"


def _pane(number: int, annotated: AnnotatedClip) -> str:
    feet, lines = len(foot_bars(annotated)), len(phase_lines(annotated))
    name = html.escape(annotated.name, quote=True)
    strip = (
        f'<canvas class="strip" data-clip="{number}" role="img" aria-label="contacts and phase of {name}" '
        'title="Press to go there"></canvas>'
        if feet or lines
        else ""
    )
    note = f"<small>{html.escape(annotated.note)}</small>" if annotated.note else ""
    caption = f"<figcaption>{name}{note}</figcaption>"
    scene = f'<canvas class="scene" role="img" aria-label="{name}" title="{HINT}"></canvas>'
    return f"<figure>{caption}{scene}{strip}</figure>"


def _require_small(clips: Sequence[AnnotatedClip], size: int) -> None:
    if size > MOST:
        seconds = sum(annotated.seconds for annotated in clips)
        shown = f"{size / 1e6:.0f} MB for {seconds:.0f} s of motion"
        rule = f"a page holds {MOST / 1e6:.0f} MB: show fewer seconds or fewer frames per second"
        raise InputError(clips[0].clip.source or clips[0].name, "player", shown, rule)


def _track_data(annotated: AnnotatedClip, fps: float) -> dict[str, Any]:
    scene = make_scene(annotated.clip)
    step = max(1, round(scene.fps / fps))
    frames = np.arange(0, len(scene.points), step)
    used = sorted({0, *(c.start for c in scene.capsules), *(c.end for c in scene.capsules)})
    points, focus = scene.points[frames][:, used], scene.focus[frames]
    unit = max(MILLIMETRE, float(np.abs(points).max()) / INT16, float(np.abs(focus).max()) / INT16)
    return {
        "over": round(annotated.over, 4),
        "fps": scene.fps / step,
        "count": len(used),
        "unit": unit,
        "tall": scene.tall,
        "heading": round(scene.heading, 3),
        "points": _quantised(points, unit),
        "focus": _quantised(focus, unit),
        "capsules": [_capsule_data(capsule, used) for capsule in scene.capsules],
        "contacts": [(foot_runs / step).tolist() for _, foot_runs in foot_bars(annotated)],
        "phases": [
            {"name": line.name, "angle": _listed(line.angle[frames]), "weight": _weights(line.weight[frames])}
            for line in phase_lines(annotated)
        ],
    }


def _quantised(values: np.ndarray, unit: float) -> str:
    return base64.b64encode(np.round(values / unit).astype("<i2").tobytes()).decode("ascii")


def _listed(angle: np.ndarray) -> list[float | None]:
    return [round(float(value), 2) if np.isfinite(value) else None for value in angle]


def _weights(weight: np.ndarray) -> list[float] | None:
    """None where every frame has all of it or no phase at all."""
    return None if np.isin(weight, (0.0, 1.0)).all() else [round(float(value), 2) for value in weight]


def _capsule_data(capsule: Capsule, used: list[int]) -> list[Any]:
    ends = [used.index(capsule.start), used.index(capsule.end)]
    return [*ends, round(capsule.start_radius, 4), round(capsule.end_radius, 4), capsule.side, *capsule.span]
