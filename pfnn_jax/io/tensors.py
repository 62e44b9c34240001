"""Named arrays with text about them in one file, in the safetensors format: nothing in it can run.

A file begins with the size of its header (8 bytes), then has the header, a JSON object with type, shape and place of
every array and `__metadata__`, a mapping from text to text, and then the arrays' bytes. Files come from strangers:
sizes are checked before anything is read into memory.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure, write_whole

SUFFIX = ".safetensors"

MAX_BYTES = 2**28
"""Size of the largest file that is read. A style with full matrices, 8 experts and 1,024 hidden units has 34 MB."""

MAX_HEADER = 2**20
"""Size of the largest header, whose JSON is read as a whole; that of a style has some 10,000 bytes."""

METADATA = "__metadata__"

RULE = "must be a whole safetensors file"


def write_tensors(path: Path, arrays: Mapping[str, np.ndarray], metadata: Mapping[str, str]) -> None:
    """Writes arrays and text as a safetensors file, complete or not at all; the same content makes the same bytes.

    Args:
        path: the file; its folder must exist.
        arrays: by name, of any shape.
        metadata: in the order in which the file shows it.

    Raises:
        InputError: if the file cannot be written, or the metadata is larger than `read_tensors` accepts.
    """
    from safetensors.numpy import save

    data = save({name: np.asarray(array, order="C") for name, array in arrays.items()})
    size = int.from_bytes(data[:8], "little")
    # The library writes metadata in random order.
    header = {METADATA: dict(metadata), **json.loads(data[8 : 8 + size])}
    text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)  # arrays begin at a multiple of 8 bytes
    if len(text) > MAX_HEADER:
        raise InputError(path, "header", f"{len(text)} bytes", f"must have at most {MAX_HEADER} bytes")
    write_whole(path, len(text).to_bytes(8, "little") + text + data[8 + size :])


def read_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Reads the arrays of a safetensors file, which must all be float32, and its metadata.

    Raises:
        InputError: if the file cannot be read, is too large, truncated or malformed, or holds another type of number.
    """
    from safetensors import SafetensorError, deserialize

    metadata = read_metadata(path)
    try:
        tensors = deserialize(path.read_bytes())
    except OSError as error:
        raise InputError(path, "file", failure(error), RULE) from error
    except SafetensorError as error:
        raise InputError(path, "file", shown(str(error), 120), RULE) from error
    arrays = {}
    for name, tensor in sorted(tensors, key=lambda item: item[0]):
        if tensor["dtype"] != "F32":
            raise InputError(path, f"parameter {shown(name)}", tensor["dtype"], "must be F32 (float32)")
        arrays[name] = np.frombuffer(tensor["data"], "<f4").reshape(tensor["shape"])
    return arrays, metadata


def read_metadata(path: Path) -> dict[str, str]:
    """Reads the text about the arrays alone, from the file's header.

    Raises:
        InputError: if the file cannot be read, is too large or truncated, or its header is malformed.
    """
    try:
        if not path.is_file():
            raise InputError(path, "file", "is not a file" if path.exists() else "does not exist", RULE)
        total = path.stat().st_size
        if total > MAX_BYTES:
            raise InputError(path, "file", f"{total} bytes", f"must have at most {MAX_BYTES} bytes")
        with path.open("rb") as file:
            size = int.from_bytes(file.read(8), "little")
            if size > MAX_HEADER:
                raise InputError(path, "header", f"{size} bytes", f"must have at most {MAX_HEADER} bytes; {RULE}")
            text = file.read(size)
    except OSError as error:
        raise InputError(path, "file", failure(error), RULE) from error
    if len(text) < size or total < 8:
        raise InputError(path, "header", f"ends after {len(text)} of {size} bytes", RULE)
    return _metadata(path, text)


def shown(text: str, most: int = 60) -> str:
    """Returns text of a stranger's file as messages show it: short, in one line, without control characters."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:most])


def _metadata(path: Path, text: bytes) -> dict[str, str]:
    """Returns the metadata in the text of a header; Python's parser ends too deep a nesting with a RecursionError."""
    try:
        header = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(path, "header", "is not JSON", RULE) from error
    metadata = header.get(METADATA, {}) if isinstance(header, dict) else None
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise InputError(path, "header", "is malformed", RULE)
    return metadata
