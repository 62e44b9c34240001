"""`.npy` files larger than memory: rows are appended as they come, and read where they are asked for."""

from __future__ import annotations

import math
import os
from io import FileIO
from itertools import pairwise
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


class StoredArray:
    """One array on disk, of which only the rows that are asked for are read.

    A memory map would do the same in fewer lines, but all pages that were ever read through it count as memory of the
    process; each row that is not in the system's cache costs a read of a hundred kilobytes around it; and a file that
    is cut short ends the process. Files are opened for each reading, so that no number of them exhausts the system's
    limit, and are refused once they are not the ones that were found first.

    Attributes:
        path: of the file.
        shape, dtype: of the array.
    """

    def __init__(self, path: Path, rule: str):
        """Reads the header of a file.

        Args:
            path: the file.
            rule: what it should be, for messages.

        Raises:
            InputError: if it cannot be read, is no array, or states another size than it has.
        """
        self.path, self._rule = path, rule
        try:
            with path.open("rb") as stream:
                status = os.fstat(stream.fileno())
                self.shape, self.dtype, in_columns = _read_header(stream, status.st_size)
                if in_columns or self.dtype.hasobject or not self.shape:
                    raise ValueError("must hold numbers, row after row")
                self._begin = stream.tell()
        except Exception as error:  # as in `load_array`
            raise InputError(path, "array", failure(error)[:200], rule) from error
        self._state = _state_of(status)

    def __len__(self) -> int:
        return self.shape[0]

    @property
    def size(self) -> int:
        """Returns the number of numbers."""
        return math.prod(self.shape)

    def __getitem__(self, rows: np.ndarray | slice) -> np.ndarray:
        """Reads rows [N, ...], by their numbers [N] or a slice; consecutive ones are read at once.

        Raises:
            IndexError: for a number outside the array.
            InputError: if the file cannot be read, or was changed since it was found.
        """
        if isinstance(rows, slice):
            rows = np.arange(len(self))[rows]
        if rows.size and not 0 <= rows.min() <= rows.max() < len(self):
            raise IndexError(f"rows must lie within the {len(self)} of {self.path}")
        found = np.empty((len(rows), *self.shape[1:]), self.dtype)
        if not rows.size:
            return found
        try:
            with self.path.open("rb", buffering=0) as stream:
                if _state_of(os.fstat(stream.fileno())) != self._state:
                    raise InputError(self.path, "file", "changed while it is read", self._rule)
                self._fill(stream, rows, found)
        except (OSError, EOFError) as error:
            raise InputError(self.path, "array", failure(error), self._rule) from error
        return found

    def _fill(self, stream: FileIO, rows: np.ndarray, found: np.ndarray) -> None:
        """Reads rows into an array, by one call for each run of consecutive ones."""
        width = self.dtype.itemsize * math.prod(self.shape[1:])
        room = found.reshape(-1).view(np.uint8).data
        edges = (np.flatnonzero(np.diff(rows) != 1) + 1).tolist()
        for first, stop in pairwise([0, *edges, len(rows)]):
            stream.seek(self._begin + int(rows[first]) * width)
            part = room[first * width : stop * width]
            while len(part):
                count = stream.readinto(part)
                if not count:
                    raise EOFError("the file has ended")
                part = part[count:]


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
    _read_header(stream, size)


def _read_header(stream: BinaryIO, size: int) -> tuple[tuple[int, ...], np.dtype, bool]:
    """Returns the shape and type of an array, and whether columns are stored one by one; raises as `check_size`."""
    version = npy_format.read_magic(stream)
    read = npy_format.read_array_header_1_0 if version == (1, 0) else npy_format.read_array_header_2_0
    shape, in_columns, dtype = read(stream)
    needed = stream.tell() + math.prod(shape) * dtype.itemsize
    if min(shape, default=0) < 0 or needed > size:
        raise ValueError(f"states shape {shape} of {dtype}, which is more than its {size} bytes")
    return shape, dtype, in_columns


def _state_of(status: os.stat_result) -> tuple[int, ...]:
    """Returns what differs between a file and one that has taken its place."""
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
