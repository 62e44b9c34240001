"""`pfnn-jax style show`: what the file of a style says about it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command
from pfnn_jax.io.tensors import shown

if TYPE_CHECKING:
    from pfnn_jax.workflows.style_card import StyleCard

SHOWN = {
    "speed": "recorded speed {:.2f} m/s",
    "frames": "{} frames",
    "held_out_error": "held-out error {:.3f}",
    "error_without_style": "without the style {:.3f}",
    "error": "error {:.3f}",
}
"""Entries of a style's record that are shown, where they are there."""

MAX_SHOWN = 1000
"""Characters of a line that is printed."""


@dataclass(frozen=True, kw_only=True)
class StyleShow(Command):
    """Show what the file of a style says about it: source, licence, errors, and which network it fits.

    Attributes:
        file: as `pfnn-jax style export` writes it.
    """

    file: Annotated[Positional[Path], tyro.conf.arg(metavar="FILE")]

    def run(self) -> Any:
        from pfnn_jax.workflows.style_card import read_style_card

        card = read_style_card(self.file)
        print_card(self.file, card)
        return card


def print_card(file: Path, card: StyleCard) -> None:
    """Prints what users ask about a style first, in few lines; text of the file without control characters."""
    adapter = f"{card.adapter.kind}, rank {card.adapter.rank}" if "cp" in card.adapter.kind else card.adapter.kind
    known = (text.format(card.info[key]) for key, text in SHOWN.items() if card.info.get(key) is not None)
    lines = [
        f"{file}: style {card.name}, {adapter}, {card.layout}, {len(card.skeleton['names'])} joints",
        f"source: {card.source or 'not stated'}; licence: {card.licence or 'not stated'}",
        f"shared network: {card.network}",
        ", ".join(known),
        *(f"warning: {warning}" for warning in card.info.get("warnings", ())),
    ]
    for line in filter(None, lines):
        print(shown(line, MAX_SHOWN))
