"""Tables of new styles: means over the styles, and ratios to the same network without learning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from experiments.common.markdown import markdown_table

MEASURES = ("walk", "side", "back", "run", "all")
"""Groups of takes by motion."""


def summary(rows: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Returns means over the styles for every method."""
    found = {}
    for method in next(iter(rows.values())):
        own = [style[method] for style in rows.values()]
        kinds = [kind for kind in MEASURES if any(kind in row["errors"] for row in own)]
        mse = {kind: _mean([row["errors"][kind]["mse"] for row in own if kind in row["errors"]]) for kind in kinds}
        found[method] = {
            "network": own[0]["network"],
            "trained": own[0]["trained"],
            "stored": own[0]["stored"],
            "seconds": _mean([row["seconds"] for row in own]),
            "frames": _mean([row["frames"] for row in own]),
            "mse": mse,
            "spread": float(np.std([row["errors"]["all"]["mse"] for row in own], ddof=1)) if len(own) > 1 else None,
            "bones": _mean([row["errors"]["all"]["bones"] for row in own]),
            "sound": _mean([row["walks"]["sound"] for row in own]),
            "recognition": _mean([row["walks"]["recognition"] for row in own]),
            "skating": _mean([row["walks"]["skating"] for row in own]),
            "frechet": _mean([row["frechet"] for row in own]),
        }
    return found


def ratios(rows: Mapping[str, Mapping[str, Any]]) -> list[list[str | float | None]]:
    """Returns the ratio of every method's error to that of the same network without learning.

    It is a geometric mean over the styles, because styles far from all known styles have much larger errors and would
    dominate an arithmetic mean.
    """
    first = next(iter(rows.values()))
    nothing = {row["network"]: method for method, row in first.items() if method.startswith("nothing")}
    lines: list[list[str | float | None]] = []
    for method, row in first.items():
        if method.startswith("nothing") or row["network"] not in nothing:
            continue
        pairs = [(style[method]["errors"], style[nothing[row["network"]]]["errors"]) for style in rows.values()]
        logs = [[np.log(own[m]["mse"] / other[m]["mse"]) for own, other in pairs if m in own] for m in MEASURES]
        lines.append([method, *(float(np.exp(np.mean(some))) if some else None for some in logs)])
    return lines


def table(rows: Mapping[str, Mapping[str, Any]]) -> str:
    """Returns a table of all methods, with means over the new styles."""
    head = ["method", "network", "trained", "per style", "seconds", "frames", *MEASURES, "± styles", "bones, mm"]
    head += ["stable, %", "recognised, %", "Fréchet", "skating, cm/s"]
    lines = []
    for method, row in rows.items():
        cells = [method, row["network"], f"{row['trained']:,}", f"{row['stored']:,}", row["seconds"], row["frames"]]
        cells += [row["mse"].get(kind) for kind in MEASURES] + [row["spread"], _scaled(row["bones"], 1000)]
        cells += [_scaled(row["sound"], 100), _scaled(row["recognition"], 100), row["frechet"]]
        lines.append([*cells, _scaled(row["skating"], 100)])
    return markdown_table(head, lines)


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else scale * value


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None
