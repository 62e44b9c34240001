"""The widgets of the panels: dials, stick and keys, the triangle of styles, readouts (HTML), and the contact chart."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Mapping, Sequence
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from pfnn_jax.viewer.draw.palette import (
    ACCENT,
    FACE,
    FAINT,
    INK,
    LEFT,
    LETTER,
    LINE,
    MESSAGES,
    MUTED,
    PALE_LEFT,
    PALE_RIGHT,
    PASSIVE,
    RIGHT,
    rgba_css,
)
from pfnn_jax.viewer.page.skinned_body import node_names
from pfnn_jax.viewer.page.view import LEAST_WEIGHT, Dial, View

if TYPE_CHECKING:
    import viser

TRIANGLE = ((120.0, 16.0), (26.0, 150.0), (214.0, 150.0))
"""Corners of the triangle of styles, in the units of its SVG."""

TRIANGLE_WIDTH = "76%"
"""Of the panel, so that what is below it is visible in a window 720 pixels high."""

READOUT_WIDTH = 282.0
"""Width of the panel of numbers, CSS pixels."""

_DIAL_COLOURS = {
    "gait": ACCENT,
    "left hand": PALE_LEFT,
    "right hand": PALE_RIGHT,
    "left toe": LEFT,
    "right toe": RIGHT,
}
CONTACT_SECONDS, CONTACT_SAMPLES = 4.0, 120  # of the contact chart
_LANES = ("right toe", "right heel", "left toe", "left heel")  # from the bottom
_LANE_ORDER = (3, 2, 1, 0)  # indices into `View.contacts`
_LANE_FILL = tuple(rgba_css(colour, opacity) for colour in (RIGHT, LEFT) for opacity in (0.55, 0.9))
_LANE_GAP = 0.18  # of a lane's height
_FONT = "font-family:system-ui,-apple-system,'Segoe UI',Roboto,sans-serif"


def script(run: str = "") -> str:
    """Returns an invisible element that runs the page's script (page.js); it takes effect once in a page.

    Args:
        run: name of the run, for the tab's title.
    """
    code = resources.files("pfnn_jax.viewer.page").joinpath("page.js").read_text(encoding="utf-8")
    code = code.replace("BODY_NODES", json.dumps(node_names()))
    image = f'<img alt="" src="data:," style="display:none" onerror="{html.escape(code, quote=True)}">'
    title = f'<i hidden data-run="{html.escape(run, quote=True)}"></i>'
    return f"<style>{_PAGE_STYLE}</style>{title}{image}"


def start_note(what: str, seconds: float, expected: float | None) -> str:
    """Returns what a start is doing, a bar, the seconds so far and those still expected."""
    share = 0.0 if not expected else min(seconds / expected, 0.98)
    if not expected:
        rest = ""
    elif seconds < expected:
        rest = f"about {max(expected - seconds, 1.0):.0f} s to go"
    else:
        rest = "longer than expected"
    bar = f'<div class="pfnn-bar"><div style="width:{100.0 * share:.1f}%"></div></div>'
    counted = f"<span>{seconds:.0f} s so far</span><span>{rest}</span>"
    return (
        f'<div data-start style="{_FONT};font-size:12.5px;color:{INK};padding:4px 12px 12px">'
        f"<div>{html.escape(what)}&#8230;</div>{bar}"
        f'<div style="display:flex;justify-content:space-between;color:{MUTED}">{counted}</div></div>'
    )


def learning_note(name: str, run: str, share: float, waiting: bool, left: float) -> str:
    """Returns a bar for a style that is being learned.

    Args:
        name, run: of the style.
        share: 0 to 1, the part that is done.
        waiting: whether another style is learned first.
        left: seconds that it probably still takes.
    """
    rest = "waits for another style" if waiting else f"about {max(5.0 * math.ceil(left / 5.0), 5.0):.0f} s left"
    bar = f'<div class="pfnn-bar"><div style="width:{100.0 * share:.0f}%"></div></div>'
    words = f"<span>Learning {html.escape(name)} on {html.escape(run)}</span><span>{rest}</span>"
    return (
        f'<div data-learning style="{_FONT};font-size:12.5px;color:{INK};padding:2px 12px 8px">'
        f'<div style="display:flex;justify-content:space-between;gap:8px">{words}</div>{bar}</div>'
    )


def phase_dial(dials: Sequence[Dial]) -> str:
    """Returns the phases as clock faces; for the gait cycle, noon is the right foot's contact."""
    if not dials:
        return note("This network is gated by velocities and has no phase.")
    if len(dials) == 1:
        return _svg(240, 104, _clock(dials[0], 120.0, 52.0, 42.0, ticks=True))
    width = 240 / len(dials)
    clocks = [_clock(dial, (i + 0.5) * width, 36.0, 25.0) for i, dial in enumerate(dials)]
    names = [_text((i + 0.5) * width, 78.0, dial.name, 10.5) for i, dial in enumerate(dials)]
    return _svg(240, 86, "".join(clocks + names))


def pad() -> str:
    """Returns the stick with W, A, S and D at its rim, and the keys for turning and going faster."""
    letter = "position:absolute;pointer-events:none;font-weight:600;font-size:12px"
    letters = "".join(
        f'<span class="pfnn-letter" data-drive="{key}" style="{letter};{place}">{key.upper()}</span>'
        for key, place in (
            ("w", "left:0;right:0;top:6px;text-align:center"),
            ("s", "left:0;right:0;bottom:6px;text-align:center"),
            ("a", "left:9px;top:42px"),
            ("d", "right:9px;top:42px"),
        )
    )
    knob = '<div data-knob class="pfnn-knob"></div>'
    stick = f'<div data-stick class="pfnn-stick" title="Drag to walk; or W A S D">{letters}{knob}</div>'
    keys = "".join(
        f'<div class="pfnn-key" role="button" data-drive="{key}" title="{title}">{sign}<small>{label}</small></div>'
        for key, sign, label, title in (
            ("q", "&#8630;", "Q", "Turn left"),
            ("e", "&#8631;", "E", "Turn right"),
            ("shift", "&#8679;", "Shift: faster", "Faster until pressed again"),
        )
    )
    grip = '<div class="pfnn-grip" data-sheet role="button" aria-expanded="false" title="More controls"><i></i></div>'
    pad = f'<div class="pfnn-pad">{stick}<div class="pfnn-keys">{keys}</div></div>'
    return f"<style>{_PAD_STYLE}</style>{grip}{pad}"


def triangle(names: Sequence[str], shares: Sequence[float], active: bool) -> str:
    """Returns a triangle with three styles at its corners and a point between them, which can be dragged.

    Args:
        names: of the corners: top, left, right.
        shares: weights of the styles, with sum one.
        active: whether the character is in this mixture.
    """
    corners = " ".join(f"{x:g},{y:g}" for x, y in TRIANGLE)
    x, y = (sum(share * corner[axis] for share, corner in zip(shares, TRIANGLE, strict=True)) for axis in (0, 1))
    labels = zip(names, percents(shares), strict=True)
    places = ((120.0, 11.0, "middle"), (4.0, 165.0, "start"), (236.0, 165.0, "end"))
    texts = "".join(
        _text(*place[:2], f"{_short(name, 13)} {percent}%", 12.0, place[2], INK if active else MUTED)
        for (name, percent), place in zip(labels, places, strict=True)
    )
    thirds = "".join(
        f'<line x1="{a[0]:g}" y1="{a[1]:g}" x2="{(b[0] + c[0]) / 2:g}" y2="{(b[1] + c[1]) / 2:g}" stroke="{LINE}"/>'
        for a, b, c in (TRIANGLE[i:] + TRIANGLE[:i] for i in range(3))
    )
    colour = ACCENT if active else PASSIVE
    shape = (
        f'<polygon points="{corners}" fill="{ACCENT if active else FAINT}" fill-opacity="{0.1 if active else 1}" '
        f'stroke="{colour}" stroke-width="1.6" stroke-linejoin="round"/>{thirds}'
        f'<circle data-dot="" cx="{x:.2f}" cy="{y:.2f}" r="7.5" fill="{colour}" stroke="white" stroke-width="2"/>'
    )
    attributes = f'data-triangle="{corners}" style="cursor:pointer;touch-action:none"'
    return _svg(240, 172, shape + texts, attributes, TRIANGLE_WIDTH)


def readout(view: View) -> str:
    """Returns the style and the speed of a moment."""
    styles = ", ".join(
        html.escape(name.lstrip("\0")) + (f" {weight:.0%}" if weight < 1.0 - LEAST_WEIGHT else "")
        for name, weight in sorted(view.style_weights.items(), key=lambda item: -item[1])[:3]
    )
    wanted = f"<span style='color:{MUTED}'>of {plain_number(view.wanted_speed, 2)} wanted</span>"
    speed = f"{plain_number(view.speed, 2)} m/s {wanted}"
    return _rows({"Style": ("style", styles, ""), "Speed": ("speed", speed, "")})


def details(view: View, drawn: float, browser: float) -> str:
    """Returns the numbers of a moment that are folded away: position, facing, and how fast everything is computed.

    Args:
        view: the moment.
        drawn: pictures sent per second.
        browser: pictures per second that the browser manages, 0 if unknown.
    """
    left, ahead = float(view.root[0]), float(view.root[1])
    sideways = f"{plain_number(abs(left), 2)} m {'left' if left >= 0.0 else 'right'}"
    along = f"{plain_number(abs(ahead), 2)} m {'ahead' if ahead >= 0.0 else 'behind'}"
    yaw = math.degrees(math.atan2(view.facing[0], view.facing[1]))
    turned = "as at the start" if abs(yaw) < 0.5 else f"{abs(yaw):.0f}° to the {'left' if yaw > 0.0 else 'right'}"
    pictures = f"{drawn:.0f} a second" + (f", the browser shows {browser:.0f}" if browser else "")
    place = f'<i hidden data-value="{left:.3f} {ahead:.3f} {yaw:.2f}"></i>'
    return _rows(
        {
            "Position": ("root", f"{along}, {sideways}", place),
            "Facing": ("facing", turned, ""),
            "Pictures": ("pictures", pictures, ""),
            "Steps": ("steps", f"{view.steps_per_second:.0f} a second, {view.step_milliseconds:.1f} ms each", ""),
        }
    )


def _rows(rows: Mapping[str, tuple[str, str, str]]) -> str:
    """Returns lines: title -> (key, content, what follows it)."""
    cells = "".join(
        f'<div style="color:{MUTED}">{title}</div><div><span data-readout="{key}">{content}</span>{after}</div>'
        for title, (key, content, after) in rows.items()
    )
    grid = "display:grid;grid-template-columns:68px 1fr;gap:1px 6px;font-variant-numeric:tabular-nums"
    return f'<div style="{_FONT};font-size:12.5px;line-height:1.45;padding:2px 12px 8px;{grid}">{cells}</div>'


def plain_number(value: float, digits: int) -> str:
    """Returns a number with some digits after the point, and no sign in front of zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


def message(kind: str, text: str) -> str:
    """Returns one or several lines in a coloured box; `kind` is `good`, `warning`, `bad` or `plain`.

    A line that advises an option says where there are options: the page has none.
    """
    text = "\n".join(f"{line} (on the command line)" if "`--" in line else line for line in text.split("\n"))
    colour, back = MESSAGES[kind]
    style = f"{_FONT};font-size:12.5px;line-height:1.4;color:{colour};background:{back}"
    box = "overflow-wrap:anywhere;white-space:pre-line;border-radius:7px;padding:7px 10px;margin:2px 12px 9px"
    return f'<div data-message="{kind}" style="{style};{box}">{html.escape(text)}</div>'


def shares_of(text: str) -> tuple[float, float, float] | None:
    """Parses three shares from a text like `50 30 20`, scaled to sum one; returns None for anything else."""
    parts = text.replace(",", " ").replace("%", " ").split()
    if len(parts) != 3:
        return None
    try:
        values = [float(part) for part in parts]
    except ValueError:
        return None
    total = sum(values)
    if not all(math.isfinite(value) and value >= 0.0 for value in values) or not 0.0 < total < math.inf:
        return None
    a, b, c = (value / total for value in values)
    return a, b, c


def percents(shares: Sequence[float]) -> list[int]:
    """Returns shares with sum one as whole percent with sum 100; the largest takes the rounding error."""
    rounded = [round(100.0 * share) for share in shares]
    rounded[rounded.index(max(rounded))] += 100 - sum(rounded)
    return rounded


def legend(colours: Mapping[str, str], note: str = "") -> str:
    """Returns a line with names and their colours, followed by a note."""
    items = "".join(
        f'<span style="margin-right:12px"><i style="display:inline-block;width:9px;height:9px;border-radius:2px;'
        f'background:{colour};margin-right:5px"></i>{html.escape(name)}</span>'
        for name, colour in colours.items()
    )
    return f'<div style="{_FONT};font-size:11.5px;color:{MUTED};padding:0 12px 8px">{items}{html.escape(note)}</div>'


class Timeline:
    """A chart of the last seconds of foot contacts: four lanes, filled while a heel or toe is on the ground.

    Args:
        gui: of the tab.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._times = np.linspace(-CONTACT_SECONDS, 0.0, CONTACT_SAMPLES)
        self._seen: list[tuple[float, np.ndarray]] = []
        bands: Any = tuple({"series": (2 * i + 2, 2 * i + 1), "fill": _LANE_FILL[i]} for i in range(4))
        line: dict[str, Any] = {"stroke": "rgba(0,0,0,0)", "width": 0, "points": {"show": False}}
        series: Any = ({"label": "s"}, *(dict(line, label=_LANES[i // 2]) for i in range(8)))
        self._chart = gui.add_uplot(
            self._lanes(np.zeros((CONTACT_SAMPLES, 4))),
            series=series,
            bands=bands,
            scales={"x": {"time": False, "range": (-CONTACT_SECONDS, 0.0)}, "y": {"range": (0.0, 4.0)}},
            axes=({"show": False}, {"show": False}),
            legend={"show": False},
            cursor={"show": False},
            height=72,
            padding=(6, 8, 6, 8),
        )

    def add(self, seconds: float, contacts: np.ndarray) -> None:
        """Appends a moment; contacts above one half are drawn, all at one height.

        Args:
            seconds: of any one clock.
            contacts: [4] in 0..1, in the order of `View.contacts`.
        """
        self._seen.append((seconds, (contacts[list(_LANE_ORDER)] > 0.5).astype(float)))
        if len(self._seen) > 2 * CONTACT_SAMPLES * 4:
            self._seen = [seen for seen in self._seen if seen[0] >= seconds - CONTACT_SECONDS - 0.1]

    def show(self, seconds: float) -> None:
        """Draws the moments up to `seconds`."""
        if not self._seen:
            return
        clock = np.array([moment for moment, _ in self._seen]) - seconds
        values = np.stack([contacts for _, contacts in self._seen])
        index = np.searchsorted(clock, self._times, side="right") - 1
        known = (index >= 0)[:, None]
        self._chart.data = self._lanes(np.where(known, values[np.maximum(index, 0)], 0.0))

    def _lanes(self, contacts: np.ndarray) -> tuple[np.ndarray, ...]:
        arrays = [self._times]
        for lane in range(4):
            base = np.full(CONTACT_SAMPLES, lane + _LANE_GAP / 2)
            arrays += [base, base + (1.0 - _LANE_GAP) * np.clip(contacts[:, lane], 0.0, 1.0)]
        return tuple(arrays)


class FieldChanges:
    """Detects which fields of a tab have changed since they were last read."""

    def __init__(self) -> None:
        self._seen: dict[str, Any] = {}

    def changed(self, name: str, value: Any) -> bool:
        """Returns whether a value differs from the last call with this name; the first time it does not."""
        before = self._seen.setdefault(name, value)
        self._seen[name] = value
        return before != value

    def set(self, **values: Any) -> None:
        """Notes values that the server has given to fields, which are not changes made in the browser."""
        self._seen.update(values)


def _clock(dial: Dial, x: float, y: float, radius: float, ticks: bool = False) -> str:
    colour = _DIAL_COLOURS.get(dial.name, ACCENT)
    length = radius * min(max(dial.amplitude, 0.0), 1.0)
    tip = x + length * math.sin(dial.angle), y - length * math.cos(dial.angle)
    face = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{FACE}" stroke="{LINE}" stroke-width="1.5"/>'
    if ticks:
        face += f'<circle cx="{x}" cy="{y - radius}" r="4" fill="{RIGHT}"/>'
        face += f'<circle cx="{x}" cy="{y + radius}" r="4" fill="{LEFT}"/>'
        face += _text(x + radius + 12, y - radius + 8, "right foot", 10.5, "start", RIGHT)
        face += _text(x + radius + 12, y + radius, "left foot", 10.5, "start", LEFT)
        face += _text(x - radius - 12, y + 4, f"{math.degrees(dial.angle):.0f}°", 15.0, "end", INK)
    hand = (
        f'<line x1="{x:.1f}" y1="{y:.1f}" x2="{tip[0]:.2f}" y2="{tip[1]:.2f}" stroke="{colour}" stroke-width="3" '
        f'stroke-linecap="round"/><circle cx="{tip[0]:.2f}" cy="{tip[1]:.2f}" r="4.5" fill="{colour}"/>'
    )
    return face + hand


def _svg(width: int, height: int, content: str, attributes: str = "", shown: str = "100%") -> str:
    size = f'viewBox="0 0 {width} {height}" width="{shown}"'
    return f'<div style="padding:0 12px 6px;text-align:center"><svg {size} {attributes}>{content}</svg></div>'


def _text(x: float, y: float, text: str, size: float, anchor: str = "middle", colour: str = MUTED) -> str:
    return (
        f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}" fill="{colour}" '
        f'style="{_FONT};font-size:{size}px;font-variant-numeric:tabular-nums">{html.escape(text)}</text>'
    )


def note(text: str) -> str:
    """Returns a line of small text."""
    return f'<div style="{_FONT};font-size:12px;color:{MUTED};padding:2px 12px 8px">{html.escape(text)}</div>'


def _short(name: str, length: int) -> str:
    return name if len(name) <= length else name[: length - 1] + "…"


_PAGE_STYLE = f"""
.pfnn-bar {{ height: 6px; margin: 7px 0 5px; border-radius: 3px; background: {FAINT}; overflow: hidden; }}
.pfnn-bar > div {{ height: 100%; border-radius: 3px; background: {ACCENT}; transition: width 0.9s linear; }}
@media (min-width: 990px) {{ /* notices between the panels if there is room, so that they do not cover the readouts */
  .mantine-Notifications-root[data-position=top-left] {{ left: {READOUT_WIDTH + 30:g}px !important; }}
}}
/* Tools of viser: list of commands, address and scene tree, the sign of the connection. The page has its own words. */
.mantine-ActionIcon-root:has(.tabler-icon-adjustments), .mantine-ActionIcon-root:has(.tabler-icon-list-search),
.tabler-icon-cloud-check, div:has(> .tabler-icon-cloud-check) > div:nth-child(-n+2) {{ display: none !important; }}
.pfnn-grip {{ display: none; }}
.pfnn-compact .pfnn-grip {{ display: flex; justify-content: center; padding: 2px 0 9px; cursor: pointer;
  touch-action: none; }}
.pfnn-grip i {{ width: 44px; height: 5px; border-radius: 3px; background: {PASSIVE}; }}
.pfnn-compact:not(.pfnn-open) .pfnn-more, .pfnn-compact:not(.pfnn-open) .mantine-Tabs-root {{
  display: none !important; }}
.pfnn-compact:not(.pfnn-open) [data-with-border] {{ border: 0; margin: 0 !important; }}
.pfnn-compact:not(.pfnn-open) [data-with-border] > .mantine-Paper-root {{ display: none; }} /* the folder's title */
.pfnn-sheet {{ left: 0 !important; width: 100% !important; max-height: 72% !important;
  border-radius: 14px 14px 0 0 !important; }}
.pfnn-sheet .mantine-ScrollArea-content > div {{ width: 100% !important; }}
.pfnn-sheet:not(:has([data-start])) .mantine-ScrollArea-content > div > div:first-child {{ /* the title */
  display: none !important; }}
@media (max-height: 430.9px) {{
  .pfnn-readouts, #webgl-software-rendering {{ display: none !important; }}
}}
@media (max-width: 575.9px) {{ #webgl-software-rendering {{ display: none !important; }} }}
.pfnn-ended {{ position: fixed; left: 50%; top: 38%; transform: translate(-50%, -50%); z-index: 1000;
  box-sizing: border-box; width: min(380px, 90vw); padding: 14px 18px; border-radius: 9px; text-align: center;
  background: {MESSAGES["bad"][1]}; color: {MESSAGES["bad"][0]}; font-size: 14px; line-height: 1.5; {_FONT};
  box-shadow: 0 3px 18px rgba(20, 30, 50, 0.25); }}
.pfnn-ended[hidden] {{ display: none; }}
"""

_PAD_STYLE = f"""
.pfnn-pad {{ display: flex; gap: 14px; align-items: center; padding: 4px 12px 10px; user-select: none;
  -webkit-user-select: none; }}
.pfnn-stick {{ position: relative; width: 104px; height: 104px; border-radius: 50%; flex: none; cursor: grab;
  background: radial-gradient(circle at 50% 40%, #ffffff, #e7ebf1); border: 1px solid {LINE}; touch-action: none; }}
.pfnn-knob {{ position: absolute; left: 34px; top: 34px; width: 34px; height: 34px; border-radius: 50%;
  background: {ACCENT}; box-shadow: 0 1px 4px rgba(20, 30, 50, 0.35); pointer-events: none; }}
.pfnn-letter {{ color: {LETTER}; }} .pfnn-letter.on {{ color: {ACCENT}; }}
.pfnn-keys {{ display: grid; grid-template-columns: 1fr 1fr; gap: 7px; flex: 1; }}
.pfnn-key {{ border: 1px solid {LINE}; border-radius: 8px; background: #fff; text-align: center; padding: 6px 2px 4px;
  font-size: 17px; line-height: 1.05; cursor: pointer; color: {INK}; touch-action: none; }}
.pfnn-key small {{ display: block; font-size: 11px; color: {MUTED}; margin-top: 2px; }}
.pfnn-key:last-child {{ grid-column: 1 / 3; }}
.pfnn-key.on {{ background: {ACCENT}; color: #fff; border-color: {ACCENT}; }}
.pfnn-key.on small {{ color: #fff; }}
"""
