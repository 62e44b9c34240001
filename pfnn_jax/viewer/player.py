"""Motion that plays inside a web page: one file, no server, nothing loaded from elsewhere.

The page gets quantised joint positions and a small script (`player.js`) that draws bodies of capsules on a ground grid,
several clips side by side and in step.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.body import Capsule, body_capsules, body_points

MILLIMETRE = 0.001  # finest step of a position; wider scenes than ±32 m get a coarser one
INT16 = 32767
RATES = ("0.25", "0.5", "1", "2")


@dataclass(frozen=True, eq=False)
class Track:
    """One clip to show.

    Attributes:
        name: caption.
        clip: the motion, T frames.
        phase: [T] radians, drawn as a clock hand (up: right contact), or None.
        contacts: [T, 4] bool: left heel, left toe, right heel, right toe, drawn as bars below, or None.
    """

    name: str
    clip: MotionClip
    phase: np.ndarray | None = None
    contacts: np.ndarray | None = None


def player_html(tracks: Sequence[Track], *, fps: float = 30.0, start: float = 0.0, assets: bool = True) -> str:
    """A piece of HTML that plays clips side by side, in step.

    20 s of one clip of 21 joints at 30 fps take about 130 kB.

    Args:
        tracks: clips to show; shorter ones hold their last frame.
        fps: frames per second kept, as near as whole steps of the clip's rate allow; the page interpolates.
        start: second at which it stands before it plays.
        assets: include style and script. They are needed once in a page: `player_assets`.

    Returns:
        HTML to be put inside a page's body.

    Raises:
        ValueError: no tracks, or a phase or contacts of another length than their clip.
    """
    if not tracks:
        raise ValueError("A player needs at least one track.")
    data = {"start": start, "tracks": [_track_data(track, fps) for track in tracks]}
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")  # a name may not end the script
    panes = "".join(_pane(number, track) for number, track in enumerate(tracks))
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


def player_assets() -> str:
    """Style and script of the player, once for a page."""
    folder = files("pfnn_jax.viewer")
    style = folder.joinpath("player.css").read_text(encoding="utf-8")
    script = folder.joinpath("player.js").read_text(encoding="utf-8")
    return f"<style>{style}</style><script>{script}</script>"


def _pane(number: int, track: Track) -> str:
    strip = "" if track.contacts is None else f'<canvas class="contacts" data-track="{number}"></canvas>'
    return f'<figure><canvas class="scene"></canvas>{strip}<figcaption>{html.escape(track.name)}</figcaption></figure>'


def _track_data(track: Track, fps: float) -> dict[str, Any]:
    clip = track.clip
    for name, values in (("phase", track.phase), ("contacts", track.contacts)):
        if values is not None and len(values) != clip.num_frames:
            raise ValueError(f"{name} of track {track.name!r} has {len(values)} frames, its clip {clip.num_frames}.")
    step = max(1, round(clip.fps / fps))
    frames = np.arange(0, clip.num_frames, step)
    capsules = body_capsules(clip.skeleton)
    used = sorted({0, *(c.start for c in capsules), *(c.end for c in capsules)})
    points = body_points(clip)[frames][:, used]
    unit = max(MILLIMETRE, float(np.abs(points).max()) / INT16)
    data = {
        "name": track.name,
        "fps": clip.fps / step,
        "count": len(used),
        "unit": unit,
        "tall": float(np.median(np.ptp(points[..., 1], axis=1))) / 1.7,  # 1 for a person: camera and aim scale with it
        "points": base64.b64encode(np.round(points / unit).astype("<i2").tobytes()).decode("ascii"),
        "capsules": [_capsule_data(capsule, used) for capsule in capsules],
    }
    if track.phase is not None:
        data["phase"] = [round(float(value), 2) for value in track.phase[frames]]
    if track.contacts is not None:
        on = track.contacts[frames]
        data["contacts"] = [_runs(on[:, 0] | on[:, 1]), _runs(on[:, 2] | on[:, 3])]
    return data


def _capsule_data(capsule: Capsule, used: list[int]) -> list[Any]:
    ends = [used.index(capsule.start), used.index(capsule.end)]
    return [*ends, round(capsule.start_radius, 4), round(capsule.end_radius, 4), capsule.side, *capsule.span]


def _runs(on: np.ndarray) -> list[list[int]]:
    """First and past-the-last index of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    return edges.reshape(-1, 2).tolist()
