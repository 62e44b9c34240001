"""Raw float32 files in the layouts of the authors' demos (Holden 2017, Mason 2018, Mason 2022).

`pfnn2017` and `mason2018` networks are written as tables over the phase: the four that determine them, or all fifty
that the demos read. CP styles of `mason2018` get separate files; other styles, such as output adapters, are added into
the tables. `mason2022`
networks keep their experts, and a style is four vectors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.inference.style_choice import StyleChoice
from pfnn_jax.interop.export.styles import ExportStyle, choose_styles
from pfnn_jax.interop.released.holden2017 import NUM_TABLES, spline_design
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.network import Network
from pfnn_jax.models.style import Style, Tree
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.units import authors2018, convert_columns
from pfnn_jax.run import Run

FEW_TABLES = (0, 12, 25, 37)
"""Tables from which the reference loop recovers the control points: those nearest to them, which the 2017 demo reads in
its cubic mode. The condition number of the recovery is 1.04."""

TABLES: dict[int, Sequence[int]] = {len(FEW_TABLES): FEW_TABLES, NUM_TABLES: range(NUM_TABLES)}
"""Indices of the tables that can be written, by their number."""

_STATISTICS = {"x": "X", "y": "Y", "phase": "GT_X"}


@dataclass(frozen=True, eq=False)
class Bins:
    """What was written, for the description.

    Attributes:
        layout, normaliser: frame layout and statistics in the units of the files.
        network: kind and sizes of the network, and its files.
        styles: name, kind and files of every style.
    """

    layout: FrameLayout
    normaliser: Normaliser
    network: dict[str, Any]
    styles: list[dict[str, Any]]


def write_bins(folder: Path, run: Run, choice: StyleChoice = None, tables: int = len(FEW_TABLES)) -> Bins:
    """Writes a run's network in the file layout of the authors' demo of its frame layout.

    Args:
        folder: to write into.
        run: a run of layout `pfnn2017`, `mason2018`, or `mason2022` with FiLM styles.
        choice: a style or a mixture. None writes all styles that have separate files (CP styles of `mason2018`, FiLM
            styles of `mason2022`), and otherwise the style-agnostic network.
        tables: for `pfnn2017` and `mason2018`: 4, or 50 as the demos read them.

    Raises:
        InputError: for another number of tables, a layout without a demo, or styles that the demo does not support.
    """
    name, kind = run.layout.name, run.config.adapter.kind
    if tables not in TABLES:
        raise InputError(run.path, "tables", tables, f"must be {' or '.join(map(str, TABLES))}")
    if name == "mason2022" and kind == "film":
        return _write_experts(folder, run, choose_styles(run, choice))
    if name not in ("pfnn2017", "mason2018"):
        rule = "must be pfnn2017, mason2018 or mason2022, which have a demo by the authors: use --format onnx"
        if name == "mason2022":
            rule = "must have FiLM styles for the demo of mason2022: use --format onnx"
        raise InputError(run.path, "layout", f"{name} with {kind} styles", rule)
    if kind == "film":
        raise InputError(
            run.path,
            "styles",
            kind,
            f"must not be film, because the demo of {name} has no layer norm: use --format onnx",
        )
    return _write_tables(folder, run, choice, TABLES[tables])


def _write_tables(folder: Path, run: Run, choice: StyleChoice, tables: Sequence[int]) -> Bins:
    split = run.layout.name == "mason2018"
    styles = choose_styles(run, choice, "cp") if split or choice is not None else ()
    separate = [style for style in styles if split and style.kind == "cp"]
    folded = [style for style in styles if style not in separate]
    layout, rows = run.layout, np.arange(run.layout.output_size)
    normaliser = run.normaliser
    if split:
        layout = authors2018(run.layout.num_joints)
        normaliser, rows = _convert(run.normaliser, run.layout, layout)
    _write_statistics(folder, normaliser)
    for index, c in zip(tables, spline_design(tables), strict=True):
        layers = network_at(run.shared, folded[0].parameters if folded else None, c)
        for n, (weights, biases) in enumerate(layers):
            order = rows if n == 2 else slice(None)
            _write(folder, f"W{n}_{index:03d}", weights[order])
            _write(folder, f"b{n}_{index:03d}", biases[order])
    entries = [{"name": s.name, "kind": s.kind, "files": _write_cp(folder, s, tables)} for s in separate]
    entries += [{"name": s.name, "kind": s.kind, "files": {}} for s in folded]
    return Bins(layout, normaliser, _table_network(run, len(tables)), entries)


def _table_network(run: Run, num_tables: int) -> dict[str, Any]:
    def files(letter: str, layer: int) -> list[str]:
        return [f"{letter}{layer}_{index:03d}" for index in FEW_TABLES]

    return {
        "kind": "pfnn",
        "hidden": run.config.network.hidden,
        "tables": num_tables,
        "statistics": _statistics_files(run.normaliser),
        "layers": [{"weights": files("W", n), "biases": files("b", n)} for n in range(3)],
        # Maps the tables above to control points.
        "mixing": np.linalg.pinv(spline_design(FEW_TABLES)).tolist(),
        "gating": [],
    }


def network_at(network: Network, style: Style | None, c: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns the network at coefficients c [K] as three affine layers: weights [O, I] and biases [O], float64.

    Args:
        network: shared parameters.
        style: added into the layers on which it acts, or None. It must be affine, so not FiLM.
        c: blending coefficients.
    """
    layers = [float64(layer).affine(c) for layer in network.layers]
    terms = {} if style is None else float64(style).affine_terms(c)
    for index, (weights, biases) in terms.items():
        layers[index] = layers[index][0] + weights, layers[index][1] + biases
    return layers


def float64(tree: Tree) -> Tree:
    """Returns the tree with its arrays as NumPy arrays in float64."""
    return jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), tree)


def _write_cp(folder: Path, style: ExportStyle, tables: Sequence[int]) -> dict[str, Any]:
    """Writes the factors A diag(D) B of a CP style, with one file of D for each table, and returns their names."""
    layer = style.parameters
    assert isinstance(layer, CPLayer)
    _write(folder, f"{style.stem}_W0", layer.b.T)
    _write(folder, f"{style.stem}_W2", layer.a)
    _write(folder, f"{style.stem}_b", layer.bias)
    for index, c in zip(tables, spline_design(tables), strict=True):
        _write(folder, f"{style.stem}_W1_{index:03d}", c @ np.asarray(layer.d, np.float64))
    rank, hidden = layer.d.shape[1], layer.a.shape[0]
    named = [[f"{style.stem}_W2", hidden], [f"{style.stem}_W0", rank], [f"{style.stem}_b", 1]]
    return {"cp": named, "cp_diagonal": [f"{style.stem}_W1_{index:03d}" for index in FEW_TABLES]}


def _write_experts(folder: Path, run: Run, styles: tuple[ExportStyle, ...]) -> Bins:
    network, gating = run.shared, run.shared.gating
    assert gating is not None
    experts = network.num_control_points
    _write_statistics(folder, run.normaliser)
    for n, layer in enumerate(network.layers):
        for expert, one_hot in enumerate(np.eye(experts)):
            weights, biases = float64(layer).affine(one_hot)
            _write(folder, f"cp{n}_a{expert}", weights)
            _write(folder, f"cp{n}_b{expert}", biases)
    for n, layer in enumerate(gating.layers):
        _write(folder, f"wc{n}_w", layer.weights.T)
        _write(folder, f"wc{n}_b", layer.biases)
    description = {
        "kind": "lpn",
        "hidden": run.config.network.hidden,
        "experts": experts,
        "gating_hidden": run.config.network.gating_hidden,
        "statistics": _statistics_files(run.normaliser),
        "layers": [
            {
                kind: [f"cp{n}_{letter}{e}" for e in range(experts)]
                for kind, letter in (("weights", "a"), ("biases", "b"))
            }
            for n in range(3)
        ],
        "mixing": np.eye(experts).tolist(),
        "gating": [[f"wc{n}_w", f"wc{n}_b"] for n in range(3)],
    }
    return Bins(
        run.layout, run.normaliser, description, [_write_film(folder, n, style) for n, style in enumerate(styles)]
    )


def _write_film(folder: Path, index: int, style: ExportStyle) -> dict[str, Any]:
    film, files = style.parameters, []
    assert isinstance(film, FiLMStyle)
    for layer in range(2):
        files.append([f"Style_{index:03d}_{kind}{layer + 1}" for kind in ("scale", "shift")])
        for name, values in zip(files[-1], (film.scale[layer], film.shift[layer]), strict=True):
            _write(folder, name, values)
    return {"name": style.name, "kind": style.kind, "files": {"film": files}}


def _write_statistics(folder: Path, normaliser: Normaliser) -> None:
    for side, statistics in _sides(normaliser).items():
        _write(folder, f"{_STATISTICS[side]}mean", statistics.mean)
        _write(folder, f"{_STATISTICS[side]}std", statistics.std)


def _statistics_files(normaliser: Normaliser) -> dict[str, str]:
    return {f"{side}_{kind}": f"{_STATISTICS[side]}{kind}" for side in _sides(normaliser) for kind in ("mean", "std")}


def _sides(normaliser: Normaliser) -> dict[str, Statistics]:
    sides = {"x": normaliser.inputs, "y": normaliser.outputs, "phase": normaliser.phases}
    return {side: statistics for side, statistics in sides.items() if statistics is not None}


def _convert(normaliser: Normaliser, source: FrameLayout, target: FrameLayout) -> tuple[Normaliser, np.ndarray]:
    """Returns statistics in another layout's column order and units, and the order of the outputs.

    Normalised values do not change.
    """

    def side(statistics: Statistics, name: str) -> tuple[Statistics, np.ndarray]:
        columns, factors = convert_columns(source, target, name)
        # Both layouts turn about +Y, so no factor is negative and standard deviations stay positive.
        mean, std = (values[columns].astype(np.float64) * factors for values in (statistics.mean, statistics.std))
        return Statistics(mean.astype(np.float32), std.astype(np.float32)), columns

    inputs, _ = side(normaliser.inputs, "inputs")
    outputs, columns = side(normaliser.outputs, "outputs")
    return Normaliser(inputs, outputs), columns


def _write(folder: Path, name: str, values: Any) -> None:
    (folder / f"{name}.bin").write_bytes(np.ascontiguousarray(np.asarray(values), "<f4").tobytes())
