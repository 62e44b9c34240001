"""The forward pass: three blended layers, ELU between, and one style (Mason 2018 Eq. 4, Mason 2022 Eq. 3 and 4)."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.adapters import OneHot, Style
from pfnn_jax.models.dropout import Dropout, drop, need_key
from pfnn_jax.models.film import FiLMStyle, Normalise, layer_norm, modulate
from pfnn_jax.models.gating import Gating, gate, init_gating
from pfnn_jax.models.layers import BlendedLayer, CPLayer, DenseLayer, Layer, MixedLayer, init_blended, init_cp, linear
from pfnn_jax.models.spline import catmull_rom_basis

# Masks that `forward` draws from a key: of the inputs of the three layers, and of the style.
_MASKS = 4


@struct.dataclass
class Network:
    """Style-agnostic parameters: three layers, and the gating network where the coefficients come from one."""

    layers: tuple[Layer, Layer, Layer]
    gating: Gating | None = None

    @property
    def num_control_points(self) -> int:
        first = self.layers[0]
        if isinstance(first, DenseLayer):
            raise TypeError("A network's layers must be blended, got a DenseLayer.")
        return first.num_control_points


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of a network.

    Attributes:
        input_size, output_size: of one frame.
        hidden: H, width of both hidden layers.
        num_control_points: K, control points of the phase spline or experts of the gating network.
        rank: None for full blended layers; a number makes every layer a CP decomposition of that rank
            (the aside of Mason 2018 §7.1).
        phase_size: 0 where the coefficients are a spline of a scalar phase; otherwise the inputs of a gating network.
        gating_hidden: width of both hidden layers of the gating network.
    """

    input_size: int
    output_size: int
    hidden: int = 512
    num_control_points: int = 4
    rank: int | None = None
    phase_size: int = 0
    gating_hidden: int = 32

    def __post_init__(self):
        for name in ("input_size", "output_size", "hidden", "rank", "gating_hidden"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"NetworkConfig.{name} must be at least 1, got {value}.")
        if self.phase_size < 0:
            raise ValueError(f"NetworkConfig.phase_size must be at least 0, got {self.phase_size}.")
        least = 4 if self.phase_size == 0 else 1
        if self.num_control_points < least:
            raise ValueError(
                f"NetworkConfig.num_control_points must be at least {least}, got {self.num_control_points}."
            )


def init_network(config: NetworkConfig, *, key: jax.Array) -> Network:
    """Fresh shared parameters: [I, H], [H, H], [H, O] layers with the authors' initialisation."""
    sizes = (config.input_size, config.hidden, config.hidden, config.output_size)
    points = config.num_control_points
    keys = jax.random.split(key, 3)
    pairs = zip(keys, sizes[:-1], sizes[1:], strict=True)
    if config.rank is None:
        layers = [init_blended(k, points, i, o) for k, i, o in pairs]
    else:
        layers = [init_cp(k, points, i, o, config.rank) for k, i, o in pairs]
    gating = None
    if config.phase_size:
        gating = init_gating(config.phase_size, config.gating_hidden, points, key=jax.random.fold_in(key, 3))
    return Network(layers=(layers[0], layers[1], layers[2]), gating=gating)


def config_of(network: Network) -> NetworkConfig:
    """The sizes a network was made with, read from its parameters."""
    gated = {}
    if network.gating is not None:
        inputs, width = network.gating.layers[0].weights.shape
        gated = {"phase_size": inputs, "gating_hidden": width}
    match network.layers[0], network.layers[2]:
        case BlendedLayer(weights=first), BlendedLayer(weights=last):
            points, inputs, hidden = first.shape
            return NetworkConfig(inputs, last.shape[2], hidden, points, **gated)
        case CPLayer(a=a, b=b, d=d), CPLayer(a=last):
            points, rank = d.shape
            return NetworkConfig(b.shape[0], last.shape[0], a.shape[0], points, rank, **gated)
    raise TypeError("`network` must have BlendedLayers or CPLayers, one kind throughout.")


def coefficients(
    network: Network, phase: jax.Array, *, dropout: Dropout | None = None, key: jax.Array | None = None
) -> jax.Array:
    """Blending coefficients [K] of one frame: the spline of a scalar phase, or the gating network.

    Args:
        network: shared parameters.
        phase: [] radians for a spline network; [G] normalised for a gating network.
        dropout: drop probabilities in training (`main` acts on the gating network), or None at run time.
        key: random key, needed with `dropout`. `forward` may be given the same one: its masks are others.

    Raises:
        ValueError: if `dropout` comes without `key`.
    """
    need_key(dropout, key)
    if network.gating is None:
        return catmull_rom_basis(phase, network.num_control_points)
    if dropout is None or key is None:
        return gate(network.gating, phase)
    return gate(network.gating, phase, dropout=dropout.main, key=jax.random.fold_in(key, _MASKS))


def forward(
    network: Network,
    style: Style | MixedLayer | None,
    coefficients: jax.Array,
    x: jax.Array,
    *,
    dropout: Dropout | None = None,
    key: jax.Array | None = None,
    normalise: Normalise = layer_norm,
) -> jax.Array:
    """One frame through the network (Mason 2018 Eq. 4; with a Film, Mason 2022 Eq. 3 and 4).

    Args:
        network: shared parameters.
        style: a residual on the second layer, a shift of the first, or a Film: both hidden layers are then
            normalised, scaled and shifted before their ELU. None for style-agnostic motion.
        coefficients: [K] blending coefficients.
        x: [I] normalised input.
        dropout: drop probabilities in training, or None at run time.
        key: random key, needed with `dropout`. A residual draws a mask of its own.
        normalise: [H] -> [H], used with a Film only: `layer_norm` or `layer_norm_sample`.

    Returns:
        [O] normalised output.

    Raises:
        ValueError: if `dropout` comes without `key`.
    """
    need_key(dropout, key)
    keys = None if key is None else jax.random.split(key, _MASKS)

    def dropped(index: int, value: jax.Array) -> jax.Array:
        if dropout is None or keys is None:
            return value
        return drop(keys[index], dropout.adapter if index == 3 else dropout.main, value)

    def activate(index: int, f: jax.Array) -> jax.Array:
        return jax.nn.elu(modulate(style, index, f, normalise) if isinstance(style, FiLMStyle) else f)

    first, second, third = network.layers
    f = linear(first, coefficients, dropped(0, x))
    if isinstance(style, OneHot):
        f = f + dropped(3, jnp.ones((), f.dtype)) * linear(style.shift, coefficients, x)
    hidden = activate(0, f)
    f = linear(second, coefficients, dropped(1, hidden))
    if style is not None and not isinstance(style, OneHot | FiLMStyle):
        f = f + linear(style, coefficients, dropped(3, hidden))
    return linear(third, coefficients, dropped(2, activate(1, f)))


def predict(
    network: Network, style: Style | None, x: jax.Array, phase: jax.Array, *, normalise: Normalise = layer_norm
) -> jax.Array:
    """`forward` at a phase: x [I] normalised -> [O] normalised.

    Args:
        network, style, x, normalise: as in `forward`.
        phase: [] radians, through the exact spline; or [G] normalised, for a gating network.
    """
    return forward(network, style, coefficients(network, phase), x, normalise=normalise)


def num_parameters(tree) -> int:
    """Number of scalars in a tree of parameters."""
    return sum(leaf.size for leaf in jax.tree.leaves(tree))
