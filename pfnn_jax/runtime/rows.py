"""A network evaluated on rows of inputs, from arrays or from a file, in the layout's units."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.runtime.lookup import table_phase
from pfnn_jax.runtime.predictor import evaluate, make_predictor
from pfnn_jax.training.checkpoint import replacing
from pfnn_jax.training.run import Run, load_run

RowMode = Literal["cubic", "constant50", "nearest50"]

CHUNK = 1024
"""Rows in one call."""


def predict_rows(
    run: Run, x: np.ndarray, phase: np.ndarray, style: str | None = None, mode: RowMode = "cubic"
) -> np.ndarray:
    """The network's outputs for independent frames, in float32 without reduced-precision products.

    Args:
        run: as `load_run` returns it.
        x: [N, Dx] inputs in layout units.
        phase: [N] radians, any real numbers.
        style: name of a style of the run, or None for style-agnostic motion.
        mode: the exact spline, or the spline at the phase of the table entry that would serve (see `lookup`).

    Returns:
        [N, Dy] outputs in layout units.

    Raises:
        InputError: for an unknown style.
        ValueError: for an unknown mode.
    """
    predictor = make_predictor(run, style)
    turned = np.mod(np.asarray(phase, np.float64), 2 * math.pi).astype(np.float32)
    phases = turned if mode == "cubic" else np.asarray(table_phase(jnp.asarray(turned), mode))
    y = np.empty((len(x), run.layout.output_size), np.float32)
    with jax.default_matmul_precision("highest"):
        for start in range(0, len(x), CHUNK):
            rows = slice(start, start + CHUNK)
            y[rows] = _evaluate_rows(predictor, jnp.asarray(x[rows], jnp.float32), phases[rows])
    return y


def predict_file(
    run_path: str | Path,
    in_npz: str | Path,
    out_npz: str | Path,
    *,
    style: str | None = None,
    mode: RowMode = "cubic",
    overwrite: bool = False,
) -> np.ndarray:
    """Evaluates a run on the rows of a file and writes its outputs into another.

    Args:
        run_path: the run directory.
        in_npz: arrays `x` [N, Dx] in the layout's units and `phase` [N] in radians.
        out_npz: gets `y` [N, Dy] in the layout's units.
        style, mode: as in `predict_rows`.
        overwrite: replace an existing output file.

    Returns:
        y.

    Raises:
        InputError: for a run, a style or an input file that is not as it should be (naming array, row and column),
            or if the output exists and `overwrite` is not set.
    """
    run, out = load_run(run_path), Path(out_npz)
    if out.exists() and not overwrite:
        raise InputError(out, "output", "exists", "existing output is replaced only with --overwrite")
    x, phase = _read_rows(Path(in_npz), run.layout.input_size)
    y = predict_rows(run, x, phase, style, mode)
    with replacing(out) as new, new.open("wb") as file:
        np.savez(file, y=y)
    return y


_evaluate_rows = jax.jit(jax.vmap(evaluate, (None, 0, 0)))


def _read_rows(file: Path, width: int) -> tuple[np.ndarray, np.ndarray]:
    rule = "must be a NumPy .npz file with arrays x and phase"
    try:
        with file.open("rb") as stream:  # opened here, because NumPy leaves a damaged file open
            arrays = np.load(stream, allow_pickle=False)
            if not isinstance(arrays, np.lib.npyio.NpzFile):
                raise InputError(file, "file", "a single array", rule)
            for name in ("x", "phase"):
                if name not in arrays:
                    raise InputError(file, f"array {name}", "absent", rule)
            x, phase = arrays["x"], arrays["phase"]
    except InputError:
        raise
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        reason = getattr(error, "strerror", None) or str(error).splitlines()[0]
        raise InputError(file, "file", reason, rule) from error
    if x.ndim != 2 or x.shape[1] != width or len(x) == 0:
        raise InputError(file, "array x", f"shape {x.shape}", f"must be rows of {width} columns, at least one")
    if phase.shape != x.shape[:1]:
        raise InputError(file, "array phase", f"shape {phase.shape}", f"must hold one phase for each of {len(x)} rows")
    return _as_floats(file, "x", x), _as_floats(file, "phase", phase)


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
