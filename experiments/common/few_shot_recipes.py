"""Learns adapters from given rows: the loop that experiments on few-shot learning vary.

`pfnn_jax.training.few_shot_learning` learns as users do. Here the rows, the loss, the schedule and what is trained are
arguments, one fixed setting at a time.
"""

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

from experiments.common.style_takes import TrainedNetwork, rows_of
from experiments.common.turning_folds import WITHOUT, Fold, NetworkKind, no_style
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.dropout import Dropout
from pfnn_jax.models.network import Network, config_of
from pfnn_jax.models.style import Style, init_style
from pfnn_jax.motion.features.encode import Features, select_rows
from pfnn_jax.training.config import MASON2018_FEW_SHOT, RESTYLED_FEW_SHOT, FewShotConfig
from pfnn_jax.training.data import Batch, Rows, join_batches, to_batch
from pfnn_jax.training.few_shot_learning import fit_style
from pfnn_jax.training.losses import l1_penalty
from pfnn_jax.training.restyling import COUNT, FASTEST, StyleDifferences, find_differences
from pfnn_jax.training.steps import descend, predict_batch
from pfnn_jax.workflows.pretrain import DIFFERENCE_ROWS


@dataclass(frozen=True)
class Learning:
    """How parameters are learned from rows.

    Attributes:
        steps: number of steps of Adam.
        batch_size: rows of a step, drawn with replacement.
        learning_rate: at the beginning.
        decay: whether it falls to zero along half a cosine.
        average: share of the steps, at the end, over which the parameters are averaged; 0 takes the last ones.
        main_dropout, adapter_dropout: drop probabilities before the shared layers and before the adapter.
        noise: standard deviation of noise on the normalised joint inputs.
        l1: weight of the L1 penalty.
    """

    steps: int = 600
    batch_size: int = 128
    learning_rate: float = 5e-3
    decay: bool = True
    average: float = 0.0
    main_dropout: float = 0.3
    adapter_dropout: float = 0.0
    noise: float = 0.0
    l1: float = 0.01


@struct.dataclass
class LearningData:
    """What a loss reads and training does not change.

    Attributes:
        shared: the network.
        rows: N normalised rows.
        joints: [Dx] 1 in the joint columns of x, else 0.
        other: anything else that a loss needs.
    """

    shared: Network
    rows: Batch
    joints: Any
    other: Any = None


Loss = Callable[[Any, LearningData, Learning, jax.Array], jax.Array]
"""(parameters, data, settings, key) -> loss of one minibatch."""


def row_loss(params: Any, data: LearningData, learning: Learning, key: jax.Array) -> jax.Array:
    """Returns the loss of an adapter on a minibatch of rows."""
    return style_loss(params, data, learning, key) + learning.l1 * l1_penalty(params)


def style_loss(style: Style, data: LearningData, learning: Learning, key: jax.Array) -> jax.Array:
    """Returns the mean squared error of a network with a style on a minibatch of rows."""
    row_key, noise_key, dropout_key = jax.random.split(key, 3)
    picked = jax.random.randint(row_key, (learning.batch_size,), 0, data.rows.phase.shape[0])
    x, y, phase = (leaf[picked] for leaf in (data.rows.x, data.rows.y, data.rows.phase))
    if learning.noise:
        x = x + learning.noise * data.joints * jax.random.normal(noise_key, x.shape)
    dropout = Dropout(main=jnp.float32(learning.main_dropout), adapter=jnp.float32(learning.adapter_dropout))
    predicted = predict_batch(data.shared, style, Batch(x, y, phase), dropout, dropout_key)
    return jnp.mean(jnp.square(predicted - y))


@partial(jax.jit, static_argnames=("loss", "learning"))
def minimise(loss: Loss, start: Any, data: LearningData, learning: Learning, key: jax.Array) -> Any:
    """Returns the parameters that Adam finds from a start."""
    rate = optax.cosine_decay_schedule(1.0, learning.steps) if learning.decay else optax.constant_schedule(1.0)
    tx = optax.chain(optax.scale_by_adam(), optax.scale_by_schedule(rate), optax.scale(-learning.learning_rate))
    first_averaged = learning.steps - max(round(learning.average * learning.steps), 1)

    def step(carry: tuple, number: jax.Array) -> tuple[tuple, None]:
        params, opt_state, total = carry
        gradient = jax.grad(loss)(params, data, learning, jax.random.fold_in(key, number))
        params, opt_state = descend(tx, gradient, opt_state, params)
        total = jax.tree.map(lambda old, new: old + jnp.where(number >= first_averaged, new, 0.0), total, params)
        return (params, opt_state, total), None

    begin = start, tx.init(start), jax.tree.map(jnp.zeros_like, start)
    total = jax.lax.scan(step, begin, jnp.arange(learning.steps))[0][2]
    return jax.tree.map(lambda leaf: leaf / (learning.steps - first_averaged), total)


def learning_data(fold: Fold, network: TrainedNetwork, rows: Batch, other: Any = None) -> LearningData:
    """Returns what `minimise` reads for rows of a fold."""
    joints = fold.layout.joint_inputs.astype(np.float32)
    return jax.tree.map(jnp.asarray, LearningData(network.shared, rows, joints, other))


def learn_rows(
    fold: Fold,
    network: TrainedNetwork,
    rows: Batch,
    learning: Learning = Learning(),  # noqa: B008 - frozen
    *,
    adapter: AdapterConfig = AdapterConfig(),  # noqa: B008 - frozen
    start: Style | None = None,
) -> Style:
    """Returns the adapter that is learned from rows [N, ...], from a start or a fresh one of a form."""
    key = jax.random.key(fold.seed)
    if start is None:
        sizes = config_of(network.shared)
        start = init_style(adapter, sizes, key=jax.random.fold_in(key, 1))
    return minimise(row_loss, jax.tree.map(jnp.asarray, start), learning_data(fold, network, rows), learning, key)


def clip_rows(fold: Fold, network: TrainedNetwork) -> Batch:
    """Returns the normalised rows of the adaptation clip and of its mirror image."""
    return to_batch(fold.clip, network.normaliser)


def own_turn_rows(fold: Fold, network: TrainedNetwork) -> Batch:
    """Returns the normalised rows of the style's own turning takes but those it is tested on."""
    return to_batch([rows_of(fold.other_turns)], network.normaliser)


def learn_nothing(fold: Fold, kind: NetworkKind = WITHOUT) -> Style:
    """Returns a style that changes nothing."""
    return no_style(fold.network(kind))


def learn_paper(fold: Fold, kind: NetworkKind = WITHOUT) -> Style:
    """Returns the style that the paper's recipe learns from the clip (Mason 2018 §7.2)."""
    network = fold.network(kind)
    rows = Rows.from_features({fold.style: list(fold.clip)}, fold.layout, network.normaliser)
    return fit_style(network.shared, rows, MASON2018_FEW_SHOT, key=jax.random.key(fold.seed)).style


def known_differences(
    fold: Fold, kind: NetworkKind = WITHOUT, count: int = COUNT, fastest: float = FASTEST
) -> StyleDifferences:
    """Returns the differences of the styles that a network knows, as a run keeps them.

    Args:
        fold: whose known takes are read.
        kind: of the network.
        count, fastest: as `find_differences` takes them.
    """
    rows = {style: evenly(rows_of(takes), DIFFERENCE_ROWS) for style, takes in fold.known_takes(kind).items()}
    options = {"count": count, "fastest": fastest, "seed": fold.seed}
    found = find_differences(rows, fold.layout, fold.network(kind).normaliser, **options)
    assert found is not None  # all styles have straight walks and turns
    return found


def evenly(rows: Features, count: int) -> Features:
    """Returns at most `count` rows, evenly spaced."""
    return select_rows(rows, np.unique(np.linspace(0, len(rows.x) - 1, count).round().astype(int)))


def learn_restyled(
    fold: Fold, kind: NetworkKind, config: FewShotConfig = RESTYLED_FEW_SHOT, fastest: float = FASTEST
) -> Style:
    """Returns the style that `few-shot` learns by default from the clip and the known styles' differences.

    Args:
        fold, kind: of the network.
        config: of learning.
        fastest: as `find_differences` takes it.
    """
    differences = known_differences(fold, kind, fastest=fastest)
    network = fold.network(kind)
    rows = Rows.from_features({fold.style: list(fold.clip)}, fold.layout, network.normaliser)
    return fit_style(network.shared, rows, config, key=jax.random.key(fold.seed), differences=differences).style


def learn_own_turns(
    fold: Fold,
    kind: NetworkKind = WITHOUT,
    learning: Learning = Learning(),  # noqa: B008 - frozen
    **options,
) -> Style:
    """Returns an adapter of the clip and of the style's own turns but those it is tested on: a bound for all others."""
    network = fold.network(kind)
    return learn_rows(
        fold, network, join_batches([clip_rows(fold, network), own_turn_rows(fold, network)]), learning, **options
    )
