"""Reads files of released weights: raw little-endian float32 values in row-major order, without a header."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import read_json
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.motion.skeleton import skeleton_from_json

MAX_BYTES = 512 * 2**20
"""Bytes of the largest file that is read; the largest that were released have 1 MB."""

DESCRIPTION = "description.json"
"""File written by `pfnn-jax export --format bins` next to the weights; absent in the authors' own releases."""


def read_description(directory: Path, layout: str) -> dict[str, Any] | None:
    """Reads the description of an export, with `skeleton` as a record; returns None for the authors' own files.

    Raises:
        InputError: if the description cannot be read or describes another layout.
    """
    file = directory / DESCRIPTION
    if not file.exists():
        return None
    rule = f"must describe an export of layout {layout} in format bins"
    data = read_json(file, rule)
    try:
        found = data["layout"]["name"], data["format"]
        if found != (layout, "bins"):
            raise InputError(file, "layout, format", ", ".join(map(str, found)), rule)
        return {key: data[key] for key in ("network", "styles", "loop")} | {
            "skeleton": skeleton_from_json(data["skeleton"], file)
        }
    except (KeyError, TypeError) as error:
        raise InputError(file, "entry", f"{error.args[0]}", rule) from error


def read_array(file: Path, shape: tuple[int, ...] | None) -> np.ndarray:
    """Reads the values of a file.

    Args:
        file: raw float32, row-major.
        shape: shape of the array; None for one axis of any length.

    Raises:
        InputError: if the file is absent, has another size, or holds a value that is not finite.
    """
    try:
        found = file.stat().st_size
        size = math.prod(shape) * 4 if shape else max(found - found % 4, 4)
        if found != size:
            of = f" of {' x '.join(map(str, shape))} float32" if shape else ", a multiple of 4"
            raise InputError(file, "size", f"{found} bytes", f"must be {size} bytes{of}")
        if size > MAX_BYTES:
            raise InputError(file, "size", f"{found} bytes", f"must be at most {MAX_BYTES}")
        data = file.read_bytes()
    except OSError as error:
        raise InputError(file, "file", error.strerror, "must be part of the released weights") from error
    values = np.frombuffer(data, "<f4")
    if not np.isfinite(values).all():
        where = int(np.argmin(np.isfinite(values)))
        raise InputError(file, f"value {where}", values[where], "must be finite")
    return values.reshape(shape or -1).astype(np.float32)


def read_statistics(directory: Path, name: str, size: int) -> Statistics:
    """Reads mean and standard deviation [size] from `<name>mean.bin` and `<name>std.bin`.

    Raises:
        InputError: as `read_array`; also if the directory is absent or a standard deviation is not positive.
    """
    if not directory.is_dir():
        raise InputError(directory, "directory", "absent", "must contain the released .bin files")
    mean, std = (read_array(directory / f"{name}{kind}.bin", (size,)) for kind in ("mean", "std"))
    if not (std > 0).all():
        column = int(np.argmin(std))
        raise InputError(directory / f"{name}std.bin", f"column {column}", std[column], "must be positive")
    return Statistics(mean, std)
