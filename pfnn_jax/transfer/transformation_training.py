"""Trains the transformation network of one style on many contents (Holden et al. 2017, Training), and applies it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from flax import struct

from pfnn_jax.errors import InputError
from pfnn_jax.models.convolution import POOLING
from pfnn_jax.training.loop import Progress, no_progress
from pfnn_jax.transfer.autoencoder import MotionAutoencoder
from pfnn_jax.transfer.clip_rows import cut_windows
from pfnn_jax.transfer.config import LossWeights, TransformationTrainingConfig
from pfnn_jax.transfer.layout import ClipLayout
from pfnn_jax.transfer.losses import (
    Constraints,
    bone_loss,
    content_constraints,
    content_loss,
    foot_loss,
    style_loss,
    trajectory_loss,
)
from pfnn_jax.transfer.optimisation import add_change, padded_length, speed_ratio, style_gram
from pfnn_jax.transfer.pairing import GaitClip, Pairing
from pfnn_jax.transfer.run import TransferRun
from pfnn_jax.transfer.transformation import TransformationNetwork, init_transformation
from pfnn_jax.transfer.window_training import draw_order, train_windows

TERMS = ("content", "style", "foot", "bone", "trajectory")


@struct.dataclass
class Windows:
    """Windows of contents, and what their results must satisfy.

    Attributes:
        x: [N, T, D] normalised.
        constraints: leaves [N, ...].
        group: [N] of the style's Gram matrices.
    """

    x: Any
    constraints: Constraints
    group: Any


@struct.dataclass
class Frozen:
    """What training reads and does not change.

    Attributes:
        autoencoder: the loss network.
        mean, std: [D] statistics of the run.
        grams: [G, F, F] Gram matrix of the style's clips in each group of the pairing.
    """

    autoencoder: MotionAutoencoder
    mean: jax.Array
    std: jax.Array
    grams: jax.Array


def train_transformation(
    run: TransferRun,
    contents: Sequence[GaitClip],
    styles: Sequence[GaitClip],
    pairing: Pairing,
    config: TransformationTrainingConfig | None = None,
    *,
    progress_callback: Callable[[Progress], Any] = no_progress,
) -> tuple[TransformationNetwork, dict[str, Any]]:
    """Returns the network of one style, trained by Adam on windows of contents (Eq. 10), and what training measured.

    Args:
        run: its autoencoder is the loss network.
        contents: clips to learn from.
        styles: clips of the style.
        pairing: of both, as `pair_by_gait` returns it.
        config: sizes, weights and schedule.
        progress_callback: called after every chunk of steps.

    Returns:
        (network, metrics): `windows`, `loss` (mean of the last epoch), and the loss and each of its terms on held-out
        clips before and after training, where clips are held out.

    Raises:
        InputError: if there is no content.
        TrainingError: when the loss becomes non-finite.
    """
    config = config or TransformationTrainingConfig()
    if not contents:
        raise InputError("train_transformation", "contents", "none", "must be at least one clip")
    held = _held_out(len(contents), config)
    learned, tested = (_windows(run, contents, styles, pairing, which) for which in (~held, held))
    frozen = _frozen(run, styles, pairing)
    params = init_transformation(config.network, run.layout.size, key=jax.random.key(config.seed))
    before = _measure(params, tested, frozen, run.layout, config)
    params, losses = _train(params, learned, frozen, run.layout, config, progress_callback)
    after = _measure(params, tested, frozen, run.layout, config)
    epoch = -(-len(learned.x) // config.batch_size)
    metrics = {"windows": len(learned.x), "held_out_windows": len(tested.x), "loss": float(losses[-epoch:].mean())}
    return params, {**metrics, "held_out_before": before, "held_out": after}


def window_losses(
    result: jax.Array,
    x: jax.Array,
    constraints: Constraints,
    target: jax.Array,
    frozen: Frozen,
    layout: ClipLayout,
    keep_detail: bool,
) -> dict[str, jax.Array]:
    """Returns the terms of Eq. 10, without weights, of the result of one window.

    Args:
        result, x: [T, D] normalised, the output of the network, and its input, the content.
        constraints: of the content.
        target: [F, F] Gram matrix of the style.
        frozen: loss network and statistics.
        layout: of the rows.
        keep_detail: whether constraints see the motion that `apply_network` returns, after the projection, or the
            network's, as in the paper.
    """
    autoencoder = frozen.autoencoder
    hidden, content = autoencoder.encode(result), autoencoder.encode(x)
    if keep_detail:
        result = add_change(x, autoencoder.decode(content), autoencoder.decode(hidden))
    rows = result * frozen.std[None] + frozen.mean[None]
    return {
        "content": content_loss(hidden, content),
        "style": style_loss(hidden, target),
        "foot": foot_loss(rows, constraints, layout),
        "bone": bone_loss(rows, constraints, layout),
        "trajectory": trajectory_loss(rows, constraints, layout),
    }


def apply_network(
    run: TransferRun,
    network: TransformationNetwork,
    rows: np.ndarray,
    *,
    project: bool = True,
    keep_detail: bool = True,
) -> np.ndarray:
    """Returns the rows [T, D] of a clip transferred by a network, in layout units.

    Args:
        run: its autoencoder, statistics and layout.
        network: of one style.
        rows: [T, D] in layout units; clips of many lengths share a few compilations.
        project: project the result onto the motions that the autoencoder can express.
        keep_detail: project the content as well, and add only what the network changes to it; see `add_change`.
    """
    frames = len(rows)
    even = frames + frames % POOLING  # the autoencoder pools pairs of frames
    x = np.zeros((padded_length(frames), rows.shape[1]), np.float32)
    x[:frames], x[frames:even] = run.statistics.apply(rows), run.statistics.apply(rows[-1])
    mask = (np.arange(len(x)) < even).astype(np.float32)
    y = _apply(network, run.autoencoder, x, mask, project=project, keep_detail=keep_detail)
    return np.asarray(run.statistics.invert(np.asarray(y, np.float64)[:frames]))


@partial(jax.jit, static_argnames=("project", "keep_detail"))
def _apply(
    network: TransformationNetwork,
    autoencoder: MotionAutoencoder,
    x: jax.Array,
    mask: jax.Array,
    *,
    project: bool,
    keep_detail: bool,
) -> jax.Array:
    def projected(x: jax.Array) -> jax.Array:
        return autoencoder.decode(autoencoder.encode(x), mask[::POOLING])

    y = network(x, mask)
    if not project:
        return y
    return add_change(x, projected(x), projected(y)) if keep_detail else projected(y)


def _held_out(count: int, config: TransformationTrainingConfig) -> np.ndarray:
    """Returns which clips [N] are held out, at least one is not."""
    held = np.zeros(count, bool)
    order = np.random.default_rng(config.seed).permutation(count)
    held[order[: min(round(config.held_out * count), count - 1)]] = True
    return held


def _windows(
    run: TransferRun, contents: Sequence[GaitClip], styles: Sequence[GaitClip], pairing: Pairing, which: np.ndarray
) -> Windows:
    """Returns the windows of the contents that `which` [N] selects."""
    layout, x, constraints, groups = run.layout, [], [], []
    for index in np.flatnonzero(which).tolist():
        rows, group = contents[index].rows, int(pairing.group_of[index])
        ratio = speed_ratio(rows, [styles[member].rows for member in pairing.members[group]], layout)
        for window in cut_windows(rows, layout):
            x.append(np.asarray(run.statistics.apply(window), np.float32))
            constraints.append(content_constraints(window, layout, ratio))
            groups.append(group)
    if not x:
        return Windows(
            np.zeros((0, 0, layout.size), np.float32), Constraints(*[np.zeros(0)] * 4), np.zeros(0, np.int32)
        )
    joined = jax.tree.map(lambda *leaves: np.stack(leaves), *constraints)
    return Windows(np.stack(x), joined, np.array(groups, np.int32))


def _frozen(run: TransferRun, styles: Sequence[GaitClip], pairing: Pairing) -> Frozen:
    grams = [style_gram(run, [styles[member].rows for member in members]) for members in pairing.members]
    mean, std = (jnp.asarray(values, jnp.float32) for values in (run.statistics.mean, run.statistics.std))
    return Frozen(run.autoencoder, mean, std, jnp.stack(grams))


def _batch_losses(
    network: TransformationNetwork, batch: Windows, frozen: Frozen, layout: ClipLayout, keep_detail: bool
) -> dict[str, jax.Array]:
    """Returns the mean over a minibatch of each term."""

    def one(x: jax.Array, constraints: Constraints, group: jax.Array) -> dict[str, jax.Array]:
        return window_losses(network(x), x, constraints, frozen.grams[group], frozen, layout, keep_detail)

    terms = jax.vmap(one)(batch.x, batch.constraints, batch.group)
    return {name: jnp.mean(values) for name, values in terms.items()}


def _total(terms: dict[str, jax.Array], weights: LossWeights) -> jax.Array:
    return sum((getattr(weights, name) * terms[name] for name in TERMS), start=jnp.zeros(()))


def _measure(
    network: TransformationNetwork,
    windows: Windows,
    frozen: Frozen,
    layout: ClipLayout,
    config: TransformationTrainingConfig,
) -> dict[str, float]:
    """Returns the loss and its terms on windows; empty if there are none."""
    count, size = len(windows.x), config.batch_size
    if not count:
        return {}
    measure = jax.jit(partial(_batch_losses, layout=layout, keep_detail=config.keep_detail))
    found: dict[str, float] = dict.fromkeys(TERMS, 0.0)
    for start in range(0, count, size):
        # The last minibatch begins with its first windows again, so that one program serves all.
        rows = np.arange(start, start + size) % count
        terms = measure(network, jax.tree.map(lambda leaf, rows=rows: leaf[rows], windows), frozen)
        for name in TERMS:
            found[name] += float(terms[name]) / -(-count // size)
    return {**found, "loss": sum(getattr(config.weights, name) * found[name] for name in TERMS)}


def _train(
    params: Any,
    windows: Windows,
    frozen: Frozen,
    layout: ClipLayout,
    config: TransformationTrainingConfig,
    progress_callback: Callable[[Progress], Any],
) -> tuple[TransformationNetwork, np.ndarray]:
    """Returns the trained network and the loss [steps] of every step."""
    steps = config.epochs * -(-len(windows.x) // config.batch_size)

    def loss(
        params: TransformationNetwork, batch: Windows, frozen: Frozen, step: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        total = _total(_batch_losses(params, batch, frozen, layout, config.keep_detail), config.weights)
        return total, total

    return train_windows(
        params,
        windows,
        frozen,
        loss,
        optax.adam(optax.cosine_decay_schedule(config.learning_rate, steps)),
        draw_order(len(windows.x), steps, config.batch_size, config.seed),
        precision=config.precision,
        steps_per_dispatch=config.steps_per_dispatch,
        progress_callback=progress_callback,
    )
