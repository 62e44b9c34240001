"""Imports networks with CP styles, in the file format of the 2018 authors' demo, as a run.

The network is stored as tables over the phase like the PFNN's (`holden2017`). The factors A diag(D) B of a style NAME
are stored in `NAME_W2.bin` (A), `NAME_W1_iii.bin` (D at phase 2πi/50) and `NAME_W0.bin` (B), its bias in `NAME_b.bin`.
The files do not name the joints, so a `description.json` as written by `pfnn-jax export` must accompany them.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.inference.style_choice import file_stem
from pfnn_jax.interop.released.files import DESCRIPTION, read_array, read_description, read_statistics
from pfnn_jax.interop.released.holden2017 import read_tables, recover_control_points
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network, config_of
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, Statistics
from pfnn_jax.motion.skeleton import skeleton_to_json
from pfnn_jax.motion.units import authors2018, convert_columns
from pfnn_jax.run import Run, create_run, load_run, save_shared, save_style
from pfnn_jax.run_config import RunConfig


def import_released_cp(directory: str | Path, out: str | Path, overwrite: bool = False) -> Run:
    """Imports a directory of tables and CP styles as a run of layout `mason2018`.

    Args:
        directory: contains `Xmean.bin`, `Xstd.bin`, `Ymean.bin`, `Ystd.bin`, the tables, the styles' files and
            `description.json`, in the units of the authors' runtime (`units.authors2018`).
        out: the run directory to write.
        overwrite: whether to replace an existing run.

    Raises:
        InputError: if a file is missing, has the wrong size or is not finite; if the tables come from another spline;
            if `out` exists.
    """
    directory = Path(directory)
    description = read_description(directory, "mason2018")
    if description is None:
        rule = "must accompany the .bin files, which do not name the joints"
        raise InputError(directory / DESCRIPTION, "file", "absent", rule)
    theirs, ours = (make(description["skeleton"].num_joints) for make in (authors2018, mason2018))
    sides = (("X", "inputs", theirs.input_size), ("Y", "outputs", theirs.output_size))
    statistics = []
    for side, name, size in sides:
        columns, factors = convert_columns(theirs, ours, name)
        found = read_statistics(directory, side, size)
        values = [(part[columns].astype(np.float64) * factors).astype(np.float32) for part in (found.mean, found.std)]
        statistics.append(Statistics(*values))
    shared, facts = read_tables(directory, theirs.input_size, theirs.output_size)
    shared = _reorder(shared, convert_columns(theirs, ours, "outputs")[0])
    styles = {file_stem(s["name"]): s for s in description["styles"] if s["files"]}
    hidden = config_of(shared).hidden
    layers = {
        name: _read_style(directory, Path(s["files"]["cp"][1][0]).name, hidden, facts["tables"])
        for name, s in styles.items()
    }
    rank = next((layer.d.shape[1] for layer in layers.values()), AdapterConfig().rank)
    config = RunConfig(
        network=config_of(shared),
        adapter=AdapterConfig("cp", rank),
        layout=ours.name,
        num_joints=ours.num_joints,
        styles=tuple(styles),
        skeleton=skeleton_to_json(description["skeleton"]),
        pretrain={"source": f"tables with CP styles in {directory.resolve().name}", **facts},
    )
    create_run(out, config, Normaliser(*statistics), overwrite)
    save_shared(out, shared)
    for name, layer in layers.items():
        save_style(
            out, name, layer, {"source": f"CP factors in {directory.resolve().name}", "speed": styles[name]["speed"]}
        )
    return load_run(out, ours.name)


def _reorder(network: Network, columns: np.ndarray) -> Network:
    """Returns the network with its outputs permuted."""
    first, second, last = network.layers
    assert isinstance(last, BlendedLayer)
    last = BlendedLayer(weights=last.weights[:, :, columns], biases=last.biases[:, columns])
    return replace(network, layers=(first, second, last))


def _read_style(directory: Path, down: str, hidden: int, indices: list[int]) -> CPLayer:
    """Reads the factors of the style whose first file is `down`, i.e. NAME_W0, without suffix, at these tables."""
    stem = down.removesuffix("_W0")
    rank = len(read_array(directory / f"{stem}_W1_{indices[0]:03d}.bin", None))
    tables = np.stack([read_array(directory / f"{stem}_W1_{index:03d}.bin", (rank,)) for index in indices])
    return CPLayer(
        a=jnp.asarray(read_array(directory / f"{stem}_W2.bin", (hidden, rank))),
        b=jnp.asarray(read_array(directory / f"{stem}_W0.bin", (rank, hidden)).T),
        d=jnp.asarray(recover_control_points(tables, indices)[0], jnp.float32),
        bias=jnp.asarray(read_array(directory / f"{stem}_b.bin", (hidden,))),
    )
