"""A recorded sequence of stick and facing, such as the control preset of CAMDM, as commands to a character.

One line for each frame at `PRESET_FPS`, `x, y, z, x, y, z`: the stick, then the facing. Both are in the coordinates of
Unity, whose x axis points the other way; here they are in those of this package, where +X is to the left of +Z.

Source: Chen et al. 2024 (CAMDM), `preset.txt` of their demo and its evaluation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.text_rows import read_lines

PRESET_FPS = 30.0
"""Lines per second."""

COLUMNS = 6


@dataclass(frozen=True, eq=False)
class DrivePreset:
    """What a player commanded.

    Attributes:
        stick: [N, 2] (x, z), each in [-1, 1]: the direction of travel, 0 for standing.
        facing: [N, 2] unit vectors.
    """

    stick: np.ndarray
    facing: np.ndarray

    @property
    def seconds(self) -> float:
        """Duration."""
        return len(self.stick) / PRESET_FPS


def read_preset(path: Path) -> DrivePreset:
    """Reads a preset of N lines.

    Raises:
        InputError: naming the first line that is not six finite numbers with commas between them, whose stick leaves
            [-1, 1], or whose facing has no direction; for a file that cannot be read or has no lines.
    """
    lines = read_lines(path)
    if not lines:
        raise InputError(path, "lines", 0, "must be at least 1")
    rows = np.array([_read_line(path, number, line) for number, line in enumerate(lines, 1)])
    stick, facing = (rows[:, columns] * [-1.0, 1.0] for columns in ([0, 2], [3, 5]))
    return DrivePreset(stick, facing / np.linalg.norm(facing, axis=-1, keepdims=True))


def _read_line(path: Path, number: int, line: str) -> list[float]:
    """Returns the six numbers of a line."""
    place, words = f"line {number}", line.split(",")
    if len(words) != COLUMNS:
        raise InputError(path, place, f"{len(words)} values", f"must be {COLUMNS}, with commas between them")
    values = [_read_number(path, place, word.strip()) for word in words]
    for word, value in zip((words[0], words[2]), (values[0], values[2]), strict=True):
        if abs(value) > 1.0:
            raise InputError(path, place, word.strip(), "must lie in [-1, 1], the range of a stick")
    if values[3] == values[5] == 0.0:
        raise InputError(path, place, "facing 0, 0", "must have a direction on the ground")
    return values


def _read_number(path: Path, place: str, word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(path, place, word, "must be a number")
    return value


def preset_commands(preset: DrivePreset, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns velocities [T, 2], as multiples of a style's natural speed, and directions [T, 2] at `fps`.

    Every line holds until the next, as the stick of a game is read. A stick of length 1 commands the natural speed: a
    speed in metres per second would be a walk for one style and a sprint for another. A stick in a
    corner, of length 1.41, commands the same speed: the demo that recorded the preset normalises it too.
    """
    frames = round(preset.seconds * fps)
    lines = np.minimum(np.arange(frames) * PRESET_FPS / fps, len(preset.stick) - 1).astype(int)
    length = np.linalg.norm(preset.stick, axis=-1, keepdims=True)
    velocity = preset.stick / np.maximum(length, 1.0)
    return velocity[lines].astype(np.float32), preset.facing[lines].astype(np.float32)
