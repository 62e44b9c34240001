"""Does a style need more than a residual on the second layer?

Question  an adapter changes what the last hidden layer computes; poses stay in the span of the last layer, which knows
          the other styles alone. Does a style come nearer to its actor with parameters of its own on the outputs?
Method    next to the CP adapter of rank 30, a bias of the outputs, blended by phase (K times Dy numbers: 1,120); and CP
          of rank 10 on the second layer with CP of rank 25 on the last one (30,972 numbers in all; the default has
          31,352). Learned from the clip and restyled rows in the same loop.
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
    style_loss,
)
from experiments.common.turning_folds import Fold, FoldConfig, Method, NetworkKind, run_methods
from experiments.common.turning_table import OWN_TURNS, PAPER
from experiments.common.varied_restyling import BASE, default_rows
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.network import Network, config_of
from pfnn_jax.models.style import Style
from pfnn_jax.training.losses import l1_penalty


@struct.dataclass
class TwoLayers:
    """A residual on the second layer, and one on the outputs."""

    hidden: CPLayer
    outputs: CPLayer  # of rank 0 where it is but a bias
    biases: jax.Array  # [K, Dy], blended

    def merged(self, network: Network) -> Network:
        """Returns the network with the residual of the outputs added to its last layer."""
        first, second, last = network.layers
        assert isinstance(last, BlendedLayer)  # the experiment's networks are not decomposed
        matrices = jnp.einsum("or,kr,ir->kio", self.outputs.a, self.outputs.d, self.outputs.b)
        changed = BlendedLayer(weights=last.weights + matrices, biases=last.biases + self.biases)
        return replace(network, layers=(first, second, changed))


def two_layer_loss(params: TwoLayers, data: LearningData, learning: Learning, key: jax.Array) -> jax.Array:
    """Returns the loss of residuals on two layers on a minibatch of rows."""
    error = style_loss(params.hidden, replace(data, shared=params.merged(data.shared)), learning, key)
    return error + learning.l1 * l1_penalty([leaf for leaf in jax.tree.leaves(params) if leaf.size])


def learn_two_layers(fold: Fold, kind: NetworkKind, ranks: tuple[int, int]) -> tuple[Network, Style]:
    """Returns the network with changed outputs, and the adapter of its second layer; ranks of hidden and outputs."""
    network, key = fold.network(kind), jax.random.key(fold.seed)
    sizes, (hidden_rank, output_rank) = config_of(network.shared), ranks
    hidden_key, output_key = jax.random.split(jax.random.fold_in(key, 1))
    points = sizes.num_control_points
    start = TwoLayers(
        CPLayer.init(sizes.hidden, sizes.hidden, points, rank=hidden_rank, key=hidden_key),
        CPLayer.init(sizes.hidden, sizes.output_size, points, rank=max(output_rank, 1), key=output_key),
        jnp.zeros((points, sizes.output_size)),
    )
    if not output_rank:
        empty = jax.tree.map(lambda leaf: leaf[..., :0] if leaf.ndim > 1 else leaf, start.outputs)
        start = replace(start, outputs=empty)
    rows = join_batches([clip_rows(fold, network), default_rows(fold, kind)])
    data = learning_data(fold, network, rows)
    learned = minimise(two_layer_loss, start, data, Learning(), key)
    return learned.merged(data.shared), learned.hidden


METHODS = {
    "CP and bias of the outputs": Method(partial(learn_two_layers, ranks=(30, 0))),
    "CP on two layers": Method(partial(learn_two_layers, ranks=(10, 25))),
}


if __name__ == "__main__":
    run_methods(tyro.cli(FoldConfig, description=__doc__), "output_layer", METHODS, (PAPER, BASE, OWN_TURNS))
