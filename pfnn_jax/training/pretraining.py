"""Pretraining: one shared network and one adapter per style, from a prepared dataset (Mason 2018 §6)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.errors import TrainingError
from pfnn_jax.models.adapters import AdapterConfig, init_adapter
from pfnn_jax.models.network import Dropout, NetworkConfig, init_network
from pfnn_jax.training.batches import Batch, epoch_order, gather, steps_per_epoch
from pfnn_jax.training.losses import PenaltyNorm
from pfnn_jax.training.steps import (
    PretrainState,
    init_pretrain_state,
    make_pretrain_step,
    make_run_batches,
    make_run_steps,
)


@dataclass(frozen=True)
class PretrainConfig:
    """How the shared network is trained.

    Attributes:
        adapter: form of every style's adapter.
        hidden: H, width of both hidden layers.
        num_control_points: K, points of the phase spline.
        rank: None, or the rank to which every layer is CP-decomposed (§7.1's aside).
        epochs: passes over the frames of every style (25 in the paper).
        steps: number of steps; overrides `epochs` where set.
        batch_size: frames of one minibatch, all of one style.
        learning_rate: Adam's (1e-4 in the authors' code).
        dropout: drop probability before every layer and adapter.
        l1: λ of Eq. 3.
        l1_norm: mean of |W| over each array, as the authors' code, or sum, as the paper writes it.
        seed: of initialisation, shuffling and dropout.
        steps_per_dispatch: steps compiled into one call, and the grain of metrics.
        save_every: steps between saves of the training state.
        device_bytes: data larger than this stays in host memory and is sent batch by batch.
    """

    adapter: AdapterConfig = field(default_factory=AdapterConfig)
    hidden: int = 512
    num_control_points: int = 4
    rank: int | None = None
    epochs: int = 25
    steps: int | None = None
    batch_size: int = 32
    learning_rate: float = 1e-4
    dropout: float = 0.3
    l1: float = 0.01
    l1_norm: PenaltyNorm = "mean"
    seed: int = 0
    steps_per_dispatch: int = 100
    save_every: int = 1000
    device_bytes: int = 2**32

    def __post_init__(self):
        for name in ("epochs", "batch_size", "steps_per_dispatch", "save_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"PretrainConfig.{name} must be at least 1, got {getattr(self, name)}.")
        if self.steps is not None and self.steps < 1:
            raise ValueError(f"PretrainConfig.steps must be at least 1, got {self.steps}.")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"PretrainConfig.dropout must be in [0, 1), got {self.dropout}.")
        if self.learning_rate <= 0:
            raise ValueError(f"PretrainConfig.learning_rate must be positive, got {self.learning_rate}.")

    def network(self, input_size: int, output_size: int) -> NetworkConfig:
        """The sizes of the network for a layout's frames."""
        return NetworkConfig(input_size, output_size, self.hidden, self.num_control_points, self.rank)


class Progress(NamedTuple):
    """What one dispatch reports."""

    step: int
    steps: int
    loss: float
    frames_per_second: float


def init_state(config: PretrainConfig, input_size: int, output_size: int, num_styles: int) -> PretrainState:
    """The state at step 0 for data of these sizes; depends on the configuration alone."""
    shared_key, bank_key = jax.random.split(jax.random.key(config.seed))
    shared = init_network(config.network(input_size, output_size), shared_key)
    make = partial(init_adapter, config.adapter, config.hidden, config.num_control_points)
    bank = jax.vmap(make)(jax.random.split(bank_key, num_styles))
    return init_pretrain_state(shared, bank, optax.adam(config.learning_rate))


def total_steps(config: PretrainConfig, num_styles: int, num_frames: int) -> int:
    """Steps of the whole training on N frames of each of S styles."""
    if config.steps is not None:
        return config.steps
    return config.epochs * steps_per_epoch(num_styles, num_frames, config.batch_size)


def train(
    state: PretrainState,
    data: Batch,
    config: PretrainConfig,
    styles: tuple[str, ...],
    *,
    on_dispatch: Callable[[PretrainState, Progress], Any] = lambda state, progress: None,
) -> PretrainState:
    """Train from a state, new or loaded, to the end of the configured steps.

    A step depends on the state, the data and its own number alone, so that a resumed run repeats itself bit for bit.

    Args:
        state: donated; read the returned one.
        data: [S, N, ...] normalised frames, NumPy or JAX.
        config: the same that made `state`.
        styles: S names, for messages.
        on_dispatch: called after every dispatch with the state and its metrics, e.g. to save.

    Raises:
        TrainingError: when a loss is not finite, before `on_dispatch` sees that state.
    """
    num_styles, num_frames = data.phase.shape
    steps = total_steps(config, num_styles, num_frames)
    run_key = jax.random.fold_in(jax.random.key(config.seed), 1)
    dispatch = _make_dispatch(data, config, run_key)
    frames_of = _make_order(config, num_styles, num_frames, run_key)
    step = int(state.step)
    while step < steps:
        count = min(config.steps_per_dispatch - step % config.steps_per_dispatch, steps - step)
        frames = frames_of(step, count)
        started = time.perf_counter()
        state, losses = dispatch(state, frames)
        losses = np.asarray(losses)
        _check_finite(losses, step, styles)
        step += count
        rate = losses.size * config.batch_size / (time.perf_counter() - started)
        on_dispatch(state, Progress(step, steps, float(losses.mean()), rate))
    return state


def _make_order(config: PretrainConfig, num_styles: int, num_frames: int, run_key: jax.Array):
    """(step, count) -> frames [count, B] of those steps, across the ends of epochs."""
    per_epoch = steps_per_epoch(num_styles, num_frames, config.batch_size)
    sizes = {"num_styles": num_styles, "num_frames": num_frames, "batch_size": config.batch_size}
    order_of = lru_cache(maxsize=2)(lambda epoch: np.asarray(epoch_order(run_key, epoch, **sizes)))

    def frames_of(step: int, count: int) -> np.ndarray:
        epochs = range(step // per_epoch, (step + count - 1) // per_epoch + 1)
        orders = np.concatenate([order_of(epoch) for epoch in epochs])
        begin = step - epochs[0] * per_epoch
        return orders[begin : begin + count]

    return frames_of


def _make_dispatch(data: Batch, config: PretrainConfig, run_key: jax.Array):
    """(state, frames [n, B]) -> (state, losses [n]), with the data on the device where it fits."""
    rate = jnp.float32(config.dropout)
    dropout = Dropout(main=rate, adapter=rate)
    step = make_pretrain_step(optax.adam(config.learning_rate), dropout, config.l1, config.l1_norm)
    if sum(leaf.nbytes for leaf in jax.tree.leaves(data)) <= config.device_bytes:
        on_device, run_steps = jax.tree.map(jnp.asarray, data), make_run_steps(step)
        return lambda state, frames: run_steps(state, on_device, frames, run_key)
    run_batches, num_styles = make_run_batches(step), data.phase.shape[0]

    def from_host(state: PretrainState, frames: np.ndarray):
        style = (int(state.step) + np.arange(len(frames))) % num_styles
        return run_batches(state, gather(data, style[:, None], frames), run_key)

    return from_host


def _check_finite(losses: np.ndarray, first_step: int, styles: tuple[str, ...]) -> None:
    bad = np.flatnonzero(~np.isfinite(losses))
    if bad.size:
        step = first_step + int(bad[0])
        raise TrainingError(step, styles[step % len(styles)], float(losses[bad[0]]))
