"""Motion as HTML: one file that plays in a browser, without a server and without outside resources.

The page holds skinned bodies, the rotations of their joints, the renderer (`renderer.py`), and a small script
(`SCRIPTS`) that plays several clips next to each other and in step, with their foot contacts and phases on a time line
below.
"""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.palette import BRIGHT, DARK, css_variables
from pfnn_jax.viewer.draw.scene import Scene, make_scene
from pfnn_jax.viewer.player.packing import mesh_data, motion_data
from pfnn_jax.viewer.player.renderer import packed_renderer, renderer_licence

RATES = ("0.25", "0.5", "1", "2")
FPS = 30.0
SCRIPTS = ("player_load.js", "player_scene.js", "player_strip.js", "player.js")  # in order of their dependencies
HINT = "Drag to look around, Ctrl + wheel to zoom; space pauses, arrow keys step through frames"
MOST = 32_000_000  # characters of a page; larger ones make browsers and notebooks slow


def player_html(clips: Sequence[AnnotatedClip], *, fps: float = FPS, assets: bool = True) -> str:
    """Returns a piece of HTML that plays clips next to each other, in step.

    A body takes about 20 kB, and a second of one clip 3 to 5 kB at 30 frames per second.

    Args:
        clips: what to show; shorter ones hold their last frame.
        fps: frames per second in the page, rounded so that whole frames are skipped; the page interpolates.
        assets: include style and script (`player_assets`), which a page needs once.

    Returns:
        HTML to be put inside a page's body.

    Raises:
        ValueError: without clips, or for a rate that is not positive.
        InputError: clips too long for a page.
    """
    if not clips:
        raise ValueError("A player needs at least one clip.")
    if not fps > 0:
        raise ValueError(f"fps must be positive, got {fps}.")
    text = json.dumps(_player_data(clips, fps), separators=(",", ":"), allow_nan=False)
    text = text.replace("<", "\\u003c")  # so that no name can close the script element
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
    """Returns a complete page with a player that fills its window.

    Args:
        clips: what to show.
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
    """Returns style, renderer and script of the player, which a page needs once; about 0.23 MB.

    Raises:
        InputError: if the package that carries the renderer is missing.
    """
    folder = files("pfnn_jax.viewer.player")
    style = folder.joinpath("player.css").read_text(encoding="utf-8")
    script = "".join(folder.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS)
    # the script is inside a function, so that its names do not leak into the page
    return (
        f"<style>{_colours()}{style}</style>"
        f"<!-- Contains three.js: {renderer_licence()} -->"
        f'<script type="text/plain" class="motion-renderer">{packed_renderer()}</script>'
        f'<script>(() => {{\n"use strict";\n{script}}})();</script>'
    )


def _colours() -> str:
    dark = f"@media (prefers-color-scheme: dark) {{ .motion-player {{ {css_variables(DARK)} }} }}"
    return f".motion-player {{ {css_variables(BRIGHT)} }}\n{dark}\n"


def _pane(number: int, annotated: AnnotatedClip) -> str:
    feet, lines = len(annotated.foot_bars()), len(annotated.phase_lines())
    name = html.escape(annotated.name, quote=True)
    strip = (
        f'<canvas class="strip" data-clip="{number}" role="img" aria-label="contacts and phase of {name}" '
        'title="Press to jump there"></canvas>'
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
        shown = f"{size / 1e6:.3g} MB for {seconds:.3g} s of motion"
        rule = f"must be at most {MOST / 1e6:.3g} MB: show fewer seconds or fewer frames per second"
        raise InputError(clips[0].clip.source or clips[0].name, "player", shown, rule)


def _player_data(clips: Sequence[AnnotatedClip], fps: float) -> dict[str, Any]:
    """Returns the bodies and clips of a player; a body that several clips have is written once."""
    meshes: dict[str, tuple[int, dict[str, Any]]] = {}
    tracks = []
    for annotated in clips:
        scene = make_scene(annotated.clip, annotated.mesh)
        data = mesh_data(scene.mesh)
        number, _ = meshes.setdefault(json.dumps(data), (len(meshes), data))
        tracks.append({"mesh": number, **_track_data(annotated, scene, fps)})
    return {"meshes": [data for _, data in meshes.values()], "clips": tracks}


def _track_data(annotated: AnnotatedClip, scene: Scene, fps: float) -> dict[str, Any]:
    step = max(1, round(scene.fps / fps))
    frames = np.arange(0, len(scene.positions), step)
    return {
        "end": round(annotated.end, 4),
        "fps": scene.fps / step,
        "tall": scene.tall,
        "facing": round(scene.facing, 3),
        **motion_data(scene, annotated.clip.skeleton.parents, frames),
        "contacts": [(foot_runs / step).tolist() for _, foot_runs in annotated.foot_bars()],
        "phases": [
            {"name": line.name, "angle": _listed(line.angle[frames]), "weight": _weights(line.weight[frames])}
            for line in annotated.phase_lines()
        ],
    }


def _listed(angle: np.ndarray) -> list[float | None]:
    return [round(float(value), 2) if np.isfinite(value) else None for value in angle]


def _weights(weight: np.ndarray) -> list[float] | None:
    """Returns None if every weight is 0 or 1: then the gaps of the angle say it all."""
    return None if np.isin(weight, (0.0, 1.0)).all() else [round(float(value), 2) for value in weight]
