"""Imports the motion autoencoder that Holden et al. (2016) released as a run of style transfer.

The release is two NumPy archives: `network_core.npz` with the filters and biases of an encoder and of its own, untied
decoder, and `preprocess_core.npz` with the mean and standard deviation of every column. Theano's convolution flips its
filters; they are turned here, once, so that this package's convolution reads them.
"""

from __future__ import annotations

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.interop.released.holden2017 import JOINTS, cmu_skeleton
from pfnn_jax.io.npz import read_arrays
from pfnn_jax.models.convolution import Convolution
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.transfer.autoencoder import MotionAutoencoder
from pfnn_jax.transfer.layout import HOLDEN2016
from pfnn_jax.transfer.run import TransferRun, create_transfer_run

NETWORK, STATISTICS = "network_core.npz", "preprocess_core.npz"

RULE = "must be a NumPy archive of the released autoencoder"


def import_released_autoencoder(directory: str | Path, out: str | Path, overwrite: bool = False) -> TransferRun:
    """Imports the released autoencoder as a run of layout `holden2016`.

    Args:
        directory: contains `network_core.npz` and `preprocess_core.npz`.
        out: the run directory to write.
        overwrite: whether to replace an existing run of style transfer.

    Raises:
        InputError: if a file or an array is missing, or an array has another shape or a value that is not finite; if a
            standard deviation is not positive; if `out` exists.
    """
    directory, size = Path(directory), HOLDEN2016.size
    file = directory / STATISTICS
    found = _read(file, {"Xmean": (1, size, 1), "Xstd": (1, size, 1)})
    statistics = Statistics(*(found[name].reshape(-1) for name in ("Xmean", "Xstd")))
    if not (statistics.std > 0).all():
        column = int(np.argmin(statistics.std))
        raise InputError(file, f"array Xstd, column {column}", statistics.std[column], "must be positive")
    autoencoder = _read_autoencoder(directory / NETWORK, size)
    source = {"source": f"autoencoder of Holden et al. 2016 in {directory.resolve().name}"}
    return create_transfer_run(
        out, HOLDEN2016, released_skeleton(), statistics, autoencoder, source, overwrite=overwrite
    )


def released_skeleton() -> Skeleton:
    """Returns the skeleton of the released character in a T-pose: its CMU joints and bone lengths.

    The release holds no rest pose, and none is needed: clips are put onto the skeleton from their own reference pose.
    """
    offsets = np.array([length * np.array(_direction(name)) for name, _, length in JOINTS]) / 100.0
    return cmu_skeleton(offsets, "released autoencoder")


def _direction(name: str) -> tuple[float, float, float]:
    """Returns the direction of the bone that ends in a joint in a T-pose: Y up, facing +Z, left towards +X."""
    side = -1.0 if name.startswith("R") else 1.0
    if "Leg" in name and "Up" in name:
        return side * 0.6, -0.8, 0.0  # from the hips' centre to a hip joint
    if "Leg" in name or "Foot" in name:
        return 0.0, -1.0, 0.0
    if "Toe" in name:
        return 0.0, -0.3, 0.954
    if any(part in name for part in ("Arm", "Hand")):
        return side, 0.0, 0.0
    return 0.0, 1.0, 0.0


def _read_autoencoder(file: Path, size: int) -> MotionAutoencoder:
    """Returns the released autoencoder for rows of `size` numbers."""
    filters, width = 256, 25
    found = _read(
        file,
        {
            "L000_L001_W": (filters, size, width),
            "L000_L002_b": (filters, 1),
            "L001_L002_W": (size, filters, width),
            "L001_L003_b": (size, 1),
        },
    )

    def layer(weights: str, bias: str) -> Convolution:
        turned = np.flip(found[weights].transpose(2, 1, 0), axis=0)  # [O, I, W] of Theano to [W, I, O]
        return Convolution(
            filters=jnp.asarray(turned, jnp.float32), bias=jnp.asarray(found[bias].reshape(-1), jnp.float32)
        )

    return MotionAutoencoder(encoder=layer("L000_L001_W", "L000_L002_b"), decoder=layer("L001_L002_W", "L001_L003_b"))


def _read(file: Path, shapes: dict[str, tuple[int, ...]]) -> dict[str, np.ndarray]:
    """Reads arrays of an archive, and checks their shapes and that they are finite. Nothing is unpickled."""
    arrays = read_arrays(file, tuple(shapes), RULE)
    for name, shape in shapes.items():
        if name not in arrays:
            raise InputError(file, f"array {name}", "absent", RULE)
        if arrays[name].shape != shape or arrays[name].dtype.kind != "f":
            found = f"{arrays[name].dtype} {arrays[name].shape}"
            raise InputError(file, f"array {name}", found, f"must be real numbers of shape {shape}")
        if not np.isfinite(arrays[name]).all():
            raise InputError(file, f"array {name}", "not finite", "every value must be finite")
    return arrays
