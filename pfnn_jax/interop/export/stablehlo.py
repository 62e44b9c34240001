"""A network as a serialised StableHLO program (`jax.export`)."""

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
    """Serialises a function of batches for any batch size and reads it back to check it.

    Args:
        path: of the file; `jax.export.deserialize` reads its bytes, and `.call` runs it.
        function: of the rows' arrays in their order.
        rows: named inputs [N, ...], float32.

    Returns:
        The version of the calling convention, platforms and JAX's version.

    Raises:
        InputError: if the file does not compute bit for bit what the function computes.
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
        raise InputError(path, "round trip", f"differs by {worst:.1e}", "must be equal bit for bit")
    path.write_bytes(content)
    return {
        "calling_convention_version": exported.calling_convention_version,
        "platforms": list(PLATFORMS),
        "jax": jax.__version__,
    }
