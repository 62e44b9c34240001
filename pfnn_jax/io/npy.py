"""`.npy` files that grow: rows are appended as they come, and the number of rows is written at the end."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.lib import format as npy_format

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure

HEADER = 128  # bytes: room for any number of rows, and rows start on a multiple of 64 as NumPy has them
MAGIC = b"\x93NUMPY\x01\x00"


class NpyWriter:
    """One array on disk, of which only the rows being appended are in memory.

    The file is complete after `close`.
    """

    def __init__(self, path: Path, dtype: np.dtype, width: tuple[int, ...]):
        """Opens a new file.

        Args:
            path: to write.
            dtype: of the numbers.
            width: shape of one row.

        Raises:
            OSError: if it cannot be written.
        """
        self.dtype, self.width, self.rows = np.dtype(dtype).newbyteorder("<"), width, 0
        self._file = path.open("wb")
        self._file.write(self._header())

    def append(self, rows: np.ndarray) -> None:
        """Adds rows [N, *width].

        Raises:
            ValueError: for rows of another width.
            OSError: if they cannot be written.
        """
        if rows.shape[1:] != self.width:
            raise ValueError(f"rows must be of shape [N, {self.width}], got {rows.shape}")
        self._file.write(np.ascontiguousarray(rows, self.dtype).data)
        self.rows += len(rows)

    def close(self) -> None:
        """Writes the number of rows, and closes the file."""
        if not self._file.closed:
            self._file.seek(0)
            self._file.write(self._header())
            self._file.close()

    def _header(self) -> bytes:
        shape = (self.rows, *self.width)
        text = f"{{'descr': '{self.dtype.str}', 'fortran_order': False, 'shape': {shape}, }}"
        room = HEADER - len(MAGIC) - 2
        return MAGIC + room.to_bytes(2, "little") + text.ljust(room - 1).encode("ascii") + b"\n"


def load_array(path: Path, rule: str, *, mapped: bool = False) -> np.ndarray:
    """Loads an array of a `.npy` file, of which nothing is unpickled.

    Args:
        path: the file.
        rule: what the file should be, for messages.
        mapped: map the file into memory, read-only; rows are then read when they are used.

    Raises:
        InputError: if it cannot be read, is no array, or states another size than it has.
    """
    try:
        with path.open("rb") as stream:
            check_size(stream, os.fstat(stream.fileno()).st_size)
        return np.load(path, mmap_mode="r" if mapped else None, allow_pickle=False)
    except Exception as error:  # damaged headers raise a dozen kinds, from `TokenError` to `OverflowError`
        raise InputError(path, "array", failure(error)[:200], rule) from error


def check_size(stream: BinaryIO, size: int) -> None:
    """Reads the header of an array, before NumPy makes room for as many numbers as it states.

    Args:
        stream: at the beginning of the array.
        size: bytes from there to the end.

    Raises:
        ValueError: if the array needs more bytes, or its header cannot be read.
    """
    version = npy_format.read_magic(stream)
    read = npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
    shape, _, dtype = read(stream)
    needed = stream.tell() + math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or needed > size:
        raise ValueError(f"states shape {shape} of {dtype}, which is more than its {size} bytes")
