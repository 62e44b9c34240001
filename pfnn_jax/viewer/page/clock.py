"""When steps of a simulation fall due, by a clock that is read at any time."""

from __future__ import annotations

import math
from collections import deque

CATCH_UP = 6
"""Steps made up for at once; of a longer pause, as of a busy machine, the rest is forgotten."""

ROUNDING = 1e-6
"""Share of a step by which it may be early: times are sums of floating-point numbers."""


class Clock:
    """Equal steps, of which step n is due n / `fps` seconds after the clock was first read.

    Args:
        fps: steps per second.
    """

    def __init__(self, fps: float) -> None:
        self._fps = fps
        self._origin: float | None = None
        self._steps = 0
        self._made: deque[tuple[float, int]] = deque()

    def due(self, now: float) -> list[float]:
        """Moments of the steps that have fallen due since the last call, `CATCH_UP` at most; none at the first call.

        Args:
            now: seconds; where it is before that of an earlier call, nothing is due until time has caught up.
        """
        if self._origin is None:
            self._origin = now
        behind = math.floor((now - self._origin) * self._fps + ROUNDING) - self._steps
        if behind > CATCH_UP:
            self._origin += (behind - CATCH_UP) / self._fps
            behind = CATCH_UP
        first, self._steps = self._steps, self._steps + max(behind, 0)
        self._count(now, self._steps - first)
        return [self._origin + step / self._fps for step in range(first + 1, self._steps + 1)]

    @property
    def rate(self) -> float:
        """Steps that fell due within a second before the last call of `due`."""
        return float(sum(steps for _, steps in self._made))

    def _count(self, now: float, steps: int) -> None:
        self._made.append((now, steps))
        while self._made[0][0] <= now - 1.0:
            self._made.popleft()
