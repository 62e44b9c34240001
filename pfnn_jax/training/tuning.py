"""A new style through the FiLM generator: it alone is tuned, the shared network stays frozen (Mason 2022 §4.5)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.network import Network
from pfnn_jax.training.config import TuningConfig
from pfnn_jax.training.data import Batch, Rows
from pfnn_jax.training.film_styles import window_styles
from pfnn_jax.training.hosts import check_same
from pfnn_jax.training.loop import Progress, RowTraining, TrainState, no_progress
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.order import identity, order_of
from pfnn_jax.training.precision import at_precision
from pfnn_jax.training.sharding import data_mesh
from pfnn_jax.training.steps import Frozen, PretrainParams, Step, descend, equal_dropout, pretrain_loss


class Tuned(NamedTuple):
    """The result of tuning: the generator, and the mean FiLM style over the style's windows."""

    generator: FiLMGenerator
    style: FiLMStyle
    losses: np.ndarray  # [steps] squared errors


def tune_generator(
    shared: Network,
    generator: FiLMGenerator,
    rows: Rows,
    config: TuningConfig | None = None,
    *,
    key: jax.Array | None = None,
    devices: Sequence[Any] | None = None,
    progress_callback: Callable[[Progress], Any] = no_progress,
) -> Tuned:
    """Tunes a pretrained FiLM generator to the rows of one style, drawing clips independently of the frames.

    Args:
        shared: pretrained network and gating, neither differentiated nor changed.
        generator: pretrained; copied, not changed.
        rows: rows and windows of one style (S = 1).
        config: how to tune; `TuningConfig()` by default. The order of minibatches follows `config.seed`.
        key: of dropout; by default from `config.seed`.
        devices: that share each minibatch; by default as many of all as divide `config.batch_size`. Where
            `jax.distributed` has connected several processes, all of them must call this with equal arguments.
        progress_callback: called after every `config.steps_per_dispatch` steps.

    Raises:
        ValueError: if there are fewer rows than a minibatch, or no windows, or the number of `devices` does not divide
            a minibatch.
        InputError: if the rows or the config are not those of the first of several processes.
        LostProcessError: if another process has ended.
        TrainingError: when a loss is not finite.
    """
    config = TuningConfig() if config is None else config
    key = jax.random.key(config.seed) if key is None else key
    tx = optax.adam(config.learning_rate)
    order = order_of(rows, config.batch_size, config.seed, config.clips_per_batch)
    objective = Objective.for_layout(rows.layout, config.l1, bone_length=config.bone_length)
    bones = rows.bones() if objective.bone_length else None
    copied = jax.tree.map(lambda leaf: jnp.array(leaf, copy=True), generator)  # training donates its state
    check_same("settings and rows", config, np.asarray(jax.random.key_data(key)), *identity(rows))
    steps = config.epochs * order.steps_per_epoch if config.steps is None else config.steps
    step = at_precision(_make_step(tx, objective, config), config.precision)
    mesh = data_mesh(config.batch_size, devices)
    training = RowTraining(step, rows, order, steps, config.steps_per_dispatch, mesh=mesh)
    state = TrainState(copied, tx.init(copied), jnp.zeros((), jnp.int32))
    frozen = Frozen(jax.random.fold_in(key, 1), bones, shared)
    state, losses = training.run(state, frozen, lambda _, progress: progress_callback(progress))
    styles = window_styles(state.params, rows, 0)
    return Tuned(state.params, jax.tree.map(lambda leaf: leaf.mean(axis=0), styles), losses)


def _make_step(tx: optax.GradientTransformation, objective: Objective, config: TuningConfig) -> Step:
    """Returns a step in which the generator is differentiated and `frozen.shared` is not."""
    dropout = equal_dropout(config.dropout)

    def loss(generator: FiLMGenerator, batch: Batch, frozen: Frozen, key: jax.Array):
        both = PretrainParams(frozen.shared, generator)
        return pretrain_loss(both, batch, objective, frozen.bones, dropout, key)

    def step(state: TrainState, batch: Batch, frozen: Frozen):
        key = jax.random.fold_in(frozen.key, state.step)
        gradient, error = jax.grad(loss, has_aux=True)(state.params, batch, frozen, key)
        params, opt_state = descend(tx, gradient, state.opt_state, state.params)
        return TrainState(params, opt_state, state.step + 1), error

    return step
