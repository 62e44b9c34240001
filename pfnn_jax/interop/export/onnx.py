"""Writes a network as an ONNX file after checking that onnxruntime reproduces JAX."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.interop.export.batch import BatchFunction, relative_error

OPSET = 18
"""The lowest opset whose reductions take axes as the converter writes them."""

TOLERANCE = 1e-5
"""Largest `relative_error` allowed between onnxruntime and JAX; measured errors are near 1e-6."""

_NOISY = ("jax2onnx", "onnx_ir")


def write_onnx(path: Path, function: BatchFunction, rows: dict[str, np.ndarray]) -> dict[str, Any]:
    """Converts a function of batches to ONNX, checks it on rows and writes it.

    Args:
        path: the file to write.
        function: takes the arrays of `rows` in their order.
        rows: named inputs [N, ...], float32; the inputs of the file have these names and any batch size.

    Returns:
        Opset, number of rows and the largest relative error on them.

    Raises:
        InputError: if a library is missing, or if onnxruntime differs from JAX by more than `TOLERANCE`; nothing is
            written in that case.
    """
    with _quiet():
        try:
            import onnx
            import onnxruntime
            from jax2onnx import to_onnx
        except ImportError as error:
            raise InputError(
                path, "format", "onnx", "install the export extra: `pip install '.[export]'` in the project folder"
            ) from error
        shapes = [("B", *array.shape[1:]) for array in rows.values()]
        model = to_onnx(
            function, shapes, input_names=list(rows), output_names=["y"], model_name="pfnn_jax", opset=OPSET
        )
    onnx.checker.check_model(model)
    content = model.SerializeToString()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    with jax.default_matmul_precision("highest"):
        expected = np.asarray(jax.jit(function)(*rows.values()))
    error = relative_error(np.asarray(session.run(["y"], rows)[0]), expected)
    if not error <= TOLERANCE:
        raise InputError(
            path, "relative error", f"{error:.1e}", f"must be at most {TOLERANCE:g} between onnxruntime and JAX"
        )
    path.write_bytes(content)
    return {"opset": OPSET, "relative_error": error, "rows": len(expected)}


@contextmanager
def _quiet() -> Iterator[None]:
    """Silences the converter, which warns about every JAX operation it does not know, needed or not."""
    loggers = [logging.getLogger(name) for name in _NOISY]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
