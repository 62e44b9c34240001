"""Writes a network as a serialised StableHLO program (`jax.export`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jax
import jax.export
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.interop.export.batch import BatchFunction

PLATFORMS = ("cpu", "cuda", "rocm", "tpu")


def write_stablehlo(path: Path, function: BatchFunction, rows: dict[str, np.ndarray]) -> dict[str, Any]:
    """Serialises a batched function for any batch size, and checks it by reading it back.

    Args:
        path: the file to write; `jax.export.deserialize` reads its bytes, `.call` runs it.
        function: takes the arrays of `rows` in their order.
        rows: named inputs [N, ...], float32.

    Returns:
        The version of the calling convention, the platforms and the version of JAX.

    Raises:
        InputError: if the program does not reproduce the function bit for bit.
    """
    (batch,) = jax.export.symbolic_shape("b")
    shapes = [jax.ShapeDtypeStruct((batch, *array.shape[1:]), array.dtype) for array in rows.values()]
    with jax.default_matmul_precision("highest"):
        compiled = jax.jit(function)
        exported = jax.export.export(compiled, platforms=PLATFORMS)(*shapes)
        content = bytes(exported.serialize())
        expected = np.asarray(compiled(*rows.values()))
    found = np.asarray(jax.export.deserialize(bytearray(content)).call(*rows.values()))
    if not np.array_equal(found, expected):
        worst = float(np.abs(found - expected).max())
        raise InputError(path, "round trip", f"differs by {worst:.1e}", "must reproduce the function bit for bit")
    path.write_bytes(content)
    return {
        "calling_convention_version": exported.calling_convention_version,
        "platforms": list(PLATFORMS),
        "jax": jax.__version__,
    }
