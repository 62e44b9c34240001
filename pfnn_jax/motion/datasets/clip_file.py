"""The record of one clip on disk, before it is read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# Mason et al. 2018, few-shot styles not mirrored, then the asymmetric styles of 100STYLE
ASYMMETRIC = frozenset(
    name.lower()
    for name in (
        *("Bouncy", "Dance3", "DragLeg", "Hobble", "HurtLeg", "LeanRight", "LeftHop", "PainfulLeftknee"),
        *("WoundedLeg", "Yokogeri"),
        *("ArmsFolded", "Balance", "BouncyLeft", "BouncyRight", "DragLeftLeg", "DragRightLeg", "LeanLeft"),
        *("RightHop", "LimpLeft", "LimpRight", "Lunge", "Monk", "Old", "OnPhoneLeft", "OnPhoneRight", "Punch"),
        *("RaisedLeftArm", "RaisedRightArm", "ShieldedLeft", "ShieldedRight", "SpinAntiClock", "SpinClock"),
        *("Superman", "Swat", "Sweep", "Teapot", "WalkingStickLeft", "WalkingStickRight"),
    )
)


@dataclass(frozen=True)
class ClipFile:
    """One clip on disk and what is known of it before it is read.

    Attributes:
        path: the BVH file.
        style: name of the style, fit to be a file name.
        content: what is done, as `walk` or `walk-turn-left`; empty where unknown.
        symmetric: whether the style may be mirrored.
        start, stop: frames used, at the file's own rate; stop None means to the end. A stop beyond the take, as in
            shortened takes, means the end too.
        unit: metres per unit of the file, None to guess it.
        cut_by: (file, place) that states start and stop, for messages; None where nobody did.
    """

    path: Path
    style: str
    content: str = ""
    symmetric: bool = True
    start: int = 0
    stop: int | None = None
    unit: float | None = None
    cut_by: tuple[Path, str] | None = None


def is_symmetric(style: str) -> bool:
    """Whether a style may be mirrored, by the papers' lists of styles that were not."""
    return style.lower() not in ASYMMETRIC
