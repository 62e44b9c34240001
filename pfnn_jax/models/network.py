"""The forward pass: three blended layers with ELU between, and one style (Mason 2018 Eq. 4, Mason 2022 Eq. 3 and 4)."""

from __future__ import annotations

from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias

import jax
from flax import struct

from pfnn_jax.models.config import NetworkConfig
from pfnn_jax.models.dropout import Dropout, drop, need_key
from pfnn_jax.models.gating import Gating, gate, init_gating
from pfnn_jax.models.layers.cp import CPLayer
from pfnn_jax.models.layers.dense import DenseLayer
from pfnn_jax.models.layers.film import layer_norm
from pfnn_jax.models.layers.full import BlendedLayer
from pfnn_jax.models.spline import catmull_rom_basis
from pfnn_jax.models.style import Drop, Norm, Style

NetworkLayer: TypeAlias = BlendedLayer | CPLayer | DenseLayer

_NO_STYLE = Style()

# `forward` splits a key into the masks of the inputs of the three layers and the style's mask; `coefficients` folds in
# another number, so that both may be given the same key.
_NUM_MASKS = 4


@struct.dataclass
class Network:
    """Style-agnostic parameters: three layers, and the gating network where the coefficients come from one."""

    layers: tuple[NetworkLayer, NetworkLayer, NetworkLayer]
    gating: Gating | None = None

    @property
    def num_control_points(self) -> int:
        return self.layers[0].num_control_points

    def at(self, coefficients: jax.Array) -> Network:
        """Returns the network at coefficients [K], as a network of one control point without a gating network."""
        first, second, third = self.layers
        return Network(layers=(first.at(coefficients), second.at(coefficients), third.at(coefficients)))


def init_network(config: NetworkConfig, *, key: jax.Array) -> Network:
    """Returns freshly initialised layers [I, H], [H, H] and [H, O], and a gating network where one is configured."""
    sizes = (config.input_size, config.hidden, config.hidden, config.output_size)
    points = config.num_control_points
    pairs = zip(jax.random.split(key, 3), pairwise(sizes), strict=True)
    if config.rank is None:
        layers = [BlendedLayer.init(i, o, points, key=k) for k, (i, o) in pairs]
    else:
        layers = [CPLayer.init(i, o, points, rank=config.rank, key=k) for k, (i, o) in pairs]
    gating = None
    if config.phase_size:
        gating = init_gating(config.phase_size, config.gating_hidden, points, key=jax.random.fold_in(key, 3))
    return Network(layers=(layers[0], layers[1], layers[2]), gating=gating)


def config_of(network: Network) -> NetworkConfig:
    """Returns the sizes that a network was made with, read from its parameters."""
    first, _, last = network.layers
    gating = network.gating
    return NetworkConfig(
        input_size=first.input_size,
        output_size=last.output_size,
        hidden=first.output_size,
        num_control_points=first.num_control_points,
        rank=first.rank,
        **({} if gating is None else {"phase_size": gating.input_size, "gating_hidden": gating.hidden}),
    )


def coefficients(
    network: Network, gating_input: jax.Array, *, dropout: Dropout | None = None, key: jax.Array | None = None
) -> jax.Array:
    """Returns the blending coefficients [K] of one frame, from the phase spline or the gating network.

    Args:
        network: shared parameters.
        gating_input: for a spline, the phase [] in radians; for a gating network, its normalised input [G].
        dropout: drop probabilities in training (`main` acts on the gating network), or None at run time.
        key: random key, needed with `dropout`. It may be the key given to `forward`, which draws other masks from it.

    Raises:
        ValueError: if `dropout` is given without `key`.
    """
    need_key(dropout, key)
    if network.gating is None:
        return catmull_rom_basis(gating_input, network.num_control_points)
    if dropout is None or key is None:
        return gate(network.gating, gating_input)
    return gate(network.gating, gating_input, dropout=dropout.main, key=jax.random.fold_in(key, _NUM_MASKS))


def forward(
    network: Network,
    style: Style | None,
    coefficients: jax.Array,
    x: jax.Array,
    *,
    dropout: Dropout | None = None,
    key: jax.Array | None = None,
    norm: Norm = layer_norm,
) -> jax.Array:
    """Evaluates the network for one frame (Mason 2018 Eq. 4; with FiLM, Mason 2022 Eq. 3 and 4).

    Args:
        network: shared parameters.
        style: parameters of a style, which acts through its hooks (see `Style`), or None for none. A network
            trained with FiLM always needs one: it carries the layer norm.
        coefficients: [K] blending coefficients.
        x: [I] normalised input.
        dropout: drop probabilities in training, or None at run time.
        key: random key, needed with `dropout`. A residual or one-hot style has its own mask.
        norm: [H] -> [H], used with FiLM only: `layer_norm` or `layer_norm_sample`.

    Returns:
        [O] normalised output.

    Raises:
        ValueError: if `dropout` is given without `key`.
    """
    need_key(dropout, key)
    style = _NO_STYLE if style is None else style
    drop_first, drop_second, drop_third, drop_style = _masks(dropout, key)
    first, second, third = network.layers

    f = style.after_first(first(coefficients, drop_first(x)), coefficients, x, drop_style)
    hidden = jax.nn.elu(style.modulate(0, f, norm))
    f = style.after_second(second(coefficients, drop_second(hidden)), coefficients, hidden, drop_style)
    hidden = jax.nn.elu(style.modulate(1, f, norm))
    y = third(coefficients, drop_third(hidden))
    return style.after_third(y, coefficients, hidden, drop_style)


def _masks(dropout: Dropout | None, key: jax.Array | None) -> list[Drop]:
    """Returns the dropout of the three layers' inputs and of the style; the identity where there is none."""
    if dropout is None or key is None:
        return [lambda value: value] * _NUM_MASKS
    rates = (dropout.main, dropout.main, dropout.main, dropout.adapter)
    return [partial(drop, k, rate) for k, rate in zip(jax.random.split(key, _NUM_MASKS), rates, strict=True)]


def num_parameters(tree: Any) -> int:
    """Returns the number of scalars in a tree of parameters."""
    return sum(leaf.size for leaf in jax.tree.leaves(tree))
