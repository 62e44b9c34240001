"""Normalises network inputs and outputs by statistics that are fitted once over all styles and reused by later ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.npy import load_array
from pfnn_jax.motion.features.layout import FrameLayout

JOINT_INPUT_WEIGHT = 0.1
"""Scale of normalised joint inputs under grouped statistics, as in the authors' code."""

CONSTANT = 1e-6
"""Below this share of (1 + |mean|) a std is only float32 rounding, and the column is treated as constant."""

ROWS_PER_PASS = 16384  # bounds memory where the arrays are memory-mapped

Arrays = np.ndarray | Sequence[np.ndarray]

FILE_PREFIXES = ("x", "y", "p")  # inputs, outputs, gating input


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
    """Statistics of inputs, outputs and, where it is a vector, of the gating input.

    Attributes:
        inputs: of x.
        outputs: of y.
        phases: of the gating input [N, G]; None for a scalar phase, which is not normalised.
    """

    inputs: Statistics
    outputs: Statistics
    phases: Statistics | None = None

    def initial_phase(self) -> np.ndarray:
        """Returns a gating input from which a rollout can start: phase 0 [], or the mean [G] where it is a vector."""
        return np.zeros((), np.float32) if self.phases is None else self.phases.mean.astype(np.float32)


def fit_normaliser(
    x: Arrays, y: Arrays, layout: FrameLayout, grouped: bool = False, phase: Arrays | None = None
) -> Normaliser:
    """Fits one normaliser to all rows of all styles.

    By default every column has its own std (the paper); constant columns get 1. With `grouped`, as in the authors'
    code, stds are averaged over each block (x and z of the outputs' trajectory together), and those of
    the input blocks `joint_position` and `joint_velocity` are divided by 0.1, so that joints weigh a tenth of the
    trajectory at the network's input. The 0.1 exists only with `grouped`, and only for inputs.

    Args:
        x: [N, Dx] in layout units, or several such arrays (as one for each style).
        y: [N, Dy] likewise.
        layout: names the blocks.
        grouped: whether to average stds over blocks.
        phase: [N, G] likewise, where the layout's `phase_size` is G > 0; None leaves its statistics out. Every column
            has its own std. A scalar phase is not normalised.

    Raises:
        InputError: for no rows, another width than the layout's, or a value that is not finite.
    """
    inputs = _fit(x, layout.input_names, "x", layout)
    outputs = _fit(y, layout.output_names, "y", layout)
    phases = None
    if phase is not None and layout.phase_size:
        phases = _guard(_fit(phase, (layout.phase_kind,) * layout.phase_size, "phase", layout))
    if grouped:
        inputs = _average(inputs, layout.input_names, _input_group)
        outputs = _average(outputs, layout.output_names, _output_group)
    return Normaliser(_guard(inputs), _guard(outputs), phases)


def save_normaliser(folder: Path, normaliser: Normaliser) -> None:
    """Writes four `.npy` files, or six where the gating input has statistics, into a folder that is made if needed."""
    for prefix, statistics in zip(
        FILE_PREFIXES, (normaliser.inputs, normaliser.outputs, normaliser.phases), strict=True
    ):
        if statistics is not None:
            save_statistics(folder, statistics, prefix)
            continue
        for name in ("mean", "std"):
            # a file of a normaliser that was saved here before
            (folder / f"{prefix}_{name}.npy").unlink(missing_ok=True)


def save_statistics(folder: Path, statistics: Statistics, prefix: str) -> None:
    """Writes `PREFIX_mean.npy` and `PREFIX_std.npy` into a folder that is made if needed."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("mean", "std"):
        np.save(folder / f"{prefix}_{name}.npy", getattr(statistics, name), allow_pickle=False)


def load_normaliser(folder: Path) -> Normaliser:
    """Loads what `save_normaliser` wrote, exact to the last bit.

    Raises:
        InputError: if a file is missing, is not an array of one axis, or holds a value that is not finite.
    """
    phases = any((folder / f"p_{name}.npy").exists() for name in ("mean", "std"))
    return Normaliser(*(load_statistics(folder, side) for side in (FILE_PREFIXES if phases else FILE_PREFIXES[:2])))


def load_statistics(folder: Path, prefix: str) -> Statistics:
    """Loads what `save_statistics` wrote, exact to the last bit.

    Raises:
        InputError: if a file is missing, is not an array of one axis, or holds a value that is not finite, or if a
            standard deviation is not positive.
    """
    mean, std = (_load(folder / f"{prefix}_{name}.npy") for name in ("mean", "std"))
    if mean.shape != std.shape or not (std > 0).all():
        raise InputError(
            folder / f"{prefix}_std.npy",
            "array",
            f"shape {std.shape}, least {std.min(initial=np.inf)}",
            f"must hold {len(mean)} positive values, one for each mean",
        )
    return Statistics(mean, std)


@dataclass(frozen=True, eq=False)
class Moments:
    """Count, mean and sum of squared deviations of rows of D columns, which can be merged with those of other rows.

    Attributes:
        count: rows.
        mean: [D] float64.
        squares: [D] float64, sum of squared deviations from the mean.
    """

    count: int
    mean: np.ndarray
    squares: np.ndarray

    def merge(self, other: Moments) -> Moments:
        """Returns the moments of both sets of rows together (Chan, Golub and LeVeque 1979)."""
        if not self.count or not other.count:
            return other if not self.count else self
        count = self.count + other.count
        step = other.mean - self.mean
        share = other.count / count
        return Moments(
            count, self.mean + share * step, self.squares + other.squares + step * step * (self.count * share)
        )

    def rows(self) -> np.ndarray:
        """Returns two rows [2, D] float64 of equal mean and std, which replace all rows in `fit_normaliser`."""
        std = np.sqrt(self.squares / max(self.count, 1))
        return np.stack([self.mean - std, self.mean + std])


NO_ROWS = Moments(0, np.zeros(1), np.zeros(1))
"""Moments of no rows, of any number of columns."""


def moments_of(rows: np.ndarray) -> Moments:
    """Returns the moments of rows [N, D]."""
    values = rows.astype(np.float64)
    mean = values.mean(axis=0) if len(values) else np.zeros(values.shape[1])
    values -= mean
    return Moments(len(values), mean, np.einsum("nd,nd->d", values, values))


def require_finite(values: np.ndarray, names: Sequence[str], source: str | Path, name: str) -> None:
    """Refuses rows that hold NaN or infinity.

    Args:
        values: [N, D].
        names: [D] block of every column, as `layout.input_names`.
        source: file the rows come from.
        name: of the array.

    Raises:
        InputError: naming the first row and block.
    """
    finite = np.isfinite(values)
    if finite.all():
        return
    row, column = (int(i) for i in np.argwhere(~finite)[0])
    raise InputError(source, f"{name} row {row}, {names[column]}", values[row, column], "every value must be finite")


def _fit(arrays: Arrays, names: Sequence[str], name: str, layout: FrameLayout) -> Statistics:
    arrays = [arrays] if isinstance(arrays, np.ndarray) else list(arrays)
    width = len(names)
    for array in arrays:
        if array.ndim != 2 or array.shape[1] != width:
            raise InputError(name, "array", f"shape {array.shape}", f"layout {layout.name} has {width} columns")
    count = sum(len(array) for array in arrays)
    if count == 0:
        raise InputError(name, "array", "0 rows", "statistics need at least one row")
    total = np.zeros(width)
    for chunk in _chunks(arrays):
        require_finite(chunk, names, name, "array")
        total += chunk.sum(axis=0, dtype=np.float64)
    mean, square = total / count, np.zeros(width)
    for chunk in _chunks(arrays):
        centred = chunk - mean
        square += np.einsum("nd,nd->d", centred, centred)
    return Statistics(mean, np.sqrt(square / count))


def _chunks(arrays: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
    for array in arrays:
        for start in range(0, len(array), ROWS_PER_PASS):
            yield np.asarray(array[start : start + ROWS_PER_PASS])


def _input_group(block: str) -> tuple[str, float]:
    return block, JOINT_INPUT_WEIGHT if block in ("joint_position", "joint_velocity") else 1.0


def _output_group(block: str) -> tuple[str, float]:
    return block.removesuffix("_x").removesuffix("_z"), 1.0


def _average(found: Statistics, blocks: Sequence[str], group: Callable[[str], tuple[str, float]]) -> Statistics:
    grouped = [group(block) for block in blocks]
    names, weights = np.array([name for name, _ in grouped]), np.array([weight for _, weight in grouped])
    std = np.empty_like(found.std)
    for name in dict.fromkeys(names):
        std[names == name] = found.std[names == name].mean()
    return Statistics(found.mean, std / weights)


def _guard(found: Statistics) -> Statistics:
    constant = found.std <= CONSTANT * (1.0 + np.abs(found.mean))
    return Statistics(found.mean.astype(np.float32), np.where(constant, 1.0, found.std).astype(np.float32))


def _load(path: Path) -> np.ndarray:
    value = load_array(path, "must be a file that save_normaliser wrote")
    if value.ndim != 1 or value.dtype.kind != "f" or not np.isfinite(value).all():
        raise InputError(path, "array", f"shape {value.shape}", "must have one axis and finite values")
    return value
