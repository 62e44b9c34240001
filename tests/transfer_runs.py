"""A run of style transfer that is made in a moment: a small untrained autoencoder, with one style."""

from __future__ import annotations

from pathlib import Path

import jax
import numpy as np

from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.config import AutoencoderConfig
from pfnn_jax.transfer.layout import HOLDEN2017
from pfnn_jax.transfer.run import TransferRun, create_transfer_run
from pfnn_jax.workflows.transfer import rows_for_run

SMALL = AutoencoderConfig(filters=8)


def make_walk(path: Path, style: str = "neutral", seconds: float = 2.0, speed: float = 1.2) -> Path:
    """Writes a procedural walk with a slight turn at 60 frames per second."""
    frames = round(60 * seconds)
    write_bvh(path, synthesise(style, np.full(frames, 0.3), np.full(frames, speed))[0])
    return path


def make_transfer_run(folder: Path) -> TransferRun:
    """Makes a run whose rows are normalised by those of a procedural walk, without styles."""
    walk = read_bvh(make_walk(folder / "statistics.bvh", seconds=5.0))
    autoencoder = init_autoencoder(SMALL, HOLDEN2017.size, key=jax.random.key(0))
    whole = Statistics(np.zeros(HOLDEN2017.size, np.float32), np.ones(HOLDEN2017.size, np.float32))
    run = create_transfer_run(folder / "bare", HOLDEN2017, synthetic_skeleton(), whole, autoencoder, {})
    rows = rows_for_run(walk, run)
    statistics = Statistics(rows.mean(axis=0).astype(np.float32), (rows.std(axis=0) + 0.05).astype(np.float32))
    return create_transfer_run(folder / "run", HOLDEN2017, synthetic_skeleton(), statistics, autoencoder, {})
