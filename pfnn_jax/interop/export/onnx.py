"""A network as an ONNX file, written only when onnxruntime gives what JAX gives."""

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
"""The lowest whose reductions take axes as the converter writes them."""

TOLERANCE = 1e-5
"""Allowed difference between onnxruntime and JAX, see `relative_error`; measured ones are near 1e-6."""

_NOISY = ("jax2onnx", "onnx_ir")


def write_onnx(path: Path, function: BatchFunction, rows: dict[str, np.ndarray]) -> dict[str, Any]:
    """Converts a function of batches to ONNX, checks it on rows and writes it.

    Args:
        path: of the file.
        function: of the rows' arrays in their order.
        rows: named inputs [N, ...], float32; the file's inputs have these names, and N may be any number.

    Returns:
        Opset, inputs, output and the largest relative error on the rows.

    Raises:
        InputError: if a library is missing, or onnxruntime differs from JAX by more than `TOLERANCE`; nothing is
            written then.
    """
    with _quiet():
        try:
            import onnx
            import onnxruntime
            from jax2onnx import to_onnx
        except ImportError as error:
            raise InputError(path, "format", "onnx", "needs `pip install pfnn-jax[export]`") from error
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
        raise InputError(path, "relative error", f"{error:.1e}", f"onnxruntime must agree with JAX to {TOLERANCE:g}")
    path.write_bytes(content)
    return {"opset": OPSET, "relative_error": error, "rows": len(expected)}


@contextmanager
def _quiet() -> Iterator[None]:
    """The converter warns of every operation of JAX that it does not know, needed or not."""
    loggers = [logging.getLogger(name) for name in _NOISY]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
