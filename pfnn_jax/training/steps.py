"""Pure training steps over one minibatch, and the compiled runs of many steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.models.dropout import Dropout
from pfnn_jax.models.film_generator import FiLMGenerator
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.network import Network, coefficients, forward
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.training.data import Batch, Draw, Rows
from pfnn_jax.training.losses import PenaltyNorm, bone_length_loss, l1_penalty, squared_error


@dataclass(frozen=True, eq=False)
class Bones:
    """What the bone-length loss needs to know.

    Attributes:
        layout: says which columns are joint positions.
        parents: [J], -1 for the root.
        std, mean: [Dy] statistics of the outputs.
    """

    layout: FrameLayout
    parents: np.ndarray
    std: np.ndarray
    mean: np.ndarray

    def loss(self, prediction: jax.Array, target: jax.Array | np.ndarray) -> jax.Array:
        """`bone_length_loss` of normalised outputs [B, Dy]."""
        return bone_length_loss(prediction, target, self.layout, self.parents, self.std, self.mean)


def bones_of(data: Rows) -> Bones:
    """The bones of training data.

    Raises:
        ValueError: if it does not tell its parents and the statistics of its outputs.
    """
    if data.parents is None or data.outputs is None:
        raise ValueError("`data` must tell `parents` and `outputs` where a bone-length loss is asked for.")
    return Bones(data.layout, np.asarray(data.parents), data.outputs.std, data.outputs.mean)


@dataclass(frozen=True)
class Objective:
    """The loss of a minibatch: squared error + l1 · |weights| + bone_length · bone-length loss.

    Attributes:
        l1, l1_norm: weight and kind of the L1 penalty; 0 for none.
        bone_length: weight of the bone-length loss; 0 for none.
        bones: needed where `bone_length` is set.
    """

    l1: float = 0.0
    l1_norm: PenaltyNorm = "mean"
    bone_length: float = 0.0
    bones: Bones | None = None

    def loss(self, prediction: jax.Array, target: jax.Array | np.ndarray, parameters: Any) -> tuple[Any, jax.Array]:
        """(loss, squared error) of normalised outputs [B, Dy] and the trees of parameters that are trained.

        Films bear no penalty: where they change nothing their scales are one.
        """
        loss = error = squared_error(prediction, target)
        if self.l1:
            weights = [tree for tree in parameters if not isinstance(tree, FiLMStyle)]
            loss = loss + self.l1 * sum((l1_penalty(tree, self.l1_norm) for tree in weights), start=jnp.zeros(()))
        if self.bone_length and self.bones is not None:
            loss = loss + self.bone_length * self.bones.loss(prediction, target)
        return loss, error


def predict_batch(
    network: Network,
    style: Style | None,
    batch: Batch,
    dropout: Dropout | None,
    key: jax.Array | None,
    *,
    style_per_frame: bool = False,
) -> jax.Array:
    """Normalised outputs [B, O] of a batch, with dropout in training and without it (None) otherwise.

    Args:
        network: shared parameters.
        style: of all frames, or with `style_per_frame` a tree of leaves [B, ...].
        batch: B frames.
        dropout: drop probabilities.
        key: needed with `dropout`; every frame draws masks of its own.
        style_per_frame: whether every frame has a style of its own.
    """

    def one(style, x, phase, key):
        blend = coefficients(network, phase, dropout=dropout, key=key)
        return forward(network, style, blend, x, dropout=dropout, key=key)

    keys = None if dropout is None or key is None else jax.random.split(key, batch.phase.shape[0])
    axes = (0 if style_per_frame else None, 0, 0, None if keys is None else 0)
    return jax.vmap(one, in_axes=axes)(style, batch.x, batch.phase, keys)


def generate_films(
    generator: FiLMGenerator, parameters: Any, clips: Any, dropout: jax.Array | None, key: jax.Array | None
) -> FiLMStyle:
    """Films, leaves [C, 2, H], of clips [C, T, F]; every clip goes through the generator once."""
    if dropout is None or key is None:
        return jax.vmap(lambda clip: generator.apply(parameters, clip))(clips)
    keys = jax.random.split(key, clips.shape[0])
    return jax.vmap(lambda clip, key: generator.apply(parameters, clip, dropout=dropout, key=key))(clips, keys)


def film_predictions(
    network: Network, generator: FiLMGenerator, parameters: Any, batch: Batch, dropout: Dropout, key: jax.Array
) -> jax.Array:
    """Normalised outputs [B, O] of frames of which equal shares, in order, are modulated by each clip's Film."""
    film_key, key = jax.random.split(key)
    films = generate_films(generator, parameters, batch.clip, dropout.main, film_key)
    share = batch.phase.shape[0] // films.scale.shape[0]
    styles = jax.tree.map(lambda leaf: jnp.repeat(leaf, share, axis=0), films)
    return predict_batch(network, styles, batch, dropout, key, style_per_frame=True)


@struct.dataclass
class TrainState:
    """Everything pretraining changes.

    What modulates the network is a bank, the styles of S styles on a leading axis, each with an optimiser state of
    its own; or, for FiLM, the parameters of one generator.
    """

    shared: Network
    modulation: Any
    shared_optimiser: Any
    modulation_optimiser: Any
    step: jax.Array  # [] int32


def init_pretrain_state(
    shared: Any, modulation: Any, optimiser: optax.GradientTransformation, *, is_bank: bool = True
) -> TrainState:
    """A state at step 0; each style of a bank has an optimiser state of its own."""
    init = jax.vmap(optimiser.init) if is_bank else optimiser.init
    return TrainState(shared, modulation, optimiser.init(shared), init(modulation), jnp.zeros((), jnp.int32))


def pretrain_loss(
    shared: Network,
    modulation: Any,
    batch: Batch,
    objective: Objective,
    dropout: Dropout,
    key: jax.Array,
    generator: FiLMGenerator | None = None,
) -> tuple[jax.Array, jax.Array]:
    """(loss, squared error) of one minibatch of one style.

    `modulation` is that style's parameters, or those of the generator where there is one. `dropout.main` acts in the
    generator too.
    """
    if generator is None:
        prediction = predict_batch(shared, modulation, batch, dropout, key)
    else:
        prediction = film_predictions(shared, generator, modulation, batch, dropout, key)
    return objective.loss(prediction, batch.y, (shared, modulation))


PretrainStep = Callable[[TrainState, Batch, jax.Array], tuple[TrainState, jax.Array]]


def make_pretrain_step(
    optimiser: optax.GradientTransformation,
    objective: Objective,
    dropout: Dropout,
    generator: FiLMGenerator | None = None,
) -> PretrainStep:
    """A pure step (state, batch of style `step mod S`, run key) -> (state, squared error).

    Of a bank only that style, and its optimiser state, change beside the shared parameters; a generator changes as a
    whole at every step.
    """
    gradient = jax.grad(partial(pretrain_loss, generator=generator), argnums=(0, 1), has_aux=True)

    def update(state: TrainState, modulation: Any, moments: Any, batch: Batch, run_key: jax.Array):
        key = jax.random.fold_in(run_key, state.step)
        (to_shared, to_modulation), error = gradient(state.shared, modulation, batch, objective, dropout, key)
        shared, shared_moments = descend(optimiser, to_shared, state.shared_optimiser, state.shared)
        modulation, moments = descend(optimiser, to_modulation, moments, modulation)
        return shared, shared_moments, modulation, moments, error

    def bank_step(state: TrainState, batch: Batch, run_key: jax.Array):
        bank = state.modulation, state.modulation_optimiser
        number = state.step % jax.tree.leaves(state.modulation)[0].shape[0]
        one = jax.tree.map(lambda leaf: leaf[number], bank)
        shared, shared_moments, *changed, error = update(state, one[0], one[1], batch, run_key)
        bank, moments = jax.tree.map(lambda leaf, new: leaf.at[number].set(new), bank, tuple(changed))
        return TrainState(shared, bank, shared_moments, moments, state.step + 1), error

    def generator_step(state: TrainState, batch: Batch, run_key: jax.Array):
        parts = update(state, state.modulation, state.modulation_optimiser, batch, run_key)
        shared, shared_moments, parameters, moments, error = parts
        return TrainState(shared, parameters, shared_moments, moments, state.step + 1), error

    return bank_step if generator is None else generator_step


def descend(optimiser: optax.GradientTransformation, gradient: Any, state: Any, parameters: Any) -> tuple[Any, Any]:
    """One step of an optimiser on any tree: (new parameters, new optimiser state)."""
    update, state = optimiser.update(gradient, state, parameters)
    return jax.tree.map(jnp.add, parameters, update), state


def make_run_steps(step: Callable, gather: Callable[[Batch, Draw], Batch], *, rolled: bool = True):
    """Many steps in one call, the data staying on the device: (state, data, draw of n steps, key) -> (state, [n]).

    The state is donated: its buffers are reused, and the argument must not be read afterwards.

    Args:
        step: (state, batch, key) -> (state, squared error).
        gather: as `make_gather` returns it.
        rolled: one compiled loop of n steps; otherwise n dispatches of one compiled step, which is what convolutions
            need: their gradients are several times slower inside a compiled loop on CPUs.
    """

    def one(state: Any, data: Batch, draw: Draw, run_key: jax.Array):
        return step(state, gather(data, draw), run_key)

    if not rolled:
        single = jax.jit(one, donate_argnums=0)
        return lambda state, data, draw, run_key: _one_by_one(lambda s, d: single(s, data, d, run_key), state, draw)

    @partial(jax.jit, donate_argnums=0)
    def run_steps(state: Any, data: Batch, draw: Draw, run_key: jax.Array):
        return jax.lax.scan(lambda state, draw: one(state, data, draw, run_key), state, draw)

    return run_steps


def make_run_batches(step: Callable, *, rolled: bool = True):
    """As `make_run_steps` for data too large for the device: (state, batches [n, B, ...], key) -> (state, [n])."""
    if not rolled:
        single = jax.jit(step, donate_argnums=0)
        return lambda state, batches, run_key: _one_by_one(lambda s, b: single(s, b, run_key), state, batches)

    @partial(jax.jit, donate_argnums=0)
    def run_batches(state: Any, batches: Batch, run_key: jax.Array):
        return jax.lax.scan(lambda state, batch: step(state, batch, run_key), state, batches)

    return run_batches


def _one_by_one(single: Callable, state: Any, steps: Any) -> tuple[Any, np.ndarray]:
    """`jax.lax.scan` in Python, over a tree of NumPy arrays [n, ...]."""
    errors = []
    for number in range(len(jax.tree.leaves(steps)[0])):
        state, error = single(state, jax.tree.map(lambda leaf, i=number: leaf[i], steps))
        errors.append(error)
    return state, np.array(errors)
