"""Pure training steps over one minibatch, and the compiled runs of many steps."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import optax
from flax import struct

from pfnn_jax.models.layers import Layer
from pfnn_jax.models.network import Dropout, Network, forward
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.training.batches import Batch, gather
from pfnn_jax.training.losses import PenaltyNorm, l1_penalty, squared_error


def predict_batch(network: Network, adapter: Layer | None, batch: Batch, dropout: Dropout | None, key) -> jax.Array:
    """Normalised outputs [B, O] of a batch, with dropout in training and without it (None) otherwise."""

    def one(x, phase, key):
        coefficients = catmull_rom_basis(phase, network.layers[0].num_control_points)
        return forward(network, adapter, coefficients, x, dropout=dropout, key=key)

    if dropout is None:
        return jax.vmap(lambda x, phase: one(x, phase, None))(batch.x, batch.phase)
    return jax.vmap(one)(batch.x, batch.phase, jax.random.split(key, batch.phase.shape[0]))


@struct.dataclass
class PretrainState:
    """Everything pretraining changes; the bank holds the adapters of S styles on a leading axis."""

    shared: Network
    bank: Layer  # leaves [S, ...]
    shared_optimiser: Any
    bank_optimiser: Any  # leaves [S, ...]
    step: jax.Array  # [] int32


def init_pretrain_state(shared: Any, bank: Any, optimiser: optax.GradientTransformation) -> PretrainState:
    """A state at step 0; each style of the bank has an optimiser state of its own."""
    return PretrainState(
        shared=shared,
        bank=bank,
        shared_optimiser=optimiser.init(shared),
        bank_optimiser=jax.vmap(optimiser.init)(bank),
        step=jnp.zeros((), jnp.int32),
    )


def pretrain_loss(shared, adapter, batch: Batch, dropout: Dropout, key, l1: float, norm: PenaltyNorm):
    """Mason 2018 Eq. 3 for one minibatch of one style; returns (loss, squared error)."""
    error = squared_error(predict_batch(shared, adapter, batch, dropout, key), batch.y)
    return error + l1 * (l1_penalty(shared, norm) + l1_penalty(adapter, norm)), error


PretrainStep = Callable[[PretrainState, Batch, jax.Array], tuple[PretrainState, jax.Array]]


def make_pretrain_step(
    optimiser: optax.GradientTransformation, dropout: Dropout, l1: float, norm: PenaltyNorm
) -> PretrainStep:
    """A pure step (state, batch of style `step mod S`, run key) -> (state, squared error).

    Only that style's adapter, and its optimiser state, change beside the shared parameters.
    """

    def step(state: PretrainState, batch: Batch, run_key: jax.Array):
        num_styles = jax.tree.leaves(state.bank)[0].shape[0]
        style = state.step % num_styles
        adapter, adapter_optimiser = jax.tree.map(lambda leaf: leaf[style], (state.bank, state.bank_optimiser))
        key = jax.random.fold_in(run_key, state.step)
        gradient = jax.grad(pretrain_loss, argnums=(0, 1), has_aux=True)
        (to_shared, to_adapter), error = gradient(state.shared, adapter, batch, dropout, key, l1, norm)
        shared, shared_optimiser = descend(optimiser, to_shared, state.shared_optimiser, state.shared)
        adapter, adapter_optimiser = descend(optimiser, to_adapter, adapter_optimiser, adapter)
        bank, bank_optimiser = jax.tree.map(
            lambda all_styles, one: all_styles.at[style].set(one),
            (state.bank, state.bank_optimiser),
            (adapter, adapter_optimiser),
        )
        return PretrainState(shared, bank, shared_optimiser, bank_optimiser, state.step + 1), error

    return step


def descend(optimiser: optax.GradientTransformation, gradient: Any, state: Any, parameters: Any) -> tuple[Any, Any]:
    """One step of an optimiser on any tree: (new parameters, new optimiser state)."""
    update, state = optimiser.update(gradient, state, parameters)
    return jax.tree.map(jnp.add, parameters, update), state


def make_run_steps(step: PretrainStep):
    """Many steps in one dispatch, the data staying on the device: (state, data, frames [n, B], key) -> (state, [n]).

    The state is donated: its buffers are reused, and the argument must not be read afterwards.
    """

    @partial(jax.jit, donate_argnums=0)
    def run_steps(state: PretrainState, data: Batch, frames: jax.Array, run_key: jax.Array):
        num_styles = data.phase.shape[0]

        def body(state, frames):
            return step(state, gather(data, state.step % num_styles, frames), run_key)

        return jax.lax.scan(body, state, frames)

    return run_steps


def make_run_batches(step: PretrainStep):
    """As `make_run_steps` for data too large for the device: (state, batches [n, B, ...], key) -> (state, [n])."""

    @partial(jax.jit, donate_argnums=0)
    def run_batches(state: PretrainState, batches: Batch, run_key: jax.Array):
        return jax.lax.scan(lambda state, batch: step(state, batch, run_key), state, batches)

    return run_batches
