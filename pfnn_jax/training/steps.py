"""Pure training steps over one minibatch: predictions, the loss of pretraining, and one step of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
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
from pfnn_jax.training.data import Array, Batch
from pfnn_jax.training.loop import TrainState
from pfnn_jax.training.losses import Bones, Objective


def predict_batch(
    network: Network,
    style: Style | None,
    batch: Batch,
    dropout: Dropout | None,
    key: jax.Array | None,
    *,
    style_per_frame: bool = False,
) -> jax.Array:
    """Returns normalised outputs [B, O] of a batch, with dropout in training and without it (None) otherwise.

    Args:
        network: shared parameters.
        style: of all frames, or with `style_per_frame` a tree of leaves [B, ...].
        batch: B frames.
        dropout: drop probabilities.
        key: needed with `dropout`; every frame draws its own masks.
        style_per_frame: whether every frame has its own style.
    """

    def one(style, x, gating_input, key):
        c = coefficients(network, gating_input, dropout=dropout, key=key)
        return forward(network, style, c, x, dropout=dropout, key=key)

    keys = None if dropout is None or key is None else jax.random.split(key, batch.phase.shape[0])
    axes = (0 if style_per_frame else None, 0, 0, None if keys is None else 0)
    return jax.vmap(one, in_axes=axes)(style, batch.x, batch.phase, keys)


def generate_styles(
    generator: FiLMGenerator, clips: Any, dropout: jax.Array | None, key: jax.Array | None
) -> FiLMStyle:
    """Returns FiLM styles, leaves [C, 2, H], of clips [C, T, F]; every clip goes through the generator once."""
    if dropout is None or key is None:
        return jax.vmap(generator)(clips)
    keys = jax.random.split(key, clips.shape[0])
    return jax.vmap(lambda clip, key: generator(clip, dropout=dropout, key=key))(clips, keys)


def predict_generated(
    network: Network, generator: FiLMGenerator, batch: Batch, dropout: Dropout, key: jax.Array
) -> jax.Array:
    """Returns normalised outputs [B, O] of frames of which equal shares, in order, are modulated by each clip."""
    film_key, key = jax.random.split(key)
    films = generate_styles(generator, batch.clip, dropout.main, film_key)
    share = batch.phase.shape[0] // films.scale.shape[0]
    styles = jax.tree.map(lambda leaf: jnp.repeat(leaf, share, axis=0), films)
    return predict_batch(network, styles, batch, dropout, key, style_per_frame=True)


@struct.dataclass
class PretrainParams:
    """A value for the shared network and one for what modulates it: parameters, their gradients, or optimiser states.

    What modulates the network is a bank, S styles on a leading axis; or, for FiLM, one generator.
    """

    shared: Any
    modulation: Any


def init_train_state(shared: Any, modulation: Any, tx: optax.GradientTransformation) -> TrainState:
    """Returns a state of pretraining at step 0; every style of a bank has its own optimiser state."""
    is_generator = isinstance(modulation, FiLMGenerator)
    init: Callable[[Any], Any] = tx.init if is_generator else jax.vmap(tx.init)
    return TrainState(
        params=PretrainParams(shared, modulation),
        opt_state=PretrainParams(tx.init(shared), init(modulation)),
        step=jnp.zeros((), jnp.int32),
    )


def pretrain_loss(
    params: PretrainParams,
    batch: Batch,
    objective: Objective,
    bones: Bones | None,
    dropout: Dropout,
    key: jax.Array,
    predict: Callable[..., jax.Array] = predict_batch,
) -> tuple[jax.Array, jax.Array]:
    """Returns (loss, squared error) of one minibatch of one style.

    `params.modulation` is that style, or a FiLM generator, in which `dropout.main` acts too. `predict` computes the
    outputs of a batch in a style.
    """
    if isinstance(params.modulation, FiLMGenerator):
        prediction = predict_generated(params.shared, params.modulation, batch, dropout, key)
    else:
        prediction = predict(params.shared, params.modulation, batch, dropout, key)
    return objective.loss(prediction, batch.y, (params.shared, params.modulation), bones)


def equal_dropout(rate: float) -> Dropout:
    """Returns one drop probability for all places."""
    return Dropout(main=jnp.float32(rate), adapter=jnp.float32(rate))


@struct.dataclass
class Frozen:
    """What the steps of a training read and do not change.

    Attributes:
        key: of the run; a step's key is folded from it and the step's number.
        bones: for the bone-length loss, or None.
        shared: the network, where it is not trained.
    """

    key: jax.Array
    bones: Bones | None = None
    shared: Network | None = None


Step = Callable[[TrainState, Batch, Frozen], tuple[TrainState, jax.Array]]


def make_pretrain_step(
    tx: optax.GradientTransformation,
    objective: Objective,
    dropout: Dropout,
    predict: Callable[..., jax.Array] = predict_batch,
) -> Step:
    """Returns a pure step (state, batch of style `step mod S`, frozen) -> (state, squared error).

    In a bank, only that style and its optimiser state change, along with the shared parameters; a generator changes as
    a whole in every step. `predict` computes the outputs of a batch in a style; benchmarks replace it.
    """

    def update(params, opt_state, batch: Batch, key: jax.Array, bones: Bones | None, descend_modulation=descend):
        loss = partial(pretrain_loss, predict=predict)
        gradient, error = jax.grad(loss, has_aux=True)(params, batch, objective, bones, dropout, key)
        shared, shared_state = descend(tx, gradient.shared, opt_state.shared, params.shared)
        modulation, modulation_state = descend_modulation(
            tx, gradient.modulation, opt_state.modulation, params.modulation
        )
        return PretrainParams(shared, modulation), PretrainParams(shared_state, modulation_state), error

    def bank_step(state: TrainState, batch: Batch, frozen: Frozen):
        key = jax.random.fold_in(frozen.key, state.step)
        bank = state.params.modulation, state.opt_state.modulation
        number = state.step % jax.tree.leaves(state.params.modulation)[0].shape[0]
        style, style_state = jax.tree.map(lambda leaf: leaf[number], bank)
        params, opt_state = replace(state.params, modulation=style), replace(state.opt_state, modulation=style_state)
        apart = partial(descend_apart, always=state.step >= 0)
        params, opt_state, error = update(params, opt_state, batch, key, frozen.bones, apart)
        changed = params.modulation, opt_state.modulation
        bank, bank_state = jax.tree.map(lambda leaf, new: leaf.at[number].set(new), bank, changed)
        params, opt_state = replace(params, modulation=bank), replace(opt_state, modulation=bank_state)
        return TrainState(params, opt_state, state.step + 1), error

    def generator_step(state: TrainState, batch: Batch, frozen: Frozen):
        key = jax.random.fold_in(frozen.key, state.step)
        params, opt_state, error = update(state.params, state.opt_state, batch, key, frozen.bones)
        return TrainState(params, opt_state, state.step + 1), error

    def step(state: TrainState, batch: Batch, frozen: Frozen):
        one = generator_step if isinstance(state.params.modulation, FiLMGenerator) else bank_step
        return one(state, batch, frozen)

    return step


def with_pose_noise(step: Step, noise: float, layout: FrameLayout) -> Step:
    """Returns a step that sees poses with noise; what it is to predict stays as it is.

    Args:
        step: as `make_pretrain_step` returns it.
        noise: as `disturb_poses` takes it.
        layout: of the batches.
    """
    columns = layout.joint_inputs

    def noisy(state: TrainState, batch: Batch, frozen: Frozen):
        key = jax.random.fold_in(jax.random.fold_in(frozen.key, state.step), 1)
        return step(state, replace(batch, x=disturb_poses(batch.x, noise, columns, key=key)), frozen)

    return noisy


def disturb_poses(x: Array, noise: float, columns: np.ndarray, *, key: jax.Array) -> Array:
    """Returns inputs [B, Dx] with Gaussian noise in some columns.

    Args:
        x: normalised inputs.
        noise: largest standard deviation; each row takes a uniformly drawn share of it.
        columns: [Dx] mask of the columns that are disturbed.
        key: of the noise.
    """
    share_key, noise_key = jax.random.split(key)
    size = noise * jax.random.uniform(share_key, (x.shape[0], 1))
    return x + jnp.where(columns, size * jax.random.normal(noise_key, x.shape), 0.0)


def descend(tx: optax.GradientTransformation, gradient: Any, opt_state: Any, params: Any) -> tuple[Any, Any]:
    """Returns (new parameters, new optimiser state) after one step of an optimiser on any tree."""
    updates, opt_state = tx.update(gradient, opt_state, params)
    return optax.apply_updates(params, updates), opt_state


def descend_apart(
    tx: optax.GradientTransformation, gradient: Any, opt_state: Any, params: Any, *, always: jax.Array
) -> tuple[Any, Any]:
    """Returns what `descend` does, for one style of a bank that is written in place.

    XLA for CPUs fuses reading, changing and writing a style into loops that read the bank while they write it, for
    which it copies the whole bank in every step. It does not fuse across a branch.

    Args:
        tx, gradient, opt_state, params: as in `descend`.
        always: [] a condition that holds, as the compiler cannot know.
    """

    def in_branch(gradient: Any, opt_state: Any, params: Any) -> tuple[Any, Any]:
        return jax.lax.cond(always, lambda: descend(tx, gradient, opt_state, params), lambda: (params, opt_state))

    return jax.lax.platform_dependent(gradient, opt_state, params, cpu=in_branch, default=partial(descend, tx))
