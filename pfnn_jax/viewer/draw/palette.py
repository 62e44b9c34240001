"""The colours of everything that is shown: pictures, videos, HTML players, the live page and evaluation plots."""

from __future__ import annotations

INK, MUTED, GRID, PANEL = "#1f2733", "#667082", "#dfe4ea", "#f3f5f8"
GROUND, PHASE = "#c3cbd6", "#2f9e77"
SIDES = {"left": "#2f6fde", "right": "#e0662f", "middle": "#8a94a3"}
"""Colours of the body: left limbs blue, right limbs orange, trunk grey."""
BODY = {
    "trunk": "#aeb8c6",
    "left limb": SIDES["left"],
    "right limb": SIDES["right"],
    "left end": "#254f9b",
    "right end": "#9f4c2a",
}
"""Colours of the mannequin: its trunk and head, its limbs, and hands and feet at their ends."""
SHADOW, SHADE = "#141e32", 0.16  # colour and opacity of the shadow on the ground

SERIES = ("#2f6fde", "#e0662f", "#2f9e77", "#9a5bd0", "#c2892b", "#d04a78", "#4aa3c4", "#7a8699", "#5b7f2b", "#a0522d")
"""Colours of the curves of a plot, in order."""

BRIGHT = {
    **SIDES,
    "grid": GROUND,
    "ink": INK,
    "muted": MUTED,
    "panel": PANEL,
    "phase": PHASE,
    "shadow": f"{SHADOW}{round(255 * SHADE):02x}",
}
"""Colours of HTML players on a light background; the shadow's last two digits are its opacity."""
DARK = {
    "left": "#5f97f2",
    "right": "#f08a55",
    "middle": "#8e99aa",
    "grid": "#3a4454",
    "ink": "#e5eaf1",
    "muted": "#98a3b5",
    "panel": "#1b212b",
    "phase": "#4cc39a",
    "shadow": "#00000073",
}
"""Colours of HTML players on a dark background. Pictures and videos always have a light one."""

# The live page: panels (colours as text) and the three-dimensional scene (red, green, blue in 0..255).

LEFT, RIGHT = "#3b7ae6", "#e8743b"
"""The body's sides in the panels: dials and contacts."""
PALE_LEFT, PALE_RIGHT = "#7ba6f0", "#f2a77f"
"""The phases of the hands, paler than those of the feet."""
ACCENT, LINE = "#18a078", "#d5dbe4"
FACE, FAINT, PASSIVE = "#f6f8fa", "#eef1f5", "#9aa5b4"
LETTER, HEEL, TOE = "#8b96a6", MUTED, "#b4bcc8"
BUTTON = "#546175"
MESSAGES = {
    "good": ("#0b6b4d", "#e3f5ee"),
    "warning": ("#6e4a00", "#fff3d1"),
    "bad": ("#9b2c14", "#fdebe5"),
    "plain": (MUTED, "#f1f3f7"),
}
"""Kind of message -> (text colour, background colour)."""

SCENE_SIDES = {"left": (38, 96, 226), "right": (238, 92, 28), "middle": (222, 226, 232)}
"""The body in the scene: more saturated than `LEFT` and `RIGHT`, because the scene's light washes colours out."""
PAST, FUTURE = (112, 124, 144), (10, 150, 105)
SKY, HORIZON = (198, 212, 230), (238, 241, 245)
SCENE_GROUND, SCENE_CELL, SCENE_SECTION = (226, 231, 237), (203, 211, 221), (170, 181, 196)


def css_variables(colours: dict[str, str]) -> str:
    """Returns `--player-NAME: COLOUR;` for every colour."""
    return " ".join(f"--player-{name}: {colour};" for name, colour in colours.items())


def rgb(colour: str) -> tuple[int, int, int]:
    """Returns red, green and blue in 0..255 of a colour like `#3b7ae6`."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def rgba_css(colour: str, opacity: float) -> str:
    """Returns a colour like `#3b7ae6` with an opacity in 0..1 in the notation of CSS."""
    return f"rgba({','.join(map(str, rgb(colour)))},{opacity:g})"
