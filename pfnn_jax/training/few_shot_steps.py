"""The compiled part of few-shot learning: epochs of steps for a whole grid of settings, or for a bank of styles.

Compilation takes as long as learning from a short clip. What is compiled therefore knows neither the number of frames
nor of epochs: rows are padded to a multiple of `ROWS`, and few epochs are trained at a time (`EPOCHS`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.models.adapters import Style
from pfnn_jax.models.network import Dropout, Network
from pfnn_jax.training.batches import Batch
from pfnn_jax.training.steps import Objective, predict_batch

ROWS = 512
"""Frames to a multiple of which rows are padded: 4 seconds and their mirror image."""

EPOCHS = 5
"""Epochs between two calls of `on_epochs`."""

_LARGEST = np.iinfo(np.uint32).max


@struct.dataclass
class Setting:
    """One point of the grid, or the whole grid on a leading axis G."""

    learning_rate: jax.Array  # []
    main_dropout: jax.Array  # []
    adapter_dropout: jax.Array  # []


@struct.dataclass
class FewShotState:
    """What few-shot training changes, for one setting or, on a leading axis, for a grid or a bank."""

    trained: Any
    optimiser: Any


def init_few_shot_state(trained: Any) -> FewShotState:
    """A state at epoch 0 from the parameters to be trained."""
    return FewShotState(trained, optax.scale_by_adam().init(trained))


def assemble(trained: Any, shared: Network) -> tuple[Network, Style | None]:
    """The network and adapter to run: (shared, adapter), or (network, None) where a whole network was trained."""
    return (trained, None) if isinstance(trained, Network) else (shared, trained)


def few_shot_step(
    state: FewShotState, setting: Setting, shared: Network, batch: Batch, key: jax.Array, objective: Objective
) -> FewShotState:
    """One Adam step of one setting on one minibatch; only `state.trained` is differentiated."""
    dropout = Dropout(main=setting.main_dropout, adapter=setting.adapter_dropout)

    def loss(trained):
        network, style = assemble(trained, shared)
        return objective.loss(predict_batch(network, style, batch, dropout, key), batch.y, (trained,))[0]

    update, optimiser = optax.scale_by_adam().update(jax.grad(loss)(state.trained), state.optimiser)
    trained = jax.tree.map(lambda value, change: value - setting.learning_rate * change, state.trained, update)
    return FewShotState(trained, optimiser)


class EpochTrainer:
    """Trains a leading axis of states: settings over one style's frames, or styles under one setting.

    Args:
        shared: pretrained parameters, not changed.
        data: [N, ...] frames, or with `per_style` [S, N, ...].
        batch_size: frames of a minibatch; a last incomplete one is dropped.
        objective: the loss.
        key: of shuffling and dropout; the key of an epoch is folded from it and the epoch's number.
        per_style: whether states are of styles, each with its own frames.
    """

    def __init__(
        self,
        shared: Network,
        data: Batch,
        batch_size: int,
        objective: Objective,
        key: jax.Array,
        *,
        per_style: bool = False,
    ) -> None:
        axis = 1 if per_style else 0
        self._count = jax.tree.leaves(data)[0].shape[axis]
        self._inputs = _put((shared, pad_rows(data, axis, math.lcm(ROWS, batch_size))))
        self._key = key
        self._options = {
            "batch_size": batch_size,
            "objective": objective,
            "per_style": per_style,
            "sorts": sorts_of(self._count),
        }

    def train(
        self,
        states: FewShotState,
        settings: Setting,
        epochs: tuple[int, int],
        on_epochs: Callable[[int], Any] = lambda number: None,
    ) -> FewShotState:
        """The states after the epochs [first, last); `on_epochs` is told how many are done, `EPOCHS` at a time."""
        shared, data = self._inputs
        states, settings = _put((states, settings))
        for first in range(*epochs, EPOCHS):
            last = min(first + EPOCHS, epochs[1])
            counts = np.asarray([first, last, self._count], np.int32)
            states = _train_many(states, settings, shared, data, counts, self._key, **self._options)
            jax.block_until_ready(states)
            on_epochs(last)
        return states


def row_errors(trained: Any, shared: Network, data: Batch) -> np.ndarray:
    """Squared normalised error [G, N], mean over outputs, of every setting on each of N frames, without dropout."""
    count = len(data.x)
    trained, shared, data = _put((trained, shared, pad_rows(data, 0, ROWS)))
    return np.asarray(_row_errors(trained, shared, data))[:, :count]


def pad_rows(data: Batch, axis: int, multiple: int) -> Batch:
    """Frames repeated along `axis` until their number is a multiple; those added are never trained on."""
    count = jax.tree.leaves(data)[0].shape[axis]
    rows = np.arange(-(-count // multiple) * multiple) % count
    return jax.tree.map(lambda leaf: np.take(np.asarray(leaf), rows, axis=axis), data)


def sorts_of(count: int) -> int:
    """How often a shuffle of `count` frames sorts by random bits, so that equal bits leave no trace."""
    return max(1, math.ceil(3 * math.log(max(count, 1)) / math.log(_LARGEST)))


def padded_permutation(key: jax.Array, size: int, count: jax.Array, sorts: int) -> jax.Array:
    """Numbers [size] of which the first `count` are those below `count`, in the order of `jax.random.permutation`.

    Args:
        key: of the order.
        size: fixed, at least `count`.
        count: [] how many are to be shuffled.
        sorts: as `sorts_of` tells for `count`.
    """
    numbers = jnp.arange(size, dtype=jnp.int32)
    order = numbers
    for _ in range(sorts):
        key, subkey = jax.random.split(key)
        bits = jax.random.bits(subkey, (size,), jnp.uint32)
        bits = jnp.where(numbers < count, bits, jnp.uint32(_LARGEST))  # stable: the padding stays last
        order = jax.lax.sort_key_val(bits, order)[1]
    return order


def _train_epochs(
    state: FewShotState, setting: Setting, shared: Network, data: Batch, counts, key, batch_size: int, objective, sorts
) -> FewShotState:
    """One setting trained on one style; counts [3]: first epoch, the one before which to end, frames."""
    size, (first, last, num_frames) = data.phase.shape[0], counts

    def one_epoch(epoch, state):
        order_key, step_key = jax.random.split(jax.random.fold_in(key, epoch))
        order = padded_permutation(order_key, size, num_frames, sorts)
        keys = jax.random.split(step_key, size // batch_size)

        def one_step(index, state):
            frames = jax.lax.dynamic_slice(order, (index * batch_size,), (batch_size,))
            batch = jax.tree.map(lambda leaf: leaf[frames], data)
            return few_shot_step(state, setting, shared, batch, keys[index], objective)

        return jax.lax.fori_loop(0, num_frames // batch_size, one_step, state)

    return jax.lax.fori_loop(first, last, one_epoch, state)


@partial(jax.jit, static_argnames=("batch_size", "objective", "per_style", "sorts"), donate_argnums=0)
def _train_many(states, settings, shared, data, counts, key, *, batch_size, objective, per_style, sorts):
    """A leading axis of states trained at once."""

    def one(state, setting, data):
        return _train_epochs(state, setting, shared, data, counts, key, batch_size, objective, sorts)

    return jax.vmap(one, in_axes=(0, None, 0) if per_style else (0, 0, None))(states, settings, data)


@jax.jit
def _row_errors(trained, shared: Network, data: Batch) -> jax.Array:
    def one(trained):
        y = predict_batch(*assemble(trained, shared), data, None, None)
        return jnp.mean((y - data.y) ** 2, axis=1)

    return jax.vmap(one)(trained)


def _put(tree: Any) -> Any:
    """The tree on the default device and bound to it: what is bound is compiled anew where it was not before."""
    return jax.device_put(tree, jax.devices()[0])
