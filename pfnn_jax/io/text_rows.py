"""Text files with one row of numbers for each frame, such as `.phase` and `.gait` files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError


def read_lines(path: Path) -> list[str]:
    """Reads the lines of a text file, without empty ones at its end.

    Raises:
        InputError: for a file that cannot be read.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", error, "must be a readable text file") from error
    while lines and not lines[-1].strip():
        lines.pop()
    return lines


def read_rows(path: Path, columns: int, num_frames: int | None = None) -> np.ndarray:
    """Reads numbers in [0, 1] from a text file, one line for each frame.

    Args:
        path: text file.
        columns: numbers in a line.
        num_frames: expected lines; None for any number of at least one.

    Returns:
        [T, columns] float64.

    Raises:
        InputError: naming the first bad line, value, or the number of lines.
    """
    lines = read_lines(path)
    expected = "at least 1" if num_frames is None else f"{num_frames}, one for each frame of the BVH file"
    if not lines or (num_frames is not None and len(lines) != num_frames):
        raise InputError(path, "lines", len(lines), f"must be {expected}")
    try:
        rows = np.array([line.split() for line in lines], dtype=np.float64).reshape(len(lines), -1)
    except ValueError:
        rows = np.empty((0, 0))
    if rows.shape != (len(lines), columns) or not ((rows >= 0) & (rows <= 1)).all():
        raise _first_bad_line(path, lines, columns)
    return rows


def _first_bad_line(path: Path, lines: list[str], columns: int) -> InputError:
    for number, line in enumerate(lines, 1):
        words = line.split()
        if len(words) != columns:
            return InputError(path, f"line {number}", f"{len(words)} values", f"must be {columns}")
        for word in words:
            try:
                value = float(word)
            except ValueError:
                return InputError(path, f"line {number}", word, "must be a number")
            if not 0 <= value <= 1:
                return InputError(path, f"line {number}", word, "must lie in [0, 1]")
    return InputError(path, "file", f"{len(lines)} lines", f"must hold {columns} numbers a line")
