"""Files of rows: inputs, phases and, where rows differ in it, styles; every number checked."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib.format import MAGIC_PREFIX

from pfnn_jax.errors import InputError
from pfnn_jax.motion.files import failure
from pfnn_jax.motion.layout import FrameLayout

ZIP = b"PK"  # with which an archive begins


@dataclass(frozen=True, eq=False)
class Rows:
    """Independent frames.

    Attributes:
        x: [N, Dx] in layout units.
        phase: [N] radians, or [N, G] in layout units.
        styles: [N, M] int, or None.
        weights: [N, M], or None.
        style_array: the array in which the styles stood.
    """

    x: np.ndarray
    phase: np.ndarray
    styles: np.ndarray | None = None
    weights: np.ndarray | None = None
    style_array: str = "styles"


def read_rows(file: Path, layout: FrameLayout) -> Rows:
    """The rows of a `.npz` file (see `predict_file`).

    Raises:
        InputError: for a file that cannot be read, an array that is missing, of another shape or type, or holds a
            number that is not a finite float32: naming array, row and column.
    """
    arrays = _read_arrays(file, layout)
    x = arrays["x"]
    if x.ndim != 2 or x.shape[1] != layout.input_size or len(x) == 0:
        rule = f"must be rows of {layout.input_size} columns, at least one"
        raise InputError(file, "array x", f"shape {x.shape}", rule)
    name = _phase_array(arrays, layout)
    phase, size = arrays[name], (len(x), layout.phase_size) if layout.phase_size else (len(x),)
    if phase.shape != size:
        each = f"{layout.phase_size} numbers" if layout.phase_size else "one phase"
        raise InputError(file, f"array {name}", f"shape {phase.shape}", f"must hold {each} for each of {len(x)} rows")
    x, phase = _as_floats(file, "x", x), _as_floats(file, name, phase)
    if "styles" in arrays:
        styles = _as_indices(file, "styles", arrays["styles"], (len(x), None))
        if "weights" not in arrays:
            raise InputError(file, "array weights", "absent", "must stand beside styles")
        weights = _as_floats(file, "weights", arrays["weights"])
        if weights.shape != styles.shape:
            rule = f"must have the shape of styles, {styles.shape}"
            raise InputError(file, "array weights", f"shape {weights.shape}", rule)
        return Rows(x, phase, styles, weights)
    if "style" in arrays:
        styles = _as_indices(file, "style", arrays["style"], (len(x),))[:, None]
        return Rows(x, phase, styles, np.ones(styles.shape), "style")
    return Rows(x, phase)


def _phase_array(arrays: dict[str, np.ndarray], layout: FrameLayout) -> str:
    return "gating_x" if layout.phase_size and "gating_x" in arrays else "phase"


def _read_arrays(file: Path, layout: FrameLayout) -> dict[str, np.ndarray]:
    phase = "phase (or gating_x)" if layout.phase_size else "phase"
    rule = f"must be a NumPy .npz file with arrays x and {phase}"
    try:
        with file.open("rb") as stream:  # opened here, because NumPy leaves a damaged file open
            arrays = _load(stream)
            if not isinstance(arrays, np.lib.npyio.NpzFile):
                raise InputError(file, "file", "a single array", rule)
            names = ("x", "phase", "gating_x", "style", "styles", "weights")
            found = {name: arrays[name] for name in names if name in arrays}
    except InputError:
        raise
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(file, "file", failure(error), rule) from error
    for name in ("x", _phase_array(found, layout)):
        if name not in found:
            raise InputError(file, f"array {name}", "absent", rule)
    return found


def _load(stream: BinaryIO) -> Any:
    """What a NumPy file holds.

    Raises:
        ValueError: for any other file. NumPy itself offers to unpickle those, which none of them is to be.
    """
    begins = stream.read(len(MAGIC_PREFIX))
    if begins and not begins.startswith((ZIP, MAGIC_PREFIX)):
        raise ValueError("not a NumPy file")
    stream.seek(0)
    return np.load(stream, allow_pickle=False)


def _as_indices(file: Path, name: str, values: np.ndarray, shape: tuple[int | None, ...]) -> np.ndarray:
    wanted = tuple(have if want is None else want for want, have in zip(shape, values.shape, strict=False))
    if values.ndim != len(shape) or values.shape != wanted or 0 in values.shape:
        rule = "must hold one index for each row" if len(shape) == 1 else "must hold indices for each row, [N, M]"
        raise InputError(file, f"array {name}", f"shape {values.shape}", rule)
    if values.dtype.kind not in "iu":
        raise InputError(file, f"array {name}", values.dtype, "must hold whole numbers")
    return values.astype(np.int64)


def _as_floats(file: Path, name: str, values: np.ndarray) -> np.ndarray:
    """The values in float64, all within the range of float32."""
    if values.dtype.kind not in "fiu":
        raise InputError(file, f"array {name}", values.dtype, "must hold real numbers")
    floats = values.astype(np.float64)
    bad = np.argwhere(~(np.abs(floats) <= np.finfo(np.float32).max))
    if len(bad):
        place = ", ".join(f"{axis} {i}" for axis, i in zip(("row", "column"), bad[0].tolist(), strict=False))
        raise InputError(file, f"array {name}, {place}", floats[tuple(bad[0])], "must be a finite float32")
    return floats
