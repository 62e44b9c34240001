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
"""The opset in which networks are converted: the lowest whose reductions take axes as the converter writes them."""

OPSETS = range(15, 23)
"""Opsets that can be written: onnx converts all networks to them, without a change of the outputs. It cannot convert
`Shape` to an opset below 15."""

OPERATORS = frozenset(
    (
        *("Abs", "Add", "Cast", "Concat", "ConstantOfShape", "Div", "Elu", "Exp", "Expand", "Floor", "Gather", "Gemm"),
        *("Less", "Max", "Mul", "Pow", "Range", "ReduceMax", "ReduceMean", "ReduceSum", "Reshape", "Shape", "Slice"),
        *("Sqrt", "Squeeze", "Sub", "Unsqueeze"),
    )
)
"""All operators of exported networks, so that one can see whether an engine supports them. A test compares."""

TOLERANCE = 1e-5
"""Largest `relative_error` allowed between onnxruntime and JAX; measured errors are near 1e-6."""

_NOISY = ("jax2onnx", "onnx_ir")


def write_onnx(path: Path, function: BatchFunction, rows: dict[str, np.ndarray], opset: int = OPSET) -> dict[str, Any]:
    """Converts a function of batches to ONNX, checks it on rows and writes it.

    Args:
        path: the file to write.
        function: takes the arrays of `rows` in their order.
        rows: named inputs [N, ...], float32; the inputs of the file have these names and any batch size.
        opset: version of the operators, one of `OPSETS`.

    Returns:
        Opset, number of rows and the largest relative error on them.

    Raises:
        InputError: for another opset, if a library is missing, or if onnxruntime differs from JAX by more than
            `TOLERANCE`; nothing is written in that case.
    """
    check_opset(path, opset)
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
    model = _with_opset(model, opset)
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
    return {"opset": opset, "relative_error": error, "rows": len(expected)}


def check_opset(source: str | Path, opset: int) -> None:
    """Refuses an opset that cannot be written."""
    if opset not in OPSETS:
        raise InputError(source, "opset", opset, f"must be from {OPSETS[0]} to {OPSETS[-1]}")


def _with_opset(model: Any, opset: int) -> Any:
    """Returns an ONNX model of opset `OPSET` in another, and in the lowest version of the format that has it."""
    import onnx
    from onnx import version_converter

    _drop_identities(model.graph)  # the converter of opsets knows no adapter for them
    if opset != OPSET:
        model = version_converter.convert_version(model, opset)
    model.ir_version = onnx.helper.find_min_ir_version_for(model.opset_import)
    return model


def _drop_identities(graph: Any) -> None:
    """Removes nodes that copy a value, which nodes below them then read directly. Those of an output stay."""
    outputs = {output.name for output in graph.output}
    copies = [node for node in graph.node if node.op_type == "Identity" and node.output[0] not in outputs]
    source = {node.output[0]: node.input[0] for node in copies}
    for node in copies:
        graph.node.remove(node)
    for node in graph.node:
        for index, name in enumerate(node.input):
            while name in source:
                name = source[name]
            node.input[index] = name


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
