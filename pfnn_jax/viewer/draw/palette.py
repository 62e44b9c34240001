"""The colours of bodies and time lines, in one place for players, films and pictures."""

from __future__ import annotations

INK, MUTED, GRID, PANEL = "#1f2733", "#667082", "#dfe4ea", "#f3f5f8"
GROUND, PHASE = "#c3cbd6", "#2f9e77"
SIDES = {"left": "#2f6fde", "right": "#e0662f", "middle": "#8a94a3"}
"""Colours of the body: left limbs blue, right limbs orange, trunk grey."""
SHADOW, SHADE = "#141e32", 0.16  # colour of the shadow on the ground, and how much of it there is

BRIGHT = {
    **SIDES,
    "grid": GROUND,
    "ink": INK,
    "muted": MUTED,
    "panel": PANEL,
    "phase": PHASE,
    "shadow": f"{SHADOW}{round(255 * SHADE):02x}",
}
"""What players take on a white page; the shadow's last two digits are its opacity."""
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
"""... and on a dark one. Pictures and films are always bright."""


def css_variables(colours: dict[str, str]) -> str:
    """`--player-NAME: COLOUR;` for each of them."""
    return " ".join(f"--player-{name}: {colour};" for name, colour in colours.items())
