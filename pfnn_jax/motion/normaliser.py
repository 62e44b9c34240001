"""Mean and standard deviation of network inputs and outputs: fitted once over all styles, reused by every later one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.layout import Block, FrameLayout

JOINT_INPUT_WEIGHT = 0.1
"""Scale of normalised joint inputs under grouped statistics, as the authors' code has it."""

CONSTANT = 1e-6
"""A deviation below this share of (1 + |mean|) is rounding of float32: the column is constant."""

CHUNK = 16384  # rows per pass: bounds memory where the arrays are memory-mapped

Arrays = np.ndarray | Sequence[np.ndarray]


@dataclass(frozen=True, eq=False)
class Statistics:
    """Mean and standard deviation of each column.

    Attributes:
        mean: [D] float32.
        std: [D] float32, never zero.
    """

    mean: np.ndarray
    std: np.ndarray

    def apply(self, v: Any) -> Any:
        """Normalised values of v [..., D]; NumPy or JAX arrays."""
        return (v - self.mean) / self.std

    def invert(self, v: Any) -> Any:
        """Values in layout units of normalised v [..., D]; NumPy or JAX arrays."""
        return v * self.std + self.mean


@dataclass(frozen=True, eq=False)
class Normaliser:
    """Statistics of x and of y."""

    inputs: Statistics
    outputs: Statistics


def fit_normaliser(x: Arrays, y: Arrays, layout: FrameLayout, grouped: bool = False) -> Normaliser:
    """One normaliser over all rows of all styles.

    By default every column has its own deviation (the paper); constant columns get 1. With `grouped`, as the authors'
    code does, deviations are averaged over each block (x and z of the outputs' trajectory together), and those of
    the input blocks `joint_position` and `joint_velocity` are divided by 0.1, so that joints weigh a tenth of the
    trajectory at the network's input. The 0.1 exists only with `grouped`, and only for inputs.

    Args:
        x: [N, Dx] in layout units, or several such arrays (as one for each style).
        y: [N, Dy] likewise.
        layout: names the blocks.
        grouped: average deviations over blocks.

    Raises:
        InputError: for no rows, another width than the layout's, or a value that is not finite.
    """
    inputs = _fit(x, layout.inputs, "x", layout)
    outputs = _fit(y, layout.outputs, "y", layout)
    if grouped:
        inputs = _average(inputs, layout.inputs, _input_group)
        outputs = _average(outputs, layout.outputs, _output_group)
    return Normaliser(_guard(inputs), _guard(outputs))


def save_normaliser(folder: Path, normaliser: Normaliser) -> None:
    """Writes four `.npy` files into a folder, which is made where it is absent."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, value in _files(normaliser).items():
        np.save(folder / name, value, allow_pickle=False)


def load_normaliser(folder: Path) -> Normaliser:
    """Inverse of `save_normaliser`, exact to the last bit.

    Raises:
        InputError: if a file is missing, is no array of one axis, or holds a value that is not finite.
    """
    found = {name: _load(folder / name) for name in ("x_mean.npy", "x_std.npy", "y_mean.npy", "y_std.npy")}
    for side in "xy":
        mean, std = found[f"{side}_mean.npy"], found[f"{side}_std.npy"]
        if mean.shape != std.shape or not (std > 0).all():
            raise InputError(
                folder / f"{side}_std.npy",
                "array",
                f"shape {std.shape}, least {std.min(initial=np.inf)}",
                f"deviations are positive, one for each of {len(mean)} means",
            )
    return Normaliser(
        Statistics(found["x_mean.npy"], found["x_std.npy"]), Statistics(found["y_mean.npy"], found["y_std.npy"])
    )


def require_finite(values: np.ndarray, blocks: tuple[Block, ...], source: str | Path, name: str) -> None:
    """Refuses rows that hold NaN or infinity.

    Args:
        values: [N, D].
        blocks: (name, size) of the columns.
        source: file the rows come from.
        name: of the array.

    Raises:
        InputError: naming the first row and block.
    """
    finite = np.isfinite(values)
    if finite.all():
        return
    row, column = (int(i) for i in np.argwhere(~finite)[0])
    starts = np.cumsum([size for _, size in blocks])
    block = blocks[int(np.searchsorted(starts, column, side="right"))][0]
    raise InputError(source, f"{name} row {row}, {block}", values[row, column], "every value must be finite")


def _fit(arrays: Arrays, blocks: tuple[Block, ...], name: str, layout: FrameLayout) -> Statistics:
    arrays = [arrays] if isinstance(arrays, np.ndarray) else list(arrays)
    width = sum(size for _, size in blocks)
    for array in arrays:
        if array.ndim != 2 or array.shape[1] != width:
            raise InputError(name, "array", f"shape {array.shape}", f"layout {layout.name} has {width} columns")
    count = sum(len(array) for array in arrays)
    if count == 0:
        raise InputError(name, "array", "0 rows", "statistics need at least one row")
    total = np.zeros(width)
    for chunk in _chunks(arrays):
        require_finite(chunk, blocks, name, "array")
        total += chunk.sum(axis=0, dtype=np.float64)
    mean, square = total / count, np.zeros(width)
    for chunk in _chunks(arrays):
        deviation = chunk - mean
        square += np.einsum("nd,nd->d", deviation, deviation)
    return Statistics(mean, np.sqrt(square / count))


def _chunks(arrays: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
    for array in arrays:
        for start in range(0, len(array), CHUNK):
            yield np.asarray(array[start : start + CHUNK])


def _input_group(block: str) -> tuple[str, float]:
    return block, JOINT_INPUT_WEIGHT if block in ("joint_position", "joint_velocity") else 1.0


def _output_group(block: str) -> tuple[str, float]:
    return block.removesuffix("_x").removesuffix("_z"), 1.0


def _average(found: Statistics, blocks: tuple[Block, ...], group: Callable[[str], tuple[str, float]]) -> Statistics:
    names = np.repeat([group(block)[0] for block, _ in blocks], [size for _, size in blocks])
    weights = np.repeat([group(block)[1] for block, _ in blocks], [size for _, size in blocks])
    std = np.empty_like(found.std)
    for name in dict.fromkeys(names):
        std[names == name] = found.std[names == name].mean()
    return Statistics(found.mean, std / weights)


def _guard(found: Statistics) -> Statistics:
    constant = found.std <= CONSTANT * (1.0 + np.abs(found.mean))
    return Statistics(found.mean.astype(np.float32), np.where(constant, 1.0, found.std).astype(np.float32))


def _files(normaliser: Normaliser) -> dict[str, np.ndarray]:
    return {
        "x_mean.npy": normaliser.inputs.mean,
        "x_std.npy": normaliser.inputs.std,
        "y_mean.npy": normaliser.outputs.mean,
        "y_std.npy": normaliser.outputs.std,
    }


def _load(path: Path) -> np.ndarray:
    try:
        value = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise InputError(path, "array", error, "statistics are written by save_normaliser") from error
    if value.ndim != 1 or not np.isfinite(value).all():
        raise InputError(path, "array", f"shape {value.shape}", "one axis of finite values")
    return value
