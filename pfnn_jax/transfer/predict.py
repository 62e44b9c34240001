"""Encodes and reconstructs the rows of a clip by a run's autoencoder, from arrays or from a file, in layout units."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing, replacing
from pfnn_jax.io.npz import as_floats, read_arrays
from pfnn_jax.models.convolution import POOLING
from pfnn_jax.transfer.run import TransferRun, load_transfer_run


class Reconstruction(NamedTuple):
    """What an autoencoder makes of a clip."""

    hidden: np.ndarray  # [T / 2, F]
    y: np.ndarray  # [T, D] in layout units


def reconstruct(run: TransferRun, x: np.ndarray) -> Reconstruction:
    """Returns hidden units and reconstruction of rows x [T, D] in layout units, T even, as float32.

    Computed in float64: a hidden unit is a sum of 1825 products, which float32 rounds at the sixth digit.
    """
    mean, std = (np.asarray(values, np.float64) for values in (run.statistics.mean, run.statistics.std))
    with jax.enable_x64(True):
        autoencoder = jax.tree.map(lambda leaf: jnp.asarray(leaf, jnp.float64), run.autoencoder)
        hidden = autoencoder.encode(jnp.asarray((x - mean) / std, jnp.float64))
        y = np.asarray(autoencoder.decode(hidden)) * std + mean
    return Reconstruction(np.asarray(hidden, np.float32), y.astype(np.float32))


def reconstruct_file(
    run_path: str | Path, in_npz: str | Path, out_npz: str | Path, *, overwrite: bool = False
) -> Reconstruction:
    """Reconstructs the clip of a file and writes the result to another file.

    Args:
        run_path: the directory of a run of style transfer.
        in_npz: array `x` [T, D] in layout units, T even.
        out_npz: receives `hidden` [T / 2, F] and `y` [T, D] in layout units.
        overwrite: whether to replace an existing output file.

    Raises:
        InputError: for a bad run or input file (naming array, row and column), or if the output exists and `overwrite`
            is not set.
    """
    run, out = load_transfer_run(run_path), Path(out_npz)
    refuse_existing(out, overwrite)
    found = reconstruct(run, _read_clip(Path(in_npz), run.layout.size))
    with replacing(out) as new, new.open("wb") as file:
        np.savez(file, hidden=found.hidden, y=found.y)
    return found


def _read_clip(file: Path, size: int) -> np.ndarray:
    rule = "must be a NumPy .npz file with the array x"
    arrays = read_arrays(file, ("x",), rule)
    if "x" not in arrays:
        raise InputError(file, "array x", "absent", rule)
    x = arrays["x"]
    if x.ndim != 2 or x.shape[1] != size or not len(x) or len(x) % POOLING:
        rule = f"must be an even number of rows of {size} columns, at least {POOLING}"
        raise InputError(file, "array x", f"shape {x.shape}", rule)
    return as_floats(file, "x", x)
