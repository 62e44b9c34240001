"""Exports a run to a folder that engines read: network, styles and description.json, written atomically."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.inference.predictor import assemble_predictor, make_predictor
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.interop.export import reference_loop
from pfnn_jax.interop.export.batch import batch_function, sample_rows
from pfnn_jax.interop.export.bins import FEW_TABLES, write_bins
from pfnn_jax.interop.export.description import FILE, SCHEMA, describe
from pfnn_jax.interop.export.formats import Format
from pfnn_jax.interop.export.onnx import OPSET, check_opset, write_onnx
from pfnn_jax.interop.export.stablehlo import write_stablehlo
from pfnn_jax.interop.export.styles import choose_styles, write_style
from pfnn_jax.io.files import refuse_existing, replacing
from pfnn_jax.run import Run, load_run

NUM_ROWS = 256
"""Rows on which an exported network is checked before it is published."""

_FILES = {"onnx": "network.onnx", "stablehlo": "network.stablehlo"}


def export_run(
    run_path: str | Path,
    format: Format,
    out: str | Path,
    *,
    style: StyleChoice = None,
    film_input: bool = False,
    opset: int | None = None,
    tables: int | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Exports the network of a run to a format that engines read.

    Args:
        run_path: the run.
        format: `onnx` or `stablehlo`, a function of x and phase with one style baked in; or `bins`, see `write_bins`.
        out: the folder to write.
        style: a style's name, or weights by name. None exports style-agnostic motion (for a FiLM run, the mean of its
            styles); for `bins` and with `film_input` it exports all styles.
        film_input: for a FiLM run, keep the style an input of the network (onnx, stablehlo), so that an engine can
            switch and mix styles; their parameters are written to `styles/`.
        tables: for `bins` of a phase-functioned network: number of tables over the phase, 4 (the default) or 50, see
            `write_bins`.
        opset: version of the ONNX operators, by default `onnx.OPSET`.
        overwrite: whether to replace an earlier export.

    Returns:
        The contents of `description.json`.

    Raises:
        InputError: for an unknown style, format or opset, an option that has no effect, a layout that the format does
            not support, a failed check, a missing library, a FiLM run without styles, or if `out` exists and is not an
            export or must not be replaced.
    """
    run, out = load_run(run_path), Path(out)
    if format not in ("onnx", "stablehlo", "bins"):
        raise InputError(run.path, "format", format, "must be onnx, stablehlo or bins")
    if opset is not None:
        if format != "onnx":
            raise InputError(run.path, "opset", format, "must be left out, except for the format onnx")
        check_opset(run.path, opset)
    if tables is not None and (format != "bins" or run.layout.phase_kind != "global"):
        found = run.layout.name if format == "bins" else format
        raise InputError(run.path, "tables", found, "must be left out, except for bins of a phase-functioned network")
    _check_place(out, overwrite)
    with replacing(out) as new:
        new.mkdir()
        if format == "bins":
            if film_input:
                raise InputError(
                    run.path,
                    "film input",
                    format,
                    "must be off for bins, which always stores styles in files of their own",
                )
            made = write_bins(new, run, style, tables or len(FEW_TABLES))
            description = describe(run, format, made.layout, made.normaliser, made.network, made.styles, style)
        else:
            network, styles = _write_function(new, run, format, style, film_input, opset or OPSET)
            description = describe(run, format, run.layout, run.normaliser, network, styles, style)
        _copy_loop(new)
        (new / FILE).write_text(json.dumps(description, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return description


def _write_function(
    folder: Path,
    run: Run,
    format: Literal["onnx", "stablehlo"],
    choice: StyleChoice,
    film_input: bool,
    opset: int,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    if film_input and run.config.adapter.kind != "film":
        rule = "requires FiLM styles; export one network per style instead"
        raise InputError(run.path, "film input", run.config.adapter.kind, rule)
    chosen = list(choose_styles(run, choice)) if film_input or choice is not None else []
    x, phase = sample_rows(run.normaliser, run.layout, NUM_ROWS)
    rows = {"x": x, "phase": phase}
    if film_input:
        films = np.stack([style.parameters.named_arrays()["film"] for style in chosen])
        rows["style"] = films[np.arange(NUM_ROWS) % len(films)].astype(np.float32)
        predictor = assemble_predictor(run.shared, chosen[0].parameters, run.normaliser)
    else:
        predictor = make_predictor(run, choice)
    function = batch_function(jax.tree.map(jnp.asarray, predictor), film_input)
    write = {"onnx": partial(write_onnx, opset=opset), "stablehlo": write_stablehlo}[format]
    info = write(folder / _FILES[format], function, rows)
    inputs = [{"name": name, "shape": ["B", *a.shape[1:]], "type": "float32"} for name, a in rows.items()]
    output = {"name": "y", "shape": ["B", run.layout.output_size], "type": "float32"}
    network = {"kind": "function", "file": _FILES[format], "inputs": inputs, "outputs": [output], **info}
    return network, [write_style(folder, style) for style in chosen]


def _copy_loop(folder: Path) -> None:
    """Puts the reference loop next to the network, for those who port it."""
    source = Path(reference_loop.__file__).parent
    target = folder / source.name
    target.mkdir()
    for file in sorted(source.glob("*.py")):
        (target / file.name).write_bytes(file.read_bytes())


def _check_place(out: Path, overwrite: bool) -> None:
    """Refuses an output folder that must not be replaced or is not an export."""
    if Path.cwd().is_relative_to(out.resolve()):  # the folder is replaced as a whole
        raise InputError(out, "output", "contains the working directory", "must be a separate folder")
    if not out.exists() or (out.is_dir() and not any(out.iterdir())):
        return
    refuse_existing(out, overwrite)
    try:
        known = json.loads((out / FILE).read_text(encoding="utf-8")).get("schema") == SCHEMA
    except (OSError, ValueError, AttributeError):
        known = False
    if not known:
        raise InputError(
            out, "output", "exists but is not an export", "choose another folder; only an earlier export is replaced"
        )
