"""A new style through the FiLM generator: it alone is tuned, the shared network stays frozen (Mason 2022 §4.5)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.models.config import GeneratorConfig
from pfnn_jax.models.film_generator import film_generator
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.network import Network
from pfnn_jax.training.config import equal_dropout, make_objective
from pfnn_jax.training.data import Batch, Rows
from pfnn_jax.training.films import style_films
from pfnn_jax.training.order import order_of
from pfnn_jax.training.pretraining import check_finite, dispatch_sizes, make_dispatch
from pfnn_jax.training.steps import descend, pretrain_loss


@dataclass(frozen=True)
class TuningConfig:
    """How a generator is tuned to a style.

    Attributes:
        epochs: passes over the style's frames (100 in the authors' code).
        steps: number of steps; overrides `epochs` where set.
        batch_size: frames of a minibatch.
        clips_per_batch: clips that the generator reads for it, each modulating an equal share of the frames.
        learning_rate: Adam's.
        dropout: drop probability.
        l1, bone_length: as in `PretrainConfig`; None for what the layout's paper has.
        seed: of shuffling and dropout.
        steps_per_dispatch: steps between looks at the loss.
    """

    epochs: int = 100
    steps: int | None = None
    batch_size: int = 32
    clips_per_batch: int = 4
    learning_rate: float = 1e-4
    dropout: float = 0.3
    l1: float | None = None
    bone_length: float | None = None
    seed: int = 0
    steps_per_dispatch: int = 100

    def __post_init__(self):
        for name in ("epochs", "batch_size", "clips_per_batch", "steps_per_dispatch"):
            if getattr(self, name) < 1:
                raise ValueError(f"TuningConfig.{name} must be at least 1, got {getattr(self, name)}.")
        if self.steps is not None and self.steps < 1:
            raise ValueError(f"TuningConfig.steps must be at least 1, got {self.steps}.")
        if self.batch_size % self.clips_per_batch:
            raise ValueError(
                f"TuningConfig.clips_per_batch must divide batch_size {self.batch_size}, got {self.clips_per_batch}."
            )
        if not 0 <= self.dropout < 1:
            raise ValueError(f"TuningConfig.dropout must be in [0, 1), got {self.dropout}.")
        if self.learning_rate <= 0:
            raise ValueError(f"TuningConfig.learning_rate must be positive, got {self.learning_rate}.")


class Tuned(NamedTuple):
    """What tuning gives: the generator's parameters, and the mean Film over the style's windows."""

    generator: Any
    film: FiLMStyle
    losses: np.ndarray  # [steps] squared errors


@struct.dataclass
class TuningState:
    """What tuning changes."""

    generator: Any
    optimiser: Any
    step: jax.Array  # [] int32


def tune_generator(
    shared: Network,
    sizes: GeneratorConfig,
    parameters: Any,
    data: Rows,
    config: TuningConfig,
    *,
    style: str = "style",
    progress_callback: Callable[[int, float], Any] = lambda step, loss: None,
) -> Tuned:
    """Tunes a pretrained FiLM generator to the rows of one style, drawing clips independently of the frames.

    Args:
        shared: pretrained network and gating, not differentiated and not changed.
        sizes, parameters: the pretrained generator; copied, not changed.
        data: rows and windows of one style (S = 1).
        config: how.
        style: its name, for messages.
        progress_callback: called with (steps done, mean squared error) every `config.steps_per_dispatch` steps.

    Raises:
        ValueError: if there are fewer rows than a minibatch, or no windows.
        TrainingError: when a loss is not finite.
    """
    generator, optimiser = film_generator(sizes), optax.adam(config.learning_rate)
    order = order_of(data, config.batch_size, config.seed, config.clips_per_batch)
    objective = make_objective(data, config.l1, "mean", config.bone_length)
    dropout, run_key = equal_dropout(config.dropout), jax.random.fold_in(jax.random.key(config.seed), 1)

    def loss(generator_parameters: Any, shared: Network, batch: Batch, key: jax.Array):
        return pretrain_loss(shared, generator_parameters, batch, objective, dropout, key, generator)

    def step(state: TuningState, batch: Batch, inputs: tuple[Network, jax.Array]):
        frozen, key = inputs
        key = jax.random.fold_in(key, state.step)
        gradient, error = jax.grad(loss, has_aux=True)(state.generator, frozen, batch, key)
        changed, moments = descend(optimiser, gradient, state.optimiser, state.generator)
        return TuningState(changed, moments, state.step + 1), error

    copied = jax.tree.map(lambda leaf: jnp.array(leaf, copy=True), parameters)
    state = TuningState(copied, optimiser.init(copied), jnp.zeros((), jnp.int32))
    steps = config.epochs * order.steps_per_epoch if config.steps is None else config.steps
    dispatches = dispatch_sizes(0, steps, config.steps_per_dispatch)
    run, losses = make_dispatch(step, data, order, dispatches, (shared, run_key), 2**32), []
    for first, count in dispatches:
        state, errors = run(state, first, count)
        check_finite(errors, first, (style,))
        losses.append(errors)
        progress_callback(first + count, float(errors.mean()))
    films = style_films(generator, state.generator, data, 0)
    return Tuned(state.generator, jax.tree.map(lambda leaf: leaf.mean(axis=0), films), np.concatenate(losses))
