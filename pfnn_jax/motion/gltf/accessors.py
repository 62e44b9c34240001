"""Reads accessors of a glTF file as arrays.

Source: glTF 2.0 specification, sections 3.6.2 (accessors, sparse accessors, normalised integers).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.container import Document, is_index, shown

COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
"""NumPy types by component type."""

SIZES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
"""Numbers by accessor type; 2 × 2 and 3 × 3 matrices occur in no character."""

MAX_NUMBERS = 16_000_000
"""Most numbers of an accessor: two million vertices have eight million weights."""

MAX_ZEROS = 1_000_000
"""Most numbers of an accessor without data of its own, whose zeros take memory but no room in the file."""


def read_accessor(document: Document, index: Any, kind: str, place: str) -> np.ndarray:
    """Returns the values of an accessor: [N] for scalars, else [N, size]; normalised integers as floats.

    Args:
        document: the file.
        index: number of the accessor, as in the JSON.
        kind: `SCALAR`, `VEC2`, `VEC3`, `VEC4` or `MAT4`.
        place: where the number stands, for messages.

    Raises:
        InputError: if there is no such accessor, it is of another kind, reaches beyond its buffer, or holds numbers
            that are not finite.
    """
    accessor = document.item("accessors", index, place)
    at = f"accessors[{index}]"
    if accessor.get("type") != kind:
        raise InputError(document.path, f"{at}.type", shown(accessor.get("type")), f"must be {kind} for {place}")
    dtype, count = _dtype(document, accessor, at), accessor.get("count")
    size = SIZES[kind]
    most = (MAX_ZEROS if accessor.get("bufferView") is None else MAX_NUMBERS) // size
    if not is_index(count, most + 1):
        raise InputError(document.path, f"{at}.count", shown(count), f"must be a number up to {most}")
    if accessor.get("bufferView") is None:
        values = np.zeros((count, size), dtype)
    else:
        values = _elements(document, accessor, dtype, count, size, at)
    values = _with_sparse(document, accessor, values, at)
    if dtype.kind == "f" and not np.isfinite(values).all():
        raise InputError(document.path, at, "not a finite number", f"must hold finite numbers for {place}")
    if accessor.get("normalized") and dtype.kind != "f":
        values = np.maximum(values / np.iinfo(dtype).max, -1.0)
    return values[:, 0] if kind == "SCALAR" else values


def _dtype(document: Document, accessor: dict[str, Any], at: str) -> np.dtype:
    component = accessor.get("componentType")
    if not isinstance(component, int) or component not in COMPONENTS:
        rule = f"must be one of {', '.join(map(str, COMPONENTS))}"
        raise InputError(document.path, f"{at}.componentType", shown(component), rule)
    return np.dtype(COMPONENTS[component])


def _elements(document: Document, part: dict[str, Any], dtype: np.dtype, count: int, size: int, at: str) -> np.ndarray:
    """Returns the elements [N, size] that lie in a buffer view."""
    view = document.item("bufferViews", part.get("bufferView"), f"{at}.bufferView")
    place = f"bufferViews[{part['bufferView']}]"
    document.item("buffers", view.get("buffer"), f"{place}.buffer")
    buffer = document.buffers[view["buffer"]]
    start, length = view.get("byteOffset", 0), view.get("byteLength")
    if not is_index(start, len(buffer) + 1) or not is_index(length, len(buffer) - start + 1):
        found = f"bytes {shown(start)} and {shown(length)} more"
        raise InputError(document.path, place, found, f"must lie within the buffer's {len(buffer)} bytes")
    element = size * dtype.itemsize
    stride, offset = view.get("byteStride", element), part.get("byteOffset", 0)
    if not is_index(stride, 1 << 16) or stride < element:
        raise InputError(document.path, f"{place}.byteStride", shown(stride), f"must be {element} or more, up to 65535")
    if not is_index(offset, length + 1) or (count and offset + (count - 1) * stride + element > length):
        found = f"{count} elements of {stride} bytes from byte {shown(offset)}"
        raise InputError(document.path, at, found, f"must lie within the {length} bytes of its buffer view")
    if count == 0:
        return np.zeros((0, size), dtype)
    return np.ndarray((count, size), dtype, buffer, start + offset, (stride, dtype.itemsize))


def _with_sparse(document: Document, accessor: dict[str, Any], values: np.ndarray, at: str) -> np.ndarray:
    """Returns the values with those that a sparse accessor replaces."""
    sparse = accessor.get("sparse")
    if sparse is None:
        return values
    sparse = sparse if isinstance(sparse, dict) else {}
    count, where, new = (sparse.get(name) for name in ("count", "indices", "values"))
    if not is_index(count, len(values) + 1) or not isinstance(where, dict) or not isinstance(new, dict):
        rule = f"must replace at most {len(values)} elements, with indices and values"
        raise InputError(document.path, f"{at}.sparse", shown(count), rule)
    kind = _dtype(document, where, f"{at}.sparse.indices")
    indices = _elements(document, where, kind, count, 1, f"{at}.sparse.indices")[:, 0].astype(np.int64)
    if kind.kind != "u" or (count and indices.max() >= len(values)):
        raise InputError(document.path, f"{at}.sparse.indices", "out of range", f"must be below {len(values)}")
    values = values.copy()
    values[indices] = _elements(document, new, values.dtype, count, values.shape[1], f"{at}.sparse.values")
    return values
