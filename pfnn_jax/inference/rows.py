"""Evaluates a network on rows of inputs, from arrays or from a file, in the units of the layout."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.inference.lookup import table_phase
from pfnn_jax.inference.mixture import load_bank, mix_rows
from pfnn_jax.inference.modes import LayerNorm, Mode
from pfnn_jax.inference.predictor import Predictor, evaluate, make_predictor
from pfnn_jax.inference.style_choice import StyleChoice, check_weights
from pfnn_jax.io.files import refuse_existing, replacing
from pfnn_jax.io.npz import as_floats, read_arrays
from pfnn_jax.models.layers.film import FiLMStyle, layer_norm, layer_norm_sample
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.run import Run, load_run


@dataclass(frozen=True, eq=False)
class InputRows:
    """Independent frames.

    Attributes:
        x: [N, Dx] in layout units.
        gating_input: [N] radians, or [N, G] in layout units.
        styles: [N, M] int, or None.
        weights: [N, M], or None.
        style_array: name of the array that gave the styles.
    """

    x: np.ndarray
    gating_input: np.ndarray
    styles: np.ndarray | None = None
    weights: np.ndarray | None = None
    style_array: str = "styles"


def read_rows(file: Path, layout: FrameLayout) -> InputRows:
    """Reads the rows of a `.npz` file (see `predict_file`).

    Raises:
        InputError: if the file cannot be read, or an array is missing, has another shape or type, or contains a value
            that is not a finite float32; names array, row and column.
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
    x, phase = as_floats(file, "x", x), as_floats(file, name, phase)
    if "styles" in arrays:
        styles = _as_indices(file, "styles", arrays["styles"], (len(x), None))
        if "weights" not in arrays:
            raise InputError(file, "array weights", "absent", "must accompany array styles")
        weights = as_floats(file, "weights", arrays["weights"])
        if weights.shape != styles.shape:
            rule = f"must have the shape of styles, {styles.shape}"
            raise InputError(file, "array weights", f"shape {weights.shape}", rule)
        return InputRows(x, phase, styles, weights)
    if "style" in arrays:
        styles = _as_indices(file, "style", arrays["style"], (len(x),))[:, None]
        return InputRows(x, phase, styles, np.ones(styles.shape), "style")
    return InputRows(x, phase)


def _phase_array(arrays: dict[str, np.ndarray], layout: FrameLayout) -> str:
    return "gating_x" if layout.phase_size and "gating_x" in arrays else "phase"


def _read_arrays(file: Path, layout: FrameLayout) -> dict[str, np.ndarray]:
    phase = "phase (or gating_x)" if layout.phase_size else "phase"
    rule = f"must be a NumPy .npz file with arrays x and {phase}"
    found = read_arrays(file, ("x", "phase", "gating_x", "style", "styles", "weights"), rule)
    for name in ("x", _phase_array(found, layout)):
        if name not in found:
            raise InputError(file, f"array {name}", "absent", rule)
    return found


def _as_indices(file: Path, name: str, values: np.ndarray, shape: tuple[int | None, ...]) -> np.ndarray:
    wanted = tuple(have if want is None else want for want, have in zip(shape, values.shape, strict=False))
    if values.ndim != len(shape) or values.shape != wanted or 0 in values.shape:
        rule = "must hold one index for each row" if len(shape) == 1 else "must hold indices for each row, [N, M]"
        raise InputError(file, f"array {name}", f"shape {values.shape}", rule)
    if values.dtype.kind not in "iu":
        raise InputError(file, f"array {name}", values.dtype, "must hold whole numbers")
    return values.astype(np.int64)


NORMS = {"population": layer_norm, "sample": layer_norm_sample}
"""Layer norms of FiLM styles: `population` as in the authors' runtime, `sample` as in their training graph."""

CHUNK = 1024
"""InputRows evaluated in one call."""


@dataclass(frozen=True, eq=False)
class RowStyles:
    """A style or mixture for every row.

    Attributes:
        indices: [N, M] int, into the `styles` of a run's configuration.
        weights: [N, M], every row sums to one.
    """

    indices: np.ndarray
    weights: np.ndarray


def predict_rows(
    run: Run,
    x: np.ndarray,
    gating_input: np.ndarray,
    style: StyleChoice | RowStyles = None,
    mode: Mode = "cubic",
    layer_norm: LayerNorm = "population",
) -> np.ndarray:
    """Returns the outputs of a run for independent frames, in float32 without reduced-precision products.

    Args:
        run: a loaded run.
        x: [N, Dx] inputs in layout units.
        gating_input: [N] radians, any real numbers; or [N, G] in layout units for a gating network.
        style: one choice for all rows, as `make_predictor` takes it, or one for every row.
        mode: `cubic` for the exact spline, else the phase is rounded to that of a table entry (see `lookup`).
        layer_norm: statistics of the layer norm of FiLM styles.

    Returns:
        [N, Dy] outputs in layout units.

    Raises:
        InputError: for an unknown style, weights that do not sum to one, or a table mode without a global phase.
        ValueError: for an unknown mode or layer norm.
    """
    if layer_norm not in NORMS:
        raise ValueError(f"`layer_norm` must be population or sample, got {layer_norm!r}.")
    if run.layout.phase_size:
        if mode != "cubic":
            raise InputError(run.path, "mode", mode, f"must be cubic: layout {run.layout.name} has no global phase")
        gating = np.asarray(gating_input, np.float32)
    else:
        turned = np.mod(np.asarray(gating_input, np.float64), 2 * math.pi).astype(np.float32)
        gating = turned if mode == "cubic" else np.asarray(table_phase(jnp.asarray(turned), mode))
    rows = np.asarray(x, np.float32), gating
    with jax.default_matmul_precision("highest"):
        if isinstance(style, RowStyles):
            return _predict_each(run, style, rows, layer_norm)
        return evaluate_rows(make_predictor(run, style), *rows, layer_norm=layer_norm)


def evaluate_rows(
    predictor: Predictor, x: np.ndarray, gating_input: np.ndarray, *, layer_norm: LayerNorm = "population"
) -> np.ndarray:
    """Returns the outputs [N, Dy] of a predictor for independent frames, in layout units.

    Args:
        predictor: the network and style.
        x: [N, Dx] inputs in layout units.
        gating_input: [N] radians, or [N, G] in layout units for a gating network.
        layer_norm: statistics of the layer norm of FiLM styles.
    """
    return _in_chunks(partial(_evaluate_rows, predictor, layer_norm=layer_norm), (x, gating_input))


def predict_file(
    run_path: str | Path,
    in_npz: str | Path,
    out_npz: str | Path,
    *,
    style: StyleChoice = None,
    mode: Mode = "cubic",
    layer_norm: LayerNorm = "population",
    overwrite: bool = False,
) -> np.ndarray:
    """Evaluates a run on the rows of a file and writes the outputs to another file.

    Args:
        run_path: the run directory.
        in_npz: arrays `x` [N, Dx] in the layout's units; `phase` [N] in radians, or `gating_x` (or `phase`) [N, G] for
            a gating network; and, where rows differ in style, `style` [N] or `styles` [N, M] with `weights` [N, M]:
            indices into the run's styles, and weights that sum to one.
        out_npz: receives `y` [N, Dy] in the layout's units.
        style: style of all rows, if the file contains none.
        mode, layer_norm: as in `predict_rows`.
        overwrite: whether to replace an existing output file.

    Returns:
        y.

    Raises:
        InputError: for a bad run, style or input file (naming array, row and column), if both the file and `style`
            give a style, or if the output exists and `overwrite` is not set.
    """
    run, out = load_run(run_path), Path(out_npz)
    refuse_existing(out, overwrite)
    rows = read_rows(Path(in_npz), run.layout)
    y = predict_rows(run, rows.x, rows.gating_input, _row_styles(Path(in_npz), rows, run, style), mode, layer_norm)
    with replacing(out) as new, new.open("wb") as file:
        np.savez(file, y=y)
    return y


def _row_styles(file: Path, rows: InputRows, run: Run, style: StyleChoice) -> StyleChoice | RowStyles:
    """Returns the checked styles of the file, or the choice for all rows."""
    if rows.styles is None or rows.weights is None:
        return style
    if style is not None:
        raise InputError(file, f"array {rows.style_array}", "present", "give a style once: in the file or by --style")
    known = len(run.config.styles)
    bad = np.argwhere((rows.styles < 0) | (rows.styles >= known))
    if len(bad):
        rule = f"must be an index into the {known} styles that the run was trained with"
        raise InputError(file, f"array {rows.style_array}, row {bad[0][0]}", rows.styles[tuple(bad[0])], rule)
    for row, weights in enumerate(rows.weights):
        check_weights(weights, file, f"array weights, row {row}")
    return RowStyles(rows.styles, rows.weights)


def _predict_each(run: Run, styles: RowStyles, rows: tuple[np.ndarray, np.ndarray], layer_norm: LayerNorm):
    """Predicts rows of different styles: FiLM styles are gathered from a bank, other kinds run group by group."""
    used, local = np.unique(styles.indices, return_inverse=True)
    names = [run.config.styles[index] for index in used]
    local = local.reshape(styles.indices.shape)
    weights = np.asarray(styles.weights, np.float32)
    if run.config.adapter.kind == "film":
        predictor, bank = make_predictor(run, names[0]), load_bank(run, names)
        bank = jax.tree.map(jnp.asarray, bank)
        call = partial(_evaluate_films, predictor, bank, layer_norm=layer_norm)
        return _in_chunks(call, (*rows, local, weights))
    y = np.empty((len(rows[0]), run.layout.output_size), np.float32)
    kinds, group = np.unique(np.concatenate([local, weights], axis=1), axis=0, return_inverse=True)
    for number, kind in enumerate(kinds):
        chosen = np.flatnonzero(group.reshape(-1) == number)
        shares: dict[str, float] = {}
        for index, weight in zip(*np.split(kind, 2), strict=True):
            shares[names[int(index)]] = shares.get(names[int(index)], 0.0) + float(weight)
        predictor = make_predictor(run, shares)
        y[chosen] = evaluate_rows(predictor, *(array[chosen] for array in rows), layer_norm=layer_norm)
    return y


def _in_chunks(call: Callable[..., jax.Array], arrays: tuple[np.ndarray, ...]) -> np.ndarray:
    """Calls a function on at most `CHUNK` rows at a time; the last chunk is padded so that one size is compiled."""
    count = len(arrays[0])
    parts = []
    for start in range(0, count, CHUNK):
        rows = np.minimum(np.arange(start, start + min(CHUNK, count)), count - 1)
        parts.append(np.asarray(call(*(jnp.asarray(array[rows]) for array in arrays))))
    return np.concatenate(parts)[:count]


@partial(jax.jit, static_argnames="layer_norm")
def _evaluate_rows(predictor: Predictor, x: jax.Array, gating_input: jax.Array, *, layer_norm: LayerNorm) -> jax.Array:
    return jax.vmap(partial(evaluate, predictor, norm=NORMS[layer_norm]))(x, gating_input)


@partial(jax.jit, static_argnames="layer_norm")
def _evaluate_films(
    predictor: Predictor,
    bank: FiLMStyle,
    x: jax.Array,
    gating_input: jax.Array,
    indices: jax.Array,
    weights: jax.Array,
    *,
    layer_norm: LayerNorm,
) -> jax.Array:
    def one(style: Style, x: jax.Array, gating_input: jax.Array) -> jax.Array:
        return evaluate(replace(predictor, style=style), x, gating_input, norm=NORMS[layer_norm])

    return jax.vmap(one)(mix_rows(bank, indices, weights), x, gating_input)
