"""How often a tab's character is stepped and drawn: fully while it moves, rarely or not at all otherwise."""

from __future__ import annotations

import math
from dataclasses import dataclass

FRAME = 1.0 / 60.0
"""Seconds between two turns of the loop of a tab that moves; the simulation has the character's own clock."""

PICTURE = 1.0 / 30.0
"""Seconds between pictures. Each shows the pose at its own moment, so that 30 a second look smooth; twice as many would
cost twice the messages."""

STANDING_INTERVAL = 1.0 / 15.0
"""Seconds between pictures of a character that stands and sways."""

ACTIVE_SECONDS = 20.0
"""Seconds after the last input for which a standing character is stepped; then it rests until the next input."""

SILENCE = 10.0
"""Seconds without any message of the page's script, which sends one every second or two, after which a tab counts as
hidden: its browser may have stopped it without a message."""

IDLE_INTERVAL = 0.5
"""Seconds between two turns of the loop of a tab that rests or is hidden. Input wakes it at once."""

SLOWEST = 1.0 / 5.0
"""Seconds after which a picture is drawn even if steps are late."""

BUSY = 0.7
"""Share of a frame that computing may take before fewer pictures are drawn, so that steps are in time."""


@dataclass(frozen=True)
class FramePlan:
    """What a tab does in one turn of its loop.

    Attributes:
        steps: whether the character is stepped and drawn.
        wait: seconds until the next turn, unless input comes before.
        interval: least seconds between two pictures.
    """

    steps: bool
    wait: float
    interval: float


class FrameScheduler:
    """Decides when one tab is stepped and drawn. Times are seconds of one clock."""

    def __init__(self) -> None:
        self._active = -math.inf

    def plan(self, now: float, *, visible: bool, moving: bool, touched: bool, drawn: float = 0.0) -> FramePlan:
        """Returns what to do now.

        Args:
            now: seconds.
            visible: whether the browser shows the tab.
            moving: whether the character moves, is commanded to, or is recorded.
            touched: whether the person has done anything since the last call.
            drawn: least seconds between two pictures, as far as computing and the browser allow.
        """
        if not math.isfinite(self._active) or moving or touched:
            self._active = now
        if not visible or now - self._active > ACTIVE_SECONDS:
            return FramePlan(False, IDLE_INTERVAL, max(drawn, STANDING_INTERVAL))
        return FramePlan(True, FRAME, drawn if moving or touched else max(drawn, STANDING_INTERVAL))


def picture_interval(work: float, rate: float) -> float:
    """Returns the seconds between pictures: not more than the browser can show and than the steps leave time for.

    Args:
        work: seconds that a step and a picture take.
        rate: pictures per second that the browser manages, 0 if unknown.
    """
    browser = 1.0 / max(rate, 5.0) if rate else PICTURE
    own = 0.0 if work <= BUSY * FRAME else min(3.0 * work, SLOWEST)
    return max(browser, own, PICTURE) - 0.1 * FRAME  # turns of the loop come a little early or late
