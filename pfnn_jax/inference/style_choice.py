"""A choice of style: one style, a mixture by weights, or none. Without JAX, so that the command checks it at once."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from pfnn_jax.errors import InputError

StyleChoice: TypeAlias = str | Mapping[str, float] | None
"""A style's name, weights by name, or None for style-agnostic motion, which on a FiLM run is the mean of its styles."""

SUM_TOLERANCE = 1e-3
"""How far the sum of weights may lie from one: weights are typed with a few decimals."""


def parse_style(text: str, styles: Sequence[str], source: str | Path) -> str | dict[str, float]:
    """Returns the style's name, or the weights of a mixture written as `A:0.5+B:0.3+C:0.2`.

    Args:
        text: what was asked for. Without a colon, or if it is the name of a style, it is a name.
        styles: names of the styles that exist.
        source: where they are, for messages.

    Raises:
        InputError: for a part that is not NAME:WEIGHT, a name that occurs twice, or weights that do not sum to one.
    """
    if ":" not in text or text in styles:
        return text
    weights: dict[str, float] = {}
    for part in text.split("+"):
        name, _, number = part.rpartition(":")
        try:
            weight = float(number)
        except ValueError:
            weight = float("nan")
        if not name or name in weights or not math.isfinite(weight):
            raise InputError(source, "style", part, "must be NAME:WEIGHT+NAME:WEIGHT+..., with each name once")
        weights[name] = weight
    check_weights(tuple(weights.values()), source, "style weights")
    return weights


def file_stem(name: str) -> str:
    """Returns a style's name, or a mixture as it is written, as part of a file name that every system accepts."""
    return re.sub(r'[/\\<>:"|?*]', "-", name)


def check_weights(weights: Iterable[float], source: str | Path, place: str) -> None:
    """Checks that weights are finite and sum to one.

    Raises:
        InputError: naming the weights and their sum.
    """
    weights = [float(weight) for weight in weights]
    total = sum(weights)
    if not abs(total - 1.0) <= SUM_TOLERANCE:
        shown = " + ".join(f"{weight:g}" for weight in weights)
        raise InputError(source, place, f"{shown} = {total:g}", "must sum to one")
