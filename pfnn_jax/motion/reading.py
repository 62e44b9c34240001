"""How a motion file is to be read, and how it was read.

`ReadOptions` is what the user says, `Reading` is what was decided: a BVH file states neither its unit nor its up axis,
and what any file states may be wrong. `assumptions` decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from pfnn_jax.errors import InputError
from pfnn_jax.motion.length_unit import UNITS, UnitName

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]

Up = Literal["auto", "x", "y", "z", "-x", "-y", "-z"]
"""An axis, or `auto` to find it."""

Travel = Literal["auto", "keep", "rebuild"]
"""What to do with a walk on the spot."""

AXES: tuple[Axis, ...] = ("x", "y", "z", "-x", "-y", "-z")


@dataclass(frozen=True)
class ReadOptions:
    """What is known about a file. The defaults find everything from the motion.

    Attributes:
        unit: of lengths: metre, decimetre, centimetre, millimetre, inch, foot, CMU (0.056444 m), or a number of
            metres. By default it is guessed from the length of the legs.
        up: the axis that points up; auto finds it from how the body stands.
        source_fps: frames per second of the file, in place of its `Frame Time` or the times of its keys.
        travel: rebuild makes a walk on the spot travel, by the foot that stands; keep leaves it; auto rebuilds the
            travel of a body that stays in place while its standing feet slide.
        clip_name: name of the clip to read of a glTF file that holds several; by default the only one that moves, or
            else the plain walk.
    """

    unit: float | UnitName | None = None
    up: Up = "auto"
    source_fps: float | None = None
    travel: Travel = "auto"
    clip_name: str | None = None

    @property
    def metres(self) -> float | None:
        """Metres per unit; None to guess."""
        return UNITS[self.unit] if isinstance(self.unit, str) else self.unit


@dataclass(frozen=True)
class Reading:
    """How a file was read.

    Attributes:
        unit: metres per unit of the file.
        up: the axis of the file that points up.
        fps: frames per second.
        frames_in_file: number of frames in the file.
        first_frame: index in the file of the clip's first frame.
        roles_file: name of the JSON file that named the joints' roles; empty without one.
        notes: one line for each assumption that may be wrong, and for each repair.
    """

    unit: float
    up: Axis
    fps: float
    frames_in_file: int
    first_frame: int = 0
    roles_file: str = ""
    notes: tuple[str, ...] = ()

    def noting(self, *notes: str) -> Reading:
        """Returns the record with notes added; empty ones are left out."""
        return replace(self, notes=(*self.notes, *(note for note in notes if note)))

    def to_json(self) -> dict[str, Any]:
        """Returns the record as JSON data, without the notes."""
        record = {"unit": self.unit, "up": self.up, "fps": self.fps, "first_frame": self.first_frame}
        return {**record, "roles_file": self.roles_file} if self.roles_file else record


def check_options(options: ReadOptions, path: str | Path) -> None:
    """Checks what the user says about a file.

    Raises:
        InputError: for a unit or rate that is not positive and finite, or another unit, axis or travel than there are.
    """
    if isinstance(options.unit, str) and options.unit not in UNITS:
        rule = f"must be {', '.join(UNITS)} or a number of metres"
        raise InputError(path, "unit", options.unit, rule)
    for place, value, what in (
        ("unit", options.metres, "metres"),
        ("source_fps", options.source_fps, "frames per second"),
    ):
        if value is not None and not (math.isfinite(value) and value > 0):
            raise InputError(path, place, value, f"must be a positive, finite number of {what}")
    for place, choice, allowed in (
        ("up", options.up, ("auto", *AXES)),
        ("travel", options.travel, ("auto", "keep", "rebuild")),
    ):
        if choice not in allowed:
            raise InputError(path, place, choice, f"must be one of {', '.join(allowed)}")
