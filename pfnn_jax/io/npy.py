"""`.npy` files that grow: rows are appended as they come, and the number of rows is written at the end."""

from __future__ import annotations

from pathlib import Path

import numpy as np

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
