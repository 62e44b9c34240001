"""Pretraining in memory: from rows of all styles to a shared network and a style for each name."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.errors import TrainingError
from pfnn_jax.models.film_generator import film_generator
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_bank
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.training.config import PretrainConfig, equal_dropout
from pfnn_jax.training.data import Batch, Rows, StyleData, make_gather
from pfnn_jax.training.films import mean_films
from pfnn_jax.training.order import StepOrder, order_of, stream_batches
from pfnn_jax.training.steps import (
    TrainState,
    init_pretrain_state,
    make_pretrain_step,
    make_run_batches,
    make_run_steps,
)


class Progress(NamedTuple):
    """What one dispatch reports."""

    step: int
    steps: int
    loss: float
    frames_per_second: float


def init_state(config: PretrainConfig, layout: FrameLayout, num_styles: int) -> TrainState:
    """The state at step 0 for S styles of a layout; depends on the arguments alone."""
    shared_key, style_key = jax.random.split(jax.random.key(config.seed))
    sizes, generator = config.network(layout), config.generator(layout)
    shared, optimiser = init_network(sizes, key=shared_key), optax.adam(config.learning_rate)
    if generator is not None:
        return init_pretrain_state(shared, film_generator(generator).init(style_key), optimiser, is_bank=False)
    bank = init_bank(config.adapter, config.hidden, sizes.num_control_points, num_styles, key=style_key)
    return init_pretrain_state(shared, bank, optimiser)


def styles_of(state: TrainState, data: Rows, config: PretrainConfig) -> Any:
    """What training learned of every style, stacked [S, ...]: the bank, or of a generator the mean Films.

    Args:
        state: of training.
        data: that it was trained on; the generator reads all windows of every style.
        config: of training.
    """
    generator = config.generator(data.layout)
    if generator is None:
        return state.modulation
    return mean_films(film_generator(generator), state.modulation, data)


def total_steps(config: PretrainConfig, order: StepOrder) -> int:
    """Steps of the whole training."""
    return config.epochs * order.steps_per_epoch if config.steps is None else config.steps


def train(
    state: TrainState,
    data: Rows,
    config: PretrainConfig,
    styles: tuple[str, ...],
    *,
    progress_callback: Callable[[TrainState, Progress], Any] = lambda state, progress: None,
) -> TrainState:
    """Train from a state, new or loaded, to the end of the configured steps.

    A step depends on the state, the data and its own number alone, so that a resumed run repeats itself bit for bit.

    Args:
        state: donated; read the returned one.
        data: rows of S styles. Kept on the device where they fit `config.device_bytes`, else read batch by batch.
        config: the same that made `state`.
        styles: S names, for messages.
        progress_callback: called after every dispatch with the state and its metrics, e.g. to save.

    Raises:
        TrainingError: when a loss is not finite, before `progress_callback` sees that state.
        ValueError: if a style has fewer rows than a batch, or windows or bones are needed and absent.
    """
    order = order_of(data, config.batch_size, config.seed, config.num_clips)
    generator = config.generator(data.layout)
    step = make_pretrain_step(
        optax.adam(config.learning_rate),
        config.objective(data),
        equal_dropout(config.dropout),
        None if generator is None else film_generator(generator),
    )
    run_key = jax.random.fold_in(jax.random.key(config.seed), 1)
    begin, steps = int(state.step), total_steps(config, order)
    dispatches = dispatch_sizes(begin, steps, config.steps_per_dispatch)
    run = make_dispatch(step, data, order, dispatches, run_key, config.device_bytes)
    for first, count in dispatches:
        started = time.perf_counter()
        state, losses = run(state, first, count)
        losses = np.asarray(losses)
        check_finite(losses, first, styles)
        rate = losses.size * config.batch_size / (time.perf_counter() - started)
        progress_callback(state, Progress(first + count, steps, float(losses.mean()), rate))
    return state


def dispatch_sizes(begin: int, steps: int, size: int) -> list[tuple[int, int]]:
    """(first step, number of steps) of every dispatch from step `begin` on; they end at multiples of `size`."""
    edges = [begin, *range((begin // size + 1) * size, steps, size), steps]
    return [(a, b - a) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]


def make_dispatch(
    step: Callable, data: Rows, order: StepOrder, dispatches: list[tuple[int, int]], run_key: Any, limit: int
):
    """(state, first step, number of steps) -> (state, losses [n]), with the data on the device where it fits `limit`.

    The function must be called for `dispatches` one after another.
    """
    rolled = not order.num_clips  # clips go through convolutions
    if isinstance(data, StyleData) and data.nbytes <= limit:
        on_device = Batch(*(jnp.asarray(rows) for rows in (data.x, data.y, data.phase)))
        run_steps = make_run_steps(step, make_gather(data.layout), rolled=rolled)
        return lambda state, first, count: run_steps(state, on_device, order.draw(first, count), run_key)
    run_batches, batches = make_run_batches(step, rolled=rolled), stream_batches(data, order, dispatches)
    return lambda state, first, count: run_batches(state, next(batches), run_key)


def check_finite(losses: np.ndarray, first_step: int, styles: tuple[str, ...]) -> None:
    """Refuses losses [n] that are not finite.

    Raises:
        TrainingError: naming the step and its style.
    """
    bad = np.flatnonzero(~np.isfinite(losses))
    if bad.size:
        step = first_step + int(bad[0])
        raise TrainingError(step, styles[step % len(styles)], float(losses[bad[0]]))
