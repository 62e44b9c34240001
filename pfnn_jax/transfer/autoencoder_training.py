"""Trains a motion autoencoder on windows of motion (Holden 2017, Eq. 3)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.errors import InputError
from pfnn_jax.models.dropout import drop
from pfnn_jax.motion.features.normaliser import CONSTANT, Statistics
from pfnn_jax.training.loop import Progress, no_progress
from pfnn_jax.transfer.autoencoder import MotionAutoencoder, init_autoencoder
from pfnn_jax.transfer.config import AutoencoderTrainingConfig
from pfnn_jax.transfer.layout import ClipLayout
from pfnn_jax.transfer.window_training import draw_order, train_windows


def fit_statistics(rows: np.ndarray, layout: ClipLayout) -> Statistics:
    """Returns the mean of every column, and one standard deviation for each block of the layout.

    All positions share one standard deviation, so that an error of a centimetre costs the same at every point and in
    every direction; so do both root velocities, and all foot contacts.

    Args:
        rows: [..., D] in layout units.
        layout: names the blocks.

    Raises:
        InputError: for no rows, another width than the layout's, or a value that is not finite.
    """
    rows = np.asarray(rows, np.float64).reshape(-1, rows.shape[-1])
    if not len(rows) or rows.shape[1] != layout.size:
        rule = f"must be rows of {layout.size} columns, at least one"
        raise InputError("fit_statistics", "rows", f"shape {rows.shape}", rule)
    if not np.isfinite(rows).all():
        row, column = np.argwhere(~np.isfinite(rows))[0].tolist()
        raise InputError("fit_statistics", f"row {row}, column {column}", rows[row, column], "must be finite")
    mean, std = rows.mean(axis=0), np.ones(layout.size)
    for block in (layout.joint_position, layout.root_velocity, layout.root_yaw_rate, layout.foot_contacts):
        spread = np.sqrt(np.mean((rows[:, block] - mean[block]) ** 2)) if rows[:, block].size else 0.0
        if spread > CONSTANT:
            std[block] = spread
    return Statistics(mean.astype(np.float32), std.astype(np.float32))


def train_autoencoder(
    windows: np.ndarray,
    config: AutoencoderTrainingConfig | None = None,
    *,
    progress_callback: Callable[[Progress], Any] = no_progress,
) -> MotionAutoencoder:
    """Returns a motion autoencoder trained by Adam on the reconstruction of windows.

    Args:
        windows: [N, T, D] normalised, T even; kept on the device.
        config: sizes and schedule.
        progress_callback: called after every chunk of steps.

    Raises:
        ValueError: if there are no windows, or their number of frames is odd.
        TrainingError: when the loss becomes non-finite.
    """
    config = config or AutoencoderTrainingConfig()
    if windows.ndim != 3 or not len(windows) or windows.shape[1] % 2:
        raise ValueError(f"`windows` must be [N, T, D], at least one, T even, got {windows.shape}.")
    params = init_autoencoder(config.autoencoder, windows.shape[-1], key=jax.random.key(config.seed))

    def loss(params: MotionAutoencoder, x: jax.Array, frozen: None, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        return autoencoder_loss(params, x, config, jax.random.fold_in(jax.random.key(config.seed), step))

    autoencoder, _ = train_windows(
        params,
        np.asarray(windows, np.float32),
        None,
        loss,
        optax.adam(_schedule(config)),
        draw_order(len(windows), config.steps, config.batch_size, config.seed),
        precision=config.precision,
        steps_per_dispatch=config.steps_per_dispatch,
        progress_callback=progress_callback,
    )
    return autoencoder


def autoencoder_loss(
    autoencoder: MotionAutoencoder, x: jax.Array, config: AutoencoderTrainingConfig, key: jax.Array | None = None
) -> tuple[jax.Array, jax.Array]:
    """Returns (loss, mean squared error) of normalised windows x [B, T, D]: Eq. 3.

    The square is a mean over numbers, and the penalty the mean absolute weight, as in the authors' code: sums, as the
    paper prints them, would make their balance depend on the length of windows and the number of filters.

    Args:
        autoencoder: its parameters.
        x: normalised windows.
        config: α, and dropout rates, which act where `key` is given.
        key: random key of dropout.
    """
    seen = x
    if key is not None and config.dropout:
        keys, rate = jax.random.split(key), jnp.float32(config.dropout)
        hidden = jax.vmap(autoencoder.encode)(drop(keys[0], rate, seen))
        found = jax.vmap(autoencoder.decode)(drop(keys[1], rate, hidden))
    else:
        found = jax.vmap(autoencoder.project)(seen)
    error = jnp.mean((found - x) ** 2)
    layers = [autoencoder.encoder] + ([autoencoder.decoder] if autoencoder.decoder is not None else [])
    penalty = sum(jnp.mean(jnp.abs(layer.filters)) for layer in layers) / len(layers)
    return error + config.l1 * penalty, error


def _schedule(config: AutoencoderTrainingConfig) -> optax.Schedule:
    """Returns the learning rate by step: it rises over the first twentieth, and then falls to zero along a cosine.

    Without the rise, Adam's first steps at this rate make the loss larger than at the start.
    """
    return optax.warmup_cosine_decay_schedule(0.0, config.learning_rate, config.steps // 20, config.steps)
