"""Does a style need parameters of its own on the outputs?

Question  an adapter on the second layer changes what the last hidden layer computes; poses stay in the span of the last
          layer, which knows the other styles alone. Does a style come nearer to its actor with parameters on the
          outputs?
Method    next to CP of rank 30 on the second layer (31,352 numbers), the default: the same and a bias of the outputs,
          blended by phase (K times Dy numbers: 1,120); CP of rank 30 on the last layer alone, with such a bias
          (25,280); and CP of rank 10 on the second with CP of rank 25 on the last layer and the bias (31,812). Learned
          from the clip and restyled rows in the same loop; the second also from the style's own turns.
Run       python -m experiments.few_shot.output_layer --data FOLDER --out runs/few_shot
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import tyro
from flax import struct

from experiments.common.few_shot_recipes import (
    Learning,
    LearningData,
    clip_rows,
    join_batches,
    learning_data,
    minimise,
    own_turn_rows,
    style_loss,
)
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, no_style, run_methods
from experiments.common.turning_table import OWN_TURNS, PAPER
from experiments.common.varied_restyling import BASE, default_rows
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network, config_of
from pfnn_jax.models.style import Style
from pfnn_jax.training.losses import l1_penalty


@struct.dataclass
class Residuals:
    """Residuals on the second layer and on the outputs; None for none."""

    hidden: CPLayer | None
    outputs: CPLayer | None
    biases: jax.Array  # [K, Dy], of the outputs

    def merged(self, network: Network) -> Network:
        """Returns the network with the residual of the outputs added to its last layer."""
        first, second, last = network.layers
        assert isinstance(last, BlendedLayer)  # the experiment's networks are not decomposed
        weights, biases = last.weights, last.biases + self.biases
        if self.outputs is not None:
            weights = weights + jnp.einsum("or,kr,ir->kio", self.outputs.a, self.outputs.d, self.outputs.b)
            biases = biases + self.outputs.bias
        return replace(network, layers=(first, second, BlendedLayer(weights=weights, biases=biases)))


def residual_loss(params: Residuals, data: LearningData, learning: Learning, key: jax.Array) -> jax.Array:
    """Returns the loss of the residuals on a minibatch of rows."""
    error = style_loss(params.hidden, replace(data, shared=params.merged(data.shared)), learning, key)
    return error + learning.l1 * l1_penalty(params)


def learn_residuals(
    fold: Fold, kind: NetworkKind, ranks: tuple[int, int], own_turns: bool = False
) -> tuple[Network, Style]:
    """Returns the network with changed outputs, and the adapter of its second layer.

    Args:
        fold, kind: of the network.
        ranks: of the residuals of the second layer and of the outputs, 0 for none.
        own_turns: whether to learn from the style's own turns instead of restyled rows.
    """
    network, key = fold.network(kind), jax.random.key(fold.seed)
    sizes = config_of(network.shared)
    points = sizes.num_control_points

    def residual(outputs: int, rank: int, number: int) -> CPLayer | None:
        key_of = jax.random.fold_in(key, number)
        return CPLayer.init(sizes.hidden, outputs, points, rank=rank, key=key_of) if rank else None

    hidden, outputs = residual(sizes.hidden, ranks[0], 1), residual(sizes.output_size, ranks[1], 2)
    start = Residuals(hidden, outputs, jnp.zeros((points, sizes.output_size)))
    turns = own_turn_rows(fold, network) if own_turns else default_rows(fold, kind)
    data = learning_data(fold, network, join_batches([clip_rows(fold, network), turns]))
    learned = minimise(residual_loss, start, data, Learning(), key)
    return learned.merged(data.shared), no_style(network) if learned.hidden is None else learned.hidden


METHODS = {
    "CP on the last layer": Method(partial(learn_residuals, ranks=(0, 30))),
    "own turns, CP on the last layer": Method(partial(learn_residuals, ranks=(0, 30), own_turns=True)),
    "CP and bias of the outputs": Method(partial(learn_residuals, ranks=(30, 0))),
    "CP on two layers": Method(partial(learn_residuals, ranks=(10, 25))),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "output_layer", METHODS, (PAPER, BASE, OWN_TURNS))
