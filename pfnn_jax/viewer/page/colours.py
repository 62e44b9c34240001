"""The colours of the page: of its pictures, its panel and its scene."""

from __future__ import annotations

from pfnn_jax.viewer.draw.palette import MUTED

LEFT, RIGHT = "#3b7ae6", "#e8743b"
"""Of the body's sides, wherever they are told apart: dials, contacts."""

PALE_LEFT, PALE_RIGHT = "#7ba6f0", "#f2a77f"
"""Of the hands' phases, beside those of the feet."""

ACCENT, LINE = "#18a078", "#d5dbe4"
FACE, FAINT, PASSIVE = "#f6f8fa", "#eef1f5", "#9aa5b4"
LETTER, HEEL, TOE = "#8b96a6", MUTED, "#b4bcc8"
PLAIN = "#546175"
"""Of buttons."""

MESSAGES = {"good": ("#0b6b4d", "#e3f5ee"), "bad": ("#9b2c14", "#fdebe5"), "plain": (MUTED, "#f1f3f7")}
"""Kind of a message -> its text's colour and the one behind it."""

BODY = {"left": (38, 96, 226), "right": (238, 92, 28), "middle": (222, 226, 232)}
"""Of the body in the scene: fuller than `LEFT` and `RIGHT`, for the light there washes them out."""

PAST, FUTURE = (112, 124, 144), (10, 150, 105)
SKY, HORIZON = (198, 212, 230), (238, 241, 245)
GROUND, CELL, SECTION = (226, 231, 237), (203, 211, 221), (170, 181, 196)


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue in 0..255 of a colour like `#3b7ae6`."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def see_through(colour: str, opacity: float) -> str:
    """A colour like `#3b7ae6` with an opacity in 0..1, as style sheets write it."""
    return f"rgba({','.join(map(str, rgb(colour)))},{opacity:g})"
