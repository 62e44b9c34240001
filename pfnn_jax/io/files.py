"""Text files of one row of numbers for each frame, as `.phase` and `.gait` files are."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Collection, Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Before long work, so that it is not done in vain.

    Raises:
        InputError: if the path exists and must not be overwritten.
    """
    if path.exists() and not overwrite:
        raise InputError(path, "output", "exists", "existing output is replaced only with --overwrite")


def require_suffix(path: Path, suffixes: Collection[str]) -> None:
    """A file's name tells what is in it: refuse another kind's, or none, before long work.

    Args:
        path: file to write.
        suffixes: those of the kind, in lower case with their dots; capitals in the name are taken too.

    Raises:
        InputError: for another suffix.
    """
    if path.suffix.lower() not in suffixes:
        rule = f"must be {'one of ' if len(suffixes) > 1 else ''}{', '.join(suffixes)}"
        raise InputError(path, "suffix", path.suffix or "none", rule)


def failure(error: Exception) -> str:
    """Why a file could not be read or written, in one line that does not repeat the path beside which it stands."""
    reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
    return reason or type(error).__name__


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file so that it appears whole or not at all; text as UTF-8, its line ends as they are.

    Raises:
        InputError: if it cannot be written, as on a full disk; nothing is left behind.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(path, "output", error.strerror or error, "must be writable and the disk have room") from None
    finally:
        temporary.unlink(missing_ok=True)


def swap_folder(new: Path, target: Path) -> None:
    """Put a finished folder in its place; what stood there is kept until the new one does, then removed.

    Args:
        new: the finished folder, beside `target` so that it can be renamed.
        target: its place, with or without something there.

    Raises:
        OSError: if it cannot be renamed; then what stood there still does.
    """
    old = new.with_name(f"{new.name}.old")
    if not target.exists() and not target.is_symlink():
        new.rename(target)
        return
    target.rename(old)
    try:
        new.rename(target)
    except OSError:
        old.rename(target)
        raise
    if old.is_dir() and not old.is_symlink():
        shutil.rmtree(old)
    else:
        old.unlink()


def json_text(value: Any) -> str:
    """What a JSON file holds of a value: `to_plain` of it, indented, and a last newline.

    Raises:
        TypeError: as `to_plain`.
    """
    return json.dumps(to_plain(value), indent=2, allow_nan=False) + "\n"


def to_plain(value: Any) -> Any:
    """What JSON can hold: NumPy and JAX arrays as lists, dataclasses as mappings, paths as text, NaN and ∞ as null.

    Raises:
        TypeError: for anything else, naming its type.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return to_plain(asdict(value))
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic) or hasattr(value, "__array__"):
        return to_plain(np.asarray(value).tolist())
    raise TypeError(f"JSON cannot hold a {type(value).__name__}.")


def read_rows(path: Path, columns: int, num_frames: int | None = None) -> np.ndarray:
    """Numbers in [0, 1] of a text file, one line for each frame.

    Args:
        path: text file.
        columns: numbers in a line.
        num_frames: expected lines; None for any number of at least one.

    Returns:
        [T, columns] float64.

    Raises:
        InputError: naming the first bad line, value, or the number of lines.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", error, "must be a readable text file") from error
    while lines and not lines[-1].strip():
        lines.pop()
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
