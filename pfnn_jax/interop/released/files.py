"""Files of released weights: raw little-endian float32 numbers, row by row, without a header."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.motion.skeleton import skeleton_from_json

DESCRIPTION = "description.json"
"""Stands beside files that `pfnn-jax export --format bins` has written."""


def read_description(directory: Path, layout: str) -> dict[str, Any] | None:
    """What an export tells of its files, with `skeleton` as a record; None where the files are the authors' own.

    Raises:
        InputError: for a description that cannot be read, or of another layout.
    """
    file = directory / DESCRIPTION
    if not file.exists():
        return None
    rule = f"must describe an export of layout {layout} in bins"
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
        found = data["layout"]["name"], data["format"]
        if found != (layout, "bins"):
            raise InputError(file, "layout, format", ", ".join(map(str, found)), rule)
        return {key: data[key] for key in ("network", "styles", "loop")} | {
            "skeleton": skeleton_from_json(data["skeleton"], file)
        }
    except (OSError, json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(file, "file", str(error).splitlines()[0], rule) from error
    except (KeyError, TypeError) as error:
        raise InputError(file, "entry", f"{error.args[0]}", rule) from error


def read_array(file: Path, shape: tuple[int, ...] | None) -> np.ndarray:
    """The numbers of a file.

    Args:
        file: raw float32, last axis fastest.
        shape: of the array, or None for one axis of any length.

    Raises:
        InputError: if the file is absent, of another size, or holds a number that is not finite.
    """
    try:
        data = file.read_bytes()
    except OSError as error:
        raise InputError(file, "file", error.strerror, "must be part of the released weights") from error
    size = math.prod(shape) * 4 if shape else max(len(data) - len(data) % 4, 4)
    if len(data) != size:
        of = f" of {' x '.join(map(str, shape))} float32" if shape else ", a multiple of 4"
        raise InputError(file, "size", f"{len(data)} bytes", f"must be {size} bytes{of}")
    values = np.frombuffer(data, "<f4")
    if not np.isfinite(values).all():
        where = int(np.argmin(np.isfinite(values)))
        raise InputError(file, f"value {where}", values[where], "every value must be finite")
    return values.reshape(shape or -1).astype(np.float32)


def read_statistics(directory: Path, name: str, size: int) -> Statistics:
    """Mean and deviation [size] from `<name>mean.bin` and `<name>std.bin`.

    Raises:
        InputError: as `read_array`, for an absent directory, and for a deviation that is not above 0.
    """
    if not directory.is_dir():
        raise InputError(directory, "directory", "absent", "must hold the released .bin files")
    mean, std = (read_array(directory / f"{name}{kind}.bin", (size,)) for kind in ("mean", "std"))
    if not (std > 0).all():
        column = int(np.argmin(std))
        raise InputError(directory / f"{name}std.bin", f"column {column}", std[column], "must be above 0")
    return Statistics(mean, std)
