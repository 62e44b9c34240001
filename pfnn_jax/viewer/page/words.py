"""What a browser says: the numbers of the page's script, and the values of fields, which may have changed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ClientMessage:
    """What the page's script says.

    Attributes:
        stick: ahead, left and turn in -1..1, and whether to run.
        rate: pictures per second that the browser manages, 0 before it knows.
    """

    stick: tuple[float, float, float, bool]
    rate: float


def parse_message(text: str) -> ClientMessage | None:
    """Reads a count and five numbers: ahead, left, turn, run, pictures per second; None for anything else."""
    parts = text.split()
    if len(parts) != 6 or len(text) > 100:
        return None
    try:
        ahead, left, turn, run, rate = (float(part) for part in parts[1:])
    except ValueError:
        return None
    if not all(math.isfinite(value) and abs(value) <= 1.0 for value in (ahead, left, turn, run)):
        return None
    if not 0.0 <= rate < 1e4:
        return None
    return ClientMessage((ahead, left, turn, run > 0.0), rate)


class FieldChanges:
    """FieldChanges of fields as they were when they were last looked at."""

    def __init__(self) -> None:
        self._seen: dict[str, Any] = {}

    def changed(self, name: str, value: Any) -> bool:
        """Whether a value differs from the last time; the first time it does not."""
        before = self._seen.setdefault(name, value)
        self._seen[name] = value
        return before != value

    def set(self, **values: Any) -> None:
        """FieldChanges that were given to fields here, which is no change made in a browser."""
        self._seen.update(values)
