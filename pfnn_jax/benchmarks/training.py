"""Speed of training: against per-sample weight matrices, against the machine's own products, and a whole style."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax

from pfnn_jax.benchmarks.timing import Figure, Work, figure, interleave
from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.dropout import Dropout, drop
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network, coefficients, init_network
from pfnn_jax.models.style import Layer, init_bank
from pfnn_jax.training.config import MASON2018_FEW_SHOT, FewShotConfig
from pfnn_jax.training.data import Batch, Draw
from pfnn_jax.training.few_shot_learning import refit, train_grid
from pfnn_jax.training.loop import TrainState, scan_steps
from pfnn_jax.training.losses import Objective, l1_penalty, squared_error
from pfnn_jax.training.steps import (
    Frozen,
    PretrainParams,
    descend,
    init_train_state,
    make_pretrain_step,
    predict_batch,
)

STYLES, FRAMES = 8, 1024
"""Size of the data that training steps run over; it fits every cache level alike for both formulations."""

RATE = 0.3
L1 = 0.01
LEARNING_RATE = 1e-4

AIMS = {32: 12.0, 256: 20.0}
"""How many times faster than with per-sample weights, by batch size."""


def random_frames(shape: tuple[int, ...], sizes: NetworkConfig, seed: int = 0) -> Batch:
    """Normal inputs and outputs at uniform phases or, for a gating network, normal ones; leading axes `shape`."""
    rng = np.random.default_rng(seed)
    x, y = (rng.normal(size=(*shape, size)).astype(np.float32) for size in (sizes.input_size, sizes.output_size))
    phase = rng.normal(size=(*shape, sizes.phase_size)) if sizes.phase_size else rng.uniform(0, 2 * np.pi, shape)
    return Batch(jnp.asarray(x), jnp.asarray(y), jnp.asarray(phase, jnp.float32))


def fresh_state(sizes: NetworkConfig, form: AdapterConfig, num_styles: int = STYLES) -> TrainState:
    """A state at step 0 with a bank of styles."""
    bank = init_bank(form, sizes.hidden, sizes.num_control_points, num_styles, key=jax.random.key(1))
    return init_train_state(init_network(sizes, key=jax.random.key(0)), bank, optax.adam(LEARNING_RATE))


def per_sample_outputs(
    network: Network, style: Layer | FiLMStyle, batch: Batch, dropout: Dropout, key: jax.Array
) -> jax.Array:
    """The network as published implementations write it: a weight matrix [I, O] blended for every frame.

    The same function of its arguments as `predict_batch`, up to the draw of the dropout masks.
    """
    x, phase, keys = jnp.asarray(batch.x), jnp.asarray(batch.phase), jax.random.split(key, 5)
    blend = jax.vmap(lambda phase, key: coefficients(network, phase, dropout=dropout, key=key))
    c = blend(phase, jax.random.split(keys[4], x.shape[0]))

    def blended(layer: Layer, x: jax.Array) -> jax.Array:
        assert isinstance(layer, BlendedLayer)
        weights = jnp.einsum("bk,kio->bio", c, layer.weights)
        return jnp.einsum("bi,bio->bo", x, weights) + c @ layer.biases

    def activate(index: int, f: jax.Array) -> jax.Array:
        return jax.nn.elu(jax.vmap(partial(style.modulate, index))(f) if isinstance(style, FiLMStyle) else f)

    first, second, third = network.layers
    hidden = activate(0, blended(first, drop(keys[0], dropout.main, x)))
    f = blended(second, drop(keys[1], dropout.main, hidden))
    if not isinstance(style, FiLMStyle):
        f = f + jax.vmap(style)(c, drop(keys[3], dropout.adapter, hidden))
    return blended(third, drop(keys[2], dropout.main, activate(1, f)))


def make_per_sample_step(dropout: Dropout, l1: float = L1) -> Callable:
    """`make_pretrain_step` with `per_sample_outputs`: the same loss, Adam, bank and state."""
    tx = optax.adam(LEARNING_RATE)

    def loss(shared, adapter, batch, key):
        error = squared_error(per_sample_outputs(shared, adapter, batch, dropout, key), batch.y)
        return error + (l1 * (l1_penalty(shared) + l1_penalty(adapter)) if l1 else 0.0), error

    def step(state: TrainState, batch: Batch, frozen: Frozen):
        banks = state.params.modulation, state.opt_state.modulation
        number = state.step % jax.tree.leaves(state.params.modulation)[0].shape[0]
        style, style_state = jax.tree.map(lambda leaf: leaf[number], banks)
        key = jax.random.fold_in(frozen.key, state.step)
        gradient = jax.grad(loss, argnums=(0, 1), has_aux=True)
        (to_shared, to_style), error = gradient(state.params.shared, style, batch, key)
        shared, shared_state = descend(tx, to_shared, state.opt_state.shared, state.params.shared)
        changed = descend(tx, to_style, style_state, style)
        bank, bank_state = jax.tree.map(lambda leaf, one: leaf.at[number].set(one), banks, changed)
        return TrainState(PretrainParams(shared, bank), PretrainParams(shared_state, bank_state), state.step + 1), error

    return step


def stepper(step: Callable, state: TrainState, data: Batch, batch_size: int, num_steps: int) -> Work:
    """Work of one dispatch of `num_steps` donated training steps on data [S, N, ...]."""
    scan = scan_steps(step, gather_rows)
    num_styles, num_frames = data.phase.shape[:2]
    rows = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), data)
    picks = np.random.default_rng(0).integers(0, num_frames, (num_steps, batch_size))
    draw = Draw(jnp.asarray(picks + num_frames * (np.arange(num_steps) % num_styles)[:, None]))
    held = [state]

    def work():
        held[0], errors = scan(held[0], draw, rows, Frozen(jax.random.key(0)))
        return errors

    return work


def gather_rows(data: Batch, draw: Draw) -> Batch:
    """Rows of a draw, without clips."""
    return jax.tree.map(lambda leaf: leaf[draw.rows], data)


def products(sizes: NetworkConfig, rank: int, batch_size: int) -> list[tuple[int, int, int]]:
    """All matrix products (m, k, n) of one training step with a CP adapter, forward and backward.

    The first layer's input needs no gradient; every other product has two transposed ones.
    """
    hidden, points = sizes.hidden, sizes.num_control_points
    first = (batch_size, points * sizes.input_size, hidden)
    rest = [
        (batch_size, points * hidden, hidden),
        (batch_size, points * hidden, sizes.output_size),
        (batch_size, hidden, rank),
        (batch_size, rank, hidden),
    ]
    backward = [shape for m, k, n in rest for shape in ((k, m, n), (m, n, k))]
    return [first, *rest, (first[1], first[0], first[2]), *backward]


def flops(shapes: list[tuple[int, int, int]]) -> int:
    """Floating-point operations of products (m, k, n)."""
    return sum(2 * m * k * n for m, k, n in shapes)


def step_figures(sizes: NetworkConfig, rank: int, batch_size: int, repetitions: int, num_steps: int) -> list[Figure]:
    """A training step beside the per-sample formulation, in pairs."""
    section, aim = f"training step, batch {batch_size}", AIMS.get(batch_size)
    return compare_steps(section, sizes, AdapterConfig("cp", rank), L1, batch_size, repetitions, num_steps, aim)


def compare_steps(
    section: str,
    sizes: NetworkConfig,
    form: AdapterConfig,
    l1: float,
    batch_size: int,
    repetitions: int,
    num_steps: int,
    aim: float | None,
) -> list[Figure]:
    """A training step of a network with styles of any form beside the per-sample formulation, in pairs.

    Args:
        section: name of the figures' section.
        sizes: of the network.
        form: of the styles.
        l1: weight of the penalty; there is no bone-length loss.
        batch_size: B.
        repetitions: of each.
        num_steps: steps in one dispatch of ours.
        aim: how many times faster ours should be.
    """
    dropout = Dropout(main=jnp.float32(RATE), adapter=jnp.float32(RATE))
    data = random_frames((STYLES, FRAMES), sizes)
    ours = make_pretrain_step(optax.adam(LEARNING_RATE), Objective(l1), dropout)
    naive = make_per_sample_step(dropout, l1)
    seconds = interleave(
        {
            "ours": stepper(ours, fresh_state(sizes, form), data, batch_size, num_steps),
            "naive": stepper(naive, fresh_state(sizes, form), data, batch_size, 1),
        },
        repetitions,
    )
    step = seconds["ours"] / num_steps
    return [
        figure(section, "step", 1e3 * step, "ms"),
        figure(section, "step with per-sample weights", 1e3 * seconds["naive"], "ms"),
        figure(section, "frames per second", batch_size / step, "1/s"),
        figure(section, "times faster", seconds["naive"] / step, "x", at_least=aim),
    ]


def rate_figures(sizes: NetworkConfig, rank: int, batch_size: int, repetitions: int, num_steps: int) -> list[Figure]:
    """The share of the machine's matrix-product rate that a step reaches, and what takes the rest.

    The machine's rate is the highest that any of the step's own products reaches alone, in the same run. Not every
    shape reaches it, so the products one by one bound what a step can reach.
    """
    section = f"share of the matrix-product rate, batch {batch_size}"
    shapes = products(sizes, rank, batch_size)
    dropout = Dropout(main=jnp.float32(RATE), adapter=jnp.float32(RATE))
    data, state = random_frames((STYLES, FRAMES), sizes), fresh_state(sizes, AdapterConfig("cp", rank))
    batch = jax.tree.map(lambda leaf: leaf[0, :batch_size], data)
    parameters = (state.params.shared, jax.tree.map(lambda leaf: leaf[0], state.params.modulation))

    def gradient(dropout: Dropout | None) -> Work:
        def error(shared, adapter, key):
            return squared_error(predict_batch(shared, adapter, batch, dropout, key), batch.y)

        return partial(jax.jit(jax.grad(error, argnums=(0, 1))), *parameters, jax.random.key(0))

    step = make_pretrain_step(optax.adam(LEARNING_RATE), Objective(L1), dropout)
    works = {str(shape): _product(shape) for shape in dict.fromkeys(shapes)}
    works |= {"gradient": gradient(None), "gradient with dropout": gradient(dropout)}
    works |= {"step": stepper(step, fresh_state(sizes, AdapterConfig("cp", rank)), data, batch_size, num_steps)}
    seconds = interleave(works, repetitions)
    best = max(flops([shape]) / np.median(seconds[str(shape)]) for shape in shapes)
    alone = np.sum([seconds[str(shape)] for shape in shapes], axis=0)

    def share(name: str, time: np.ndarray) -> Figure:
        return figure(section, name, flops(shapes) / time / best, "", at_least=0.8 if name == "training step" else None)

    return [
        figure(section, "best product", np.array([best / 1e9]), "GFLOP/s"),
        share("all products of a step, one by one", alone),
        share("gradient without dropout, no Adam", seconds["gradient"]),
        share("gradient with dropout, no Adam", seconds["gradient with dropout"]),
        share("training step", seconds["step"] / num_steps),
        figure(section, "training step, of the rate of its products", alone / (seconds["step"] / num_steps), ""),
    ]


def _product(shape: tuple[int, int, int]) -> Work:
    m, k, n = shape
    left, right = jax.random.normal(jax.random.key(0), (m, k)), jax.random.normal(jax.random.key(1), (k, n))
    return partial(jax.jit(jnp.matmul), left, right)


def few_shot_figures(sizes: NetworkConfig, rank: int, num_frames: int, epochs: int, repetitions: int) -> list[Figure]:
    """Seconds to learn a style from `num_frames` frames and their mirror images, compilation included.

    The single setting is the paper's (1e-4, dropout 0.3) on all frames. The grid is the default of `few-shot`, ranked
    on held-out frames, and its choice is trained once more on all frames.
    """
    shared = init_network(sizes, key=jax.random.key(0))
    data = random_frames((2 * num_frames,), sizes)
    default = FewShotConfig(rank=rank)
    eval_epochs = tuple(stop for stop in default.eval_epochs if stop < epochs) + (epochs,)
    default = dataclasses.replace(default, eval_epochs=eval_epochs)
    single = dataclasses.replace(MASON2018_FEW_SHOT, rank=rank, adapter_dropouts=(RATE,), eval_epochs=(epochs,))
    few = round(2 * num_frames * default.held_out)
    learn, held = (jax.tree.map(lambda leaf, r=rows: leaf[r], data) for rows in (slice(few, None), slice(few)))

    def with_grid():
        candidates = train_grid(shared, learn, held, default)
        return refit(shared, data, candidates[0].choice, default)

    paper = _cold(lambda: train_grid(shared, data, held, single)[0].trained, repetitions)
    grid = _cold(with_grid, repetitions)
    section = f"few-shot CP, {num_frames} frames mirrored, {epochs} epochs, with compilation"
    return [
        figure(section, "the paper's setting", paper, "s", at_most=15.0),
        figure(
            section, f"default grid of {len(default.learning_rates) * len(default.main_dropouts)}, and refit", grid, "s"
        ),
    ]


def _cold(work: Work, repetitions: int) -> np.ndarray:
    """Seconds [n] of a work that finds nothing compiled."""
    seconds = np.empty(repetitions)
    for repetition in range(repetitions):
        jax.clear_caches()
        started = time.perf_counter()
        jax.block_until_ready(work())
        seconds[repetition] = time.perf_counter() - started
    return seconds
