"""HeldKeys of which only presses are known: which are held, and where they lead.

A browser page tells when a key goes down and when it repeats, not when it is let go. A key therefore counts as held
for a short while after its last press: `FIRST_HOLD` after the first, until which repetition begins, and `HOLD` after
each repetition. Repetition is of the key pressed last alone, so that

- a key of motion and a key of turning are a chord: the one held already stays held as long as the other;
- so are two keys of motion that are pressed together (within `TOGETHER`), which makes a diagonal;
- otherwise the key of motion pressed last takes the place of the one before it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

MOTION = {"w": (1.0, 0.0), "s": (-1.0, 0.0), "a": (0.0, 1.0), "d": (0.0, -1.0)}
"""Ahead and to the left of the heading."""

TURNS = {"q": 1.0, "e": -1.0}
"""To the left (positive about +Y) and to the right."""

FIRST_HOLD = 0.6
"""Seconds for which a key counts as held after its first press: systems begin to repeat after 0.25 to 0.6 s."""

HOLD = 0.2
"""Seconds for which it counts as held after a repetition: systems repeat 10 to 30 times a second."""

TOGETHER = 0.15
"""Seconds within which two keys of motion are pressed for a diagonal."""


@dataclass(frozen=True)
class DriveInput:
    """What the keys or the stick ask for.

    Attributes:
        ahead, left: of length at most one, seen from the heading.
        turn: -1 to 1, positive to the left.
        run: whether Shift is held.
    """

    ahead: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    run: bool = False

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) and abs(value) <= 1.0 + 1e-6 for value in (self.ahead, self.left, self.turn)):
            raise ValueError(f"DriveInput must be finite and within -1 to 1, got {self}.")

    @property
    def moves(self) -> bool:
        """Whether it asks for anything."""
        return self != DriveInput(run=self.run)


@dataclass
class _Held:
    began: float
    until: float


class HeldKeys:
    """Presses as they come, and what is held at a time. Times are seconds of any one clock, never falling."""

    def __init__(self) -> None:
        self._held: dict[str, _Held] = {}
        self._run = False

    def press(self, key: str, shift: bool, now: float) -> None:
        """A key has gone down or repeats.

        Args:
            key: one of w, a, s, d, q, e in either case.
            shift: whether Shift was down with it.
            now: seconds.

        Raises:
            ValueError: for another key.
        """
        key = key.lower()
        if key not in MOTION and key not in TURNS:
            raise ValueError(f"`key` must be one of {', '.join((*MOTION, *TURNS))}, got {key!r}.")
        self._expire(now)
        held = self._held.get(key)
        until = now + (FIRST_HOLD if held is None else HOLD)
        began = now if held is None else held.began
        if held is not None and held.until > until:
            until = held.until  # an early repetition does not shorten the first hold
        self._held = {name: other for name, other in self._held.items() if _chord(key, began, name, other.began)}
        for other in self._held.values():
            other.until = max(other.until, until)
        self._held[key] = _Held(began, until)
        self._run = shift

    def clear(self) -> None:
        """Nothing is held."""
        self._held.clear()

    def drive_input(self, now: float) -> DriveInput:
        """What the keys held at `now` ask for."""
        held = [key for key, state in self._held.items() if now < state.until]
        ahead = sum(MOTION[key][0] for key in held if key in MOTION)
        left = sum(MOTION[key][1] for key in held if key in MOTION)
        length = math.hypot(ahead, left)
        scale = 1.0 / length if length > 1.0 else 1.0
        turn = sum(TURNS[key] for key in held if key in TURNS)
        return DriveInput(ahead * scale, left * scale, turn, self._run and bool(held))

    def _expire(self, now: float) -> None:
        self._held = {key: state for key, state in self._held.items() if now < state.until}


def _chord(key: str, began: float, other: str, other_began: float) -> bool:
    """Whether `other`, held already, stays held beside `key`."""
    if key == other:
        return False  # it is entered anew
    if (key in MOTION) != (other in MOTION):
        return True
    opposed = key in TURNS or MOTION[key] == tuple(-value for value in MOTION[other])
    return not opposed and abs(began - other_began) <= TOGETHER
