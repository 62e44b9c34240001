"""Pretraining in memory: from the rows of S styles to a shared network and its styles (Mason 2018 §7, 2022 §4.4)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
import optax
from jax.sharding import Mesh

from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import init_bank
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.film_styles import mean_styles
from pfnn_jax.training.hosts import check_same, is_first
from pfnn_jax.training.loop import Progress, RowTraining, TrainState, no_progress
from pfnn_jax.training.losses import Objective
from pfnn_jax.training.order import StepOrder, identity, order_of
from pfnn_jax.training.precision import at_precision
from pfnn_jax.training.sharding import data_mesh, in_host_memory, is_spread
from pfnn_jax.training.steps import Frozen, equal_dropout, init_train_state, make_pretrain_step, with_pose_noise

POSE_NOISE = 0.05
"""Default noise on the poses of layouts with a global phase (docs/research/few_shot.md)."""


def pretrain(
    rows: Rows,
    config: PretrainConfig | None = None,
    *,
    key: jax.Array | None = None,
    state: TrainState | None = None,
    devices: Sequence[Any] | None = None,
    progress_callback: Callable[[Progress], Any] = no_progress,
    state_callback: Callable[[TrainState, Progress], Any] = no_progress,
) -> TrainState:
    """Trains a shared network and the styles of `rows`, from the beginning or from a state, to the end.

    A step depends on the state, the rows, the key and its own number alone, so that a resumed training repeats itself
    bit for bit.

    Args:
        rows: rows of S styles. Kept on the device where they fit `config.device_bytes`, else read batch by batch.
        config: how to train; `PretrainConfig()` by default. The order of minibatches follows `config.seed`.
        key: of initialisation and dropout; by default from `config.seed`.
        state: where to begin, as an earlier call with the same config and key left it; donated: read the returned one.
            Of several processes the first one's counts.
        devices: that share each minibatch; by default as many of all as divide `config.batch_size`. Their number may
            change when a training is resumed: it changes the order of sums, and no random number. Where
            `jax.distributed` has connected several processes, all of them must call this with the same rows and config.
        progress_callback: called after every `config.steps_per_dispatch` steps.
        state_callback: called at the same moments with the state too, e.g. to save it.

    Returns:
        The state after the last step: `params.shared` is the network, `params.modulation` the bank of styles
        [S, ...], or with FiLM the generator; `styles_of` gives the styles in both cases. What is spread over several
        processes can be read after `pfnn_jax.training.sharding.collect`; the state of `state_callback` likewise.

    Raises:
        InputError: if the rows or the config are not those of the first process.
        LostProcessError: if another process has ended.
        TrainingError: when a loss is not finite, before the callbacks see that state.
        ValueError: if a style has fewer rows than a batch, windows or bones are needed and absent, or the number of
            `devices` does not divide a batch.
    """
    config = PretrainConfig() if config is None else config
    key = jax.random.key(config.seed) if key is None else key
    order = order_of(rows, config.batch_size, config.seed, config.num_clips)
    objective = Objective.for_layout(rows.layout, config.l1, config.l1_norm, config.bone_length)
    step = make_pretrain_step(optax.adam(config.learning_rate), objective, equal_dropout(config.dropout))
    noise = pose_noise(config, rows.layout)
    if noise:
        step = with_pose_noise(step, noise, rows.layout)
    step = at_precision(step, config.precision)
    frozen = Frozen(jax.random.fold_in(key, 1), rows.bones() if objective.bone_length else None)
    mesh = data_mesh(config.batch_size, devices)
    check_same("settings and rows", config, np.asarray(jax.random.key_data(key)), *identity(rows))
    state = _first_state(config, rows, key, mesh) if state is None else state
    steps = total_steps(config, order)
    training = RowTraining(step, rows, order, steps, config.steps_per_dispatch, config.device_bytes, mesh)

    def callback(state: TrainState, progress: Progress) -> None:
        state_callback(state, progress)
        progress_callback(progress)

    return training.run(state, frozen, callback)[0]


def _first_state(config: PretrainConfig, rows: Rows, key: jax.Array, mesh: Mesh | None) -> TrainState:
    """Returns the state at step 0; in all processes but the first only its shapes."""

    def init() -> TrainState:
        return init_state(config, rows.layout, len(rows.styles), key=key)

    abstract = jax.eval_shape(init)
    if not is_first():
        return abstract
    with in_host_memory(is_spread(abstract, mesh)):
        return init()


def pose_noise(config: PretrainConfig, layout: FrameLayout) -> float:
    """Returns the noise on poses: that of the config, or the default of a layout."""
    if config.pose_noise is not None:
        return config.pose_noise
    return 0.0 if layout.phase_size else POSE_NOISE


def init_state(
    config: PretrainConfig, layout: FrameLayout, num_styles: int, *, key: jax.Array | None = None
) -> TrainState:
    """Returns the state at step 0 for S styles of a layout; it depends on the arguments alone."""
    shared_key, style_key = jax.random.split(jax.random.key(config.seed) if key is None else key)
    sizes, generator = config.network(layout), config.generator(layout)
    shared, tx = init_network(sizes, key=shared_key), optax.adam(config.learning_rate)
    if generator is not None:
        return init_train_state(shared, FiLMGenerator.init(generator, key=style_key), tx)
    bank = init_bank(config.adapter, sizes, num_styles, key=style_key)
    return init_train_state(shared, bank, tx)


def styles_of(state: TrainState, rows: Rows) -> Any:
    """Returns the trained styles, stacked [S, ...]: the bank, or the mean FiLM styles that a generator makes.

    Args:
        state: of training.
        rows: that it was trained on; the generator reads windows of every style.
    """
    modulation = state.params.modulation
    return mean_styles(modulation, rows) if isinstance(modulation, FiLMGenerator) else modulation


def total_steps(config: PretrainConfig, order: StepOrder) -> int:
    """Returns the number of steps of the full training."""
    return config.epochs * order.steps_per_epoch if config.steps is None else config.steps
