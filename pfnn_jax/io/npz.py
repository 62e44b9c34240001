"""Reads the arrays of NumPy archives (`.npz`), of which nothing is unpickled."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.format import MAGIC_PREFIX

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure
from pfnn_jax.io.npy import check_size

MAX_EXPANDED = 2**29
"""Bytes to which an array of a compressed archive may expand."""

ZIP = b"PK"  # first bytes of an archive


def read_arrays(file: Path, names: Sequence[str], rule: str) -> dict[str, np.ndarray]:
    """Returns those of the named arrays that a `.npz` file holds.

    Args:
        file: the archive; nothing in it is unpickled.
        names: of the arrays.
        rule: what the file should be, for messages.

    Raises:
        InputError: if the file cannot be read, is not an archive, or holds an array that states another size than it
            has or expands too far.
    """
    try:
        with file.open("rb") as stream:  # opened here, because NumPy leaves a damaged file open
            arrays = _load(stream)
            if not isinstance(arrays, np.lib.npyio.NpzFile) or arrays.zip is None:
                raise InputError(file, "file", "a single array", rule)
            found = [name for name in names if name in arrays]
            for name in found:
                _check_member(arrays.zip, name)
            return {name: arrays[name] for name in found}
    except InputError:
        raise
    except Exception as error:  # damaged archives raise a dozen kinds, from `zlib.error` to `NotImplementedError`
        raise InputError(file, "file", failure(error)[:200], rule) from error


def _check_member(archive: zipfile.ZipFile, name: str) -> None:
    """Refuses an array that needs more bytes than it has, or than are taken of a compressed one.

    Raises:
        ValueError: naming the array.
    """
    info = archive.getinfo(f"{name}.npy" if f"{name}.npy" in archive.NameToInfo else name)
    if info.file_size > max(MAX_EXPANDED, info.compress_size):
        raise ValueError(f"array {name} expands to {info.file_size} bytes; must be at most {MAX_EXPANDED}")
    with archive.open(info) as stream:
        check_size(stream, info.file_size)  # type: ignore[arg-type] # reads as a binary file


def _load(stream: BinaryIO) -> Any:
    """Loads a NumPy file.

    Raises:
        ValueError: for any other file, which NumPy would offer to unpickle; nothing is ever unpickled.
    """
    begins = stream.read(len(MAGIC_PREFIX))
    if begins and not begins.startswith((ZIP, MAGIC_PREFIX)):
        raise ValueError("not a NumPy file")
    stream.seek(0)
    return np.load(stream, allow_pickle=False)


def as_floats(file: Path, name: str, values: np.ndarray) -> np.ndarray:
    """Returns the values of an array of a file in float64, of the same shape.

    Raises:
        InputError: if they are not real numbers, or one is not finite in float32, naming array, row and column.
    """
    if values.dtype.kind not in "fiu":
        raise InputError(file, f"array {name}", values.dtype, "must hold real numbers")
    floats = values.astype(np.float64)
    bad = np.argwhere(~(np.abs(floats) <= np.finfo(np.float32).max))
    if len(bad):
        place = ", ".join(f"{axis} {i}" for axis, i in zip(("row", "column"), bad[0].tolist(), strict=False))
        raise InputError(file, f"array {name}, {place}", floats[tuple(bad[0])], "must be a finite float32")
    return floats
