"""The forward pass: three layers, ELU between, a style adapter beside the second (Mason 2018 Fig. 4, Eq. 4)."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from flax import struct

from pfnn_jax.models.layers import BlendedLayer, CPLayer, Layer, init_blended, init_cp, linear
from pfnn_jax.models.spline import catmull_rom_basis


@struct.dataclass
class Network:
    """Style-agnostic parameters: three layers."""

    layers: tuple[Layer, Layer, Layer]


@dataclass(frozen=True)
class NetworkConfig:
    """Sizes of a network.

    Attributes:
        input_size, output_size: of one frame.
        hidden: H, width of both hidden layers.
        num_control_points: K.
        rank: None for full blended layers; a number makes every layer a CP decomposition of that rank
            (the aside of Mason 2018 §7.1).
    """

    input_size: int
    output_size: int
    hidden: int = 512
    num_control_points: int = 4
    rank: int | None = None

    def __post_init__(self):
        for name in ("input_size", "output_size", "hidden", "rank"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"NetworkConfig.{name} must be at least 1, got {value}.")
        if self.num_control_points < 4:
            raise ValueError(f"NetworkConfig.num_control_points must be at least 4, got {self.num_control_points}.")


def init_network(config: NetworkConfig, key: jax.Array) -> Network:
    """Fresh shared parameters: [I, H], [H, H], [H, O] layers with the authors' initialisation."""
    sizes = (config.input_size, config.hidden, config.hidden, config.output_size)
    points = config.num_control_points
    keys = jax.random.split(key, 3)
    pairs = zip(keys, sizes[:-1], sizes[1:], strict=True)
    if config.rank is None:
        layers = [init_blended(k, points, i, o) for k, i, o in pairs]
    else:
        layers = [init_cp(k, points, i, o, config.rank) for k, i, o in pairs]
    return Network(layers=(layers[0], layers[1], layers[2]))


def config_of(network: Network) -> NetworkConfig:
    """The sizes a network was made with, read from its parameters."""
    match network.layers[0], network.layers[2]:
        case BlendedLayer(weights=first), BlendedLayer(weights=last):
            points, inputs, hidden = first.shape
            return NetworkConfig(inputs, last.shape[2], hidden, points)
        case CPLayer(a=a, b=b, d=d), CPLayer(a=last):
            points, rank = d.shape
            return NetworkConfig(b.shape[0], last.shape[0], a.shape[0], points, rank)
    raise TypeError("`network` must have BlendedLayers or CPLayers, one kind throughout.")


@struct.dataclass(kw_only=True)
class Dropout:
    """Drop probabilities: `main` before every shared layer, `adapter` before the adapter (Mason 2018 §7.2)."""

    main: jax.Array  # []
    adapter: jax.Array  # []


def drop(key: jax.Array, rate: jax.Array, x: jax.Array) -> jax.Array:
    """Inverted dropout of x [...] at drop probability `rate` [], rounded to 1/65536."""
    threshold = jnp.round(rate * 65536.0)
    kept = jax.random.bits(key, x.shape, jnp.uint16).astype(x.dtype) >= threshold
    # At rate 1 nothing is kept: a scale of 1/0 would reach the gradient as NaN, though `where` hides it in the value.
    scale = 65536.0 / jnp.maximum(65536.0 - threshold, 1.0)
    return jnp.where(kept, x * scale, 0.0)


def forward(
    network: Network,
    adapter: Layer | None,
    coefficients: jax.Array,
    x: jax.Array,
    *,
    dropout: Dropout | None = None,
    key: jax.Array | None = None,
) -> jax.Array:
    """One frame through the network (Mason 2018 Eq. 4).

    Args:
        network: shared parameters.
        adapter: one style's residual on the second layer, or None for style-agnostic motion.
        coefficients: [K] blending coefficients.
        x: [I] normalised input.
        dropout: drop probabilities in training, or None at run time.
        key: random key, needed with `dropout`. The adapter's branch draws a mask of its own.

    Returns:
        [O] normalised output.

    Raises:
        ValueError: if `dropout` comes without `key`.
    """
    if dropout is not None and key is None:
        raise ValueError("`key` is needed where `dropout` is given, got None.")
    keys = None if key is None else jax.random.split(key, 4)

    def dropped(index: int, value: jax.Array) -> jax.Array:
        if dropout is None or keys is None:
            return value
        return drop(keys[index], dropout.adapter if index == 3 else dropout.main, value)

    first, second, third = network.layers
    hidden = jax.nn.elu(linear(first, coefficients, dropped(0, x)))
    second_in = linear(second, coefficients, dropped(1, hidden))
    if adapter is not None:
        second_in = second_in + linear(adapter, coefficients, dropped(3, hidden))
    return linear(third, coefficients, dropped(2, jax.nn.elu(second_in)))


def predict(network: Network, adapter: Layer | None, x: jax.Array, phase: jax.Array) -> jax.Array:
    """`forward` at a phase [] radians through the exact spline: x [I] -> [O], both normalised."""
    coefficients = catmull_rom_basis(phase, network.layers[0].num_control_points)
    return forward(network, adapter, coefficients, x)


def num_parameters(tree) -> int:
    """Number of scalars in a tree of parameters."""
    return sum(leaf.size for leaf in jax.tree.leaves(tree))
