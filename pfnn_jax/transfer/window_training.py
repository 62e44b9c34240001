"""Trains a network of style transfer by Adam on minibatches of windows that are kept on the device."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.training.config import Precision
from pfnn_jax.training.loop import Progress, TrainState, check_finite, chunks, scan_steps, train_steps
from pfnn_jax.training.precision import at_precision

Loss = Callable[[Any, Any, Any, jax.Array], tuple[jax.Array, jax.Array]]
"""(params, minibatch of windows, frozen, [] number of the step) -> (loss, value to report)."""


def draw_order(num_windows: int, steps: int, batch_size: int, seed: int) -> np.ndarray:
    """Returns the windows [steps, B] of every minibatch: each epoch takes all windows once, shuffled again."""
    needed = steps * batch_size
    rng = np.random.default_rng(seed)
    epochs = [rng.permutation(num_windows) for _ in range(-(-needed // num_windows))]
    return np.concatenate(epochs)[:needed].reshape(steps, batch_size).astype(np.int32)


def train_windows(
    params: Any,
    windows: Any,
    frozen: Any,
    loss: Loss,
    tx: optax.GradientTransformation,
    order: np.ndarray,
    *,
    precision: Precision,
    steps_per_dispatch: int,
    progress_callback: Callable[[Progress], Any],
) -> tuple[Any, np.ndarray]:
    """Returns trained parameters, and the value [steps] that `loss` reports before every step.

    Args:
        params: initial parameters; donated.
        windows: a tree of arrays [N, ...], the first of them [N, T, D].
        frozen: a tree of what the loss reads and training does not change.
        loss: of a minibatch.
        tx: the optimiser.
        order: [steps, B] windows of every minibatch, as `draw_order` returns them.
        precision: of matrix products and, but for bfloat16, of convolutions.
        steps_per_dispatch: steps that are compiled into one call, and between two reports.
        progress_callback: called after every chunk of steps.

    Raises:
        TrainingError: when a reported value becomes non-finite.
    """
    data, reported, started = jax.device_put(windows), [np.empty(0, np.float32)], time.perf_counter()
    (steps, batch_size), frames = order.shape, jax.tree.leaves(windows)[0].shape[1]

    def report(state: TrainState, step: int, losses: Any) -> None:
        nonlocal started
        losses = np.asarray(losses)
        check_finite(losses, step - losses.size, ("all",))
        reported.append(losses)
        rate = losses.size * batch_size * frames / (time.perf_counter() - started)
        progress_callback(Progress(step, steps, float(losses.mean()), rate))
        started = time.perf_counter()

    step = at_precision(_make_step(loss, tx), precision)
    scan = scan_steps(step, lambda data, rows: jax.tree.map(lambda leaf: leaf[rows], data))
    state = TrainState(params=params, opt_state=tx.init(params), step=jnp.zeros((), jnp.int32))
    state = train_steps(
        state,
        lambda state, first, count: scan(state, order[first : first + count], data, frozen),
        chunks(0, steps, steps_per_dispatch),
        report,
    )
    return state.params, np.concatenate(reported)


def _make_step(loss: Loss, tx: optax.GradientTransformation) -> Callable:
    def step(state: TrainState, batch: Any, frozen: Any) -> tuple[TrainState, jax.Array]:
        gradient_of = jax.value_and_grad(loss, has_aux=True)
        (_, value), gradient = gradient_of(state.params, batch, frozen, state.step)
        updates, opt_state = tx.update(gradient, state.opt_state)
        params = optax.apply_updates(state.params, updates)
        return TrainState(params=params, opt_state=opt_state, step=state.step + 1), value

    return step
