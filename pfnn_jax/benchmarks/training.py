"""Benchmark of training: steps compared to per-sample weight matrices and to matrix products; few-shot learning."""

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
from pfnn_jax.models.style import Layer, Style, init_bank
from pfnn_jax.training.config import MASON2018_FEW_SHOT, RESTYLED_FEW_SHOT
from pfnn_jax.training.data import Batch, Draw
from pfnn_jax.training.few_shot_learning import refit, train_grid
from pfnn_jax.training.loop import TrainState, scan_steps
from pfnn_jax.training.losses import Objective, squared_error
from pfnn_jax.training.restyling import COUNT
from pfnn_jax.training.steps import Frozen, init_train_state, make_pretrain_step, predict_batch

STYLES, FRAMES = 8, 1024
"""Size of the data of the training steps, which is the same for both formulations."""

RATE = 0.3
L1 = 0.01
LEARNING_RATE = 1e-4

CALLS = 5
"""Calls of a product that are timed together, so that a training step does not look fast next to single dispatches."""

AIMS = {32: 12.0, 256: 20.0}
"""Required speed-up over per-sample weights, by batch size."""


def random_frames(shape: tuple[int, ...], sizes: NetworkConfig, seed: int = 0) -> Batch:
    """Returns random frames with leading axes `shape`: normal x and y, uniform phases or normal gating inputs."""
    rng = np.random.default_rng(seed)
    x, y = (rng.normal(size=(*shape, size)).astype(np.float32) for size in (sizes.input_size, sizes.output_size))
    phase = rng.normal(size=(*shape, sizes.phase_size)) if sizes.phase_size else rng.uniform(0, 2 * np.pi, shape)
    return Batch(jnp.asarray(x), jnp.asarray(y), jnp.asarray(phase, jnp.float32))


def fresh_state(sizes: NetworkConfig, form: AdapterConfig, num_styles: int = STYLES) -> TrainState:
    """Returns a training state at step 0 with a bank of styles."""
    bank = init_bank(form, sizes, num_styles, key=jax.random.key(1))
    return init_train_state(init_network(sizes, key=jax.random.key(0)), bank, optax.adam(LEARNING_RATE))


def per_sample_outputs(
    network: Network, style: Style | None, batch: Batch, dropout: Dropout | None, key: jax.Array | None
) -> jax.Array:
    """Returns normalised outputs [B, O] as published implementations do, blending a matrix [I, O] for every frame.

    Computes the same function as `predict_batch`, except for the random numbers of the dropout masks.
    """
    assert style is not None and dropout is not None and key is not None
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
        assert isinstance(style, Layer)
        f = f + jax.vmap(style)(c, drop(keys[3], dropout.adapter, hidden))
    return blended(third, drop(keys[2], dropout.main, activate(1, f)))


def stepper(step: Callable, state: TrainState, data: Batch, batch_size: int, num_steps: int) -> Work:
    """Returns the work of one dispatch of `num_steps` training steps on data [S, N, ...], with a donated state."""
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
    """Returns the rows of a draw, without clips."""
    return jax.tree.map(lambda leaf: leaf[draw.rows], data)


def products(sizes: NetworkConfig, rank: int, batch_size: int) -> list[tuple[int, int, int]]:
    """Returns all matrix products (m, k, n) of one training step with a CP adapter, forward and backward.

    Every product has two transposed products in the backward pass, except that the first layer's input needs no
    gradient.
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
    """Returns the number of floating-point operations of products (m, k, n)."""
    return sum(2 * m * k * n for m, k, n in shapes)


def step_figures(sizes: NetworkConfig, rank: int, batch_size: int, repetitions: int, num_steps: int) -> list[Figure]:
    """Compares a training step of a PFNN with CP adapters to the per-sample formulation."""
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
    """Compares a training step of a network with any kind of style to the per-sample formulation.

    Args:
        section: section of the figures.
        sizes: sizes of the network.
        form: kind of the styles.
        l1: weight of the L1 penalty; there is no bone-length loss.
        batch_size: B.
        repetitions: number of measurements.
        num_steps: steps per dispatch of the package's training step.
        aim: required speed-up.
    """
    dropout = Dropout(main=jnp.float32(RATE), adapter=jnp.float32(RATE))
    data = random_frames((STYLES, FRAMES), sizes)
    ours = make_pretrain_step(optax.adam(LEARNING_RATE), Objective(l1), dropout)
    naive = make_pretrain_step(optax.adam(LEARNING_RATE), Objective(l1), dropout, predict=per_sample_outputs)
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
    """Measures the share of the machine's matrix-product rate that a training step and its parts reach.

    The machine's rate is the highest rate of any of the step's products, measured alone in the same run. Other shapes
    are slower, so the rate of all products measured separately is an upper bound for the step.
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
    for shape in dict.fromkeys(shapes):
        seconds[str(shape)] /= CALLS
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
    product = jax.jit(jnp.matmul)
    return lambda: [product(left, right) for _ in range(CALLS)]


def few_shot_figures(sizes: NetworkConfig, rank: int, num_frames: int, epochs: int, repetitions: int) -> list[Figure]:
    """Measures the seconds of learning a style from `num_frames` frames and their mirror images, with compilation.

    The single setting is the paper's (1e-4, dropout 0.3) on all frames. The default of `few-shot` learns from restyled
    rows too, twice: without the held-out frames, on which its error is measured, and with them.
    """
    shared = init_network(sizes, key=jax.random.key(0))
    data, everything = (random_frames((2 * num_frames + count,), sizes) for count in (0, COUNT))
    default = dataclasses.replace(
        RESTYLED_FEW_SHOT, rank=rank, eval_epochs=(min(epochs, *RESTYLED_FEW_SHOT.eval_epochs),)
    )
    single = dataclasses.replace(MASON2018_FEW_SHOT, rank=rank, adapter_dropouts=(RATE,), eval_epochs=(epochs,))
    few = round(2 * num_frames * default.held_out)
    learn, held = (jax.tree.map(lambda leaf, r=rows: leaf[r], everything) for rows in (slice(few, None), slice(few)))

    def by_default():
        candidates = train_grid(shared, learn, held, default)
        return refit(shared, everything, candidates[0].choice, default)

    paper = _cold(lambda: train_grid(shared, data, held, single)[0].trained, repetitions)
    restyled = _cold(by_default, repetitions)
    section = f"few-shot CP, {num_frames} frames mirrored, with compilation"
    return [
        figure(section, f"the paper's setting, {epochs} epochs", paper, "s", at_most=15.0),
        figure(section, f"the default, with {COUNT} restyled rows", restyled, "s", at_most=15.0),
    ]


def _cold(work: Work, repetitions: int) -> np.ndarray:
    """Returns the seconds [n] of a work that is compiled again in every repetition."""
    seconds = np.empty(repetitions)
    for repetition in range(repetitions):
        jax.clear_caches()
        started = time.perf_counter()
        jax.block_until_ready(work())
        seconds[repetition] = time.perf_counter() - started
    return seconds
