"""The errors a user can cause, each a single line that says what to change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

LONGEST_PART = 300
"""Characters that a message shows of a place and of a value: a damaged file may hold a number of 5,000 digits."""

LONGEST_RULE = 2000
"""Characters that a message shows of a rule, which may list the styles of a run."""


class InputError(ValueError):
    """Bad input: one line of bounded length names the file, the place in it, the value found and the rule it breaks."""

    def __init__(self, file: str | Path, place: str, value: object, rule: str):
        self.file, self.place, self.value, self.rule = str(file), place, value, rule
        parts = ((self.file, LONGEST_RULE), (place, LONGEST_PART), (value, LONGEST_PART), (rule, LONGEST_RULE))
        super().__init__("{}: {}: {}; {}".format(*(one_line(part, most) for part, most in parts)))

    def __reduce__(self):
        # Exceptions are unpickled with the arguments of `Exception.__init__`, here one; worker processes need all four.
        return type(self), (self.file, self.place, self.value, self.rule)


class BadFilesError(InputError):
    """Several bad files at once: the message has a line for each, and a last one that says what to do."""

    def __init__(self, file: str | Path, errors: tuple[InputError, ...], rule: str):
        super().__init__(file, "clips", f"{len(errors)} bad files", rule)
        self.errors = errors

    def __str__(self) -> str:
        return "\n".join([*map(str, self.errors), super().__str__()])

    def __reduce__(self):
        return type(self), (self.file, self.errors, self.rule)


class TrainingError(RuntimeError):
    """Training became non-finite: names the step, the style and the value. The last good save is kept."""

    def __init__(self, step: int, style: str, value: float):
        self.step, self.style, self.value = step, style, value
        super().__init__(
            f"training: step {step}, style {style}: loss is {value}; losses must stay finite, "
            "the last good save is kept, try a lower learning rate"
        )

    def __reduce__(self):
        return type(self), (self.step, self.style, self.value)


class LostProcessError(RuntimeError):
    """Another of the processes that train together has ended, or cannot be reached; says what was found."""

    def __init__(self, found: str):
        self.found = found
        super().__init__(
            f"training: another process is lost: {found}; the last complete save is kept, "
            "start all processes again, a pretraining with resume=True"
        )

    def __reduce__(self):
        return type(self), (self.found,)


def one_line(text: object, most: int) -> str:
    """Returns a text as one line of at most `most` characters: the unprintable is escaped, the middle is left out."""
    escaped = (letter if letter.isprintable() else ascii(letter)[1:-1] for letter in _ends(str(text), most))
    return _ends("".join(escaped), most)


def _ends(text: str, most: int) -> str:
    """Returns a text if it is short enough, else its beginning and its end."""
    return text if len(text) <= most else f"{text[: most - most // 4 - 5]} ... {text[-(most // 4) :]}"


def check_field(config: Any, name: str, rule: str, holds: Callable[[Any], bool]) -> None:
    """Checks one field of a configuration.

    Args:
        config: a dataclass; its class is named in the message.
        name: of the field. A field that is None is not set, and passes.
        rule: what the value must be, for the message: "must {rule}".
        holds: whether a value obeys the rule.

    Raises:
        ValueError: "Config.name must …, got ….".
    """
    value = getattr(config, name)
    if value is not None and not holds(value):
        shown = repr(value) if isinstance(value, str) else value
        raise ValueError(f"{type(config).__name__}.{name} must {rule}, got {shown}.")


def check_at_least(config: Any, *names: str, least: float = 1) -> None:
    """Checks that the named fields are at least `least`; see `check_field`."""
    for name in names:
        check_field(config, name, f"be at least {least}", lambda value: value >= least)


def check_positive(config: Any, *names: str) -> None:
    """Checks that the named fields are above zero; see `check_field`."""
    for name in names:
        check_field(config, name, "be positive", lambda value: value > 0)


def check_not_negative(config: Any, *names: str) -> None:
    """Checks that the named fields are zero or above; see `check_field`."""
    for name in names:
        check_field(config, name, "not be negative", lambda value: value >= 0)


def check_probability(config: Any, *names: str) -> None:
    """Checks that the named fields are drop probabilities, in [0, 1); see `check_field`."""
    for name in names:
        check_field(config, name, "be in [0, 1)", lambda value: 0 <= value < 1)


def check_share(config: Any, *names: str) -> None:
    """Checks that the named fields are shares, in (0, 1]; see `check_field`."""
    for name in names:
        check_field(config, name, "be in (0, 1]", lambda value: 0 < value <= 1)


def check_one_of(config: Any, name: str, allowed: tuple[str, ...]) -> None:
    """Checks that the named field is one of some words; see `check_field`."""
    check_field(config, name, f"be one of {', '.join(allowed)}", lambda value: value in allowed)
