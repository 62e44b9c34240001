"""What a person asks of a character: held keys, the on-screen stick, and the messages of the page's script.

Without the page's script only presses of keys are known: viser reports when a key goes down and when it repeats, not
when it is released. A key therefore counts as held for a short while after its last press: `FIRST_HOLD` after the
first, until which repetition begins, and `HOLD` after each repetition. Only the key pressed last repeats, so that

- a movement key and a turning key form a chord: the one held already stays held as long as the other;
- so do two movement keys that are pressed together (within `TOGETHER`), which makes a diagonal;
- otherwise the movement key pressed last replaces the one before it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

MOTION = {"w": (1.0, 0.0), "s": (-1.0, 0.0), "a": (0.0, 1.0), "d": (0.0, -1.0)}
"""Components ahead and to the left of the heading."""

TURNS = {"q": 1.0, "e": -1.0}
"""To the left (positive about +Y) and to the right."""

FIRST_HOLD = 0.6
"""Seconds for which a key counts as held after its first press: systems begin to repeat after 0.25 to 0.6 s."""

HOLD = 0.2
"""Seconds for which it counts as held after a repetition: systems repeat 10 to 30 times a second."""

TOGETHER = 0.15
"""Seconds within which two movement keys are pressed for a diagonal."""


@dataclass(frozen=True)
class DriveInput:
    """What the keys or the stick ask for.

    Attributes:
        ahead, left: of length at most one, relative to the heading.
        turn: -1 to 1, positive to the left.
        run: whether Shift is held.

    Raises:
        ValueError: for a value that is not finite or beyond 1.
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
        """Whether it asks for any movement or turn."""
        return self != DriveInput(run=self.run)


@dataclass(frozen=True)
class ClientMessage:
    """A message of the page's script.

    Attributes:
        stick: ahead, left and turn in -1..1, and whether to run.
        rate: pictures per second that the browser manages, 0 before it knows.
        visible: whether the tab can be seen.
    """

    stick: tuple[float, float, float, bool]
    rate: float
    visible: bool = True


def parse_message(text: str) -> ClientMessage | None:
    """Parses a count and six numbers; returns None for anything else.

    Args:
        text: the count, ahead, left, turn, faster (0 or 1), pictures per second, visible (0 or 1).
    """
    parts = text.split()
    if len(parts) != 7 or len(text) > 100:
        return None
    try:
        ahead, left, turn, run, rate, visible = (float(part) for part in parts[1:])
    except ValueError:
        return None
    if not all(math.isfinite(value) and abs(value) <= 1.0 for value in (ahead, left, turn, run, visible)):
        return None
    if not 0.0 <= rate < 1e4:
        return None
    return ClientMessage((ahead, left, turn, run > 0.0), rate, visible > 0.0)


@dataclass
class _Held:
    began: float
    until: float


class HeldKeys:
    """Estimates which keys are held from their presses. Times are seconds of one clock and never decrease."""

    def __init__(self) -> None:
        self._held: dict[str, _Held] = {}
        self._run = False

    def press(self, key: str, shift: bool, now: float) -> None:
        """Notes that a key goes down or repeats.

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
        """Releases all keys."""
        self._held.clear()

    def drive_input(self, now: float) -> DriveInput:
        """Returns what the keys held at `now` ask for."""
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
    """Returns whether `other`, held already, stays held together with `key`."""
    if key == other:
        return False  # the caller enters it again
    if (key in MOTION) != (other in MOTION):
        return True
    opposed = key in TURNS or MOTION[key] == tuple(-value for value in MOTION[other])
    return not opposed and abs(began - other_began) <= TOGETHER
