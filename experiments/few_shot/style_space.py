"""Is a new style a mixture of the known ones?

Question  do mixing weights of the known styles suffice, so that nothing but them is learned?
Method    the adapter is the mixture of the bank by S weights (the mixture of CP layers of rank R is a CP layer of rank
          S R), which begin equal and are learned from the clip alone, and from the clip and restyled rows.
Verdict   (present heading correction) elderly 4.39 / 4.47 from the clip, 4.41 / 4.45 from restyled rows too, feminine
          3.77 / 3.91 and 3.67 / 3.62, where an adapter has 2.59 / 2.62 and 3.07 / 2.97: no mixture of six styles.
Run       python -m experiments.few_shot.style_space --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import tyro

from experiments.common.few_shot_recipes import (
    Learning,
    LearningData,
    clip_rows,
    learning_data,
    minimise,
    style_loss,
)
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import PAPER
from experiments.common.varied_restyling import BASE, default_rows
from pfnn_jax.models.style import Style, mix_styles
from pfnn_jax.training.data import join_batches

WEIGHT_LEARNING = Learning(steps=300, learning_rate=2e-2)
"""Few numbers are learned: fewer and larger steps."""


def mixture_loss(weights: jax.Array, data: LearningData, learning: Learning, key: jax.Array) -> jax.Array:
    """Returns the loss of a mixture of the bank `data.other` by weights [S]."""
    return style_loss(mix_styles(data.other, weights), data, learning, key)


def learn_weights(fold: Fold, kind: NetworkKind, restyled: bool) -> Style:
    """Returns the mixture of the bank that is learned from the clip, and from restyled rows too."""
    network = fold.network(kind)
    rows = [clip_rows(fold, network), *([default_rows(fold, kind)] if restyled else [])]
    data = learning_data(fold, network, join_batches(rows), network.bank)
    styles = len(fold.known_styles(kind))
    weights = minimise(mixture_loss, jnp.full(styles, 1 / styles), data, WEIGHT_LEARNING, jax.random.key(fold.seed))
    return mix_styles(data.other, weights)


METHODS = {
    "mixing weights, clip": Method(partial(learn_weights, restyled=False)),
    "mixing weights, clip and restyled rows": Method(partial(learn_weights, restyled=True)),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "style_space", METHODS, (PAPER, BASE))
