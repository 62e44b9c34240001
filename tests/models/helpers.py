"""Helpers shared by the tests of networks."""

from __future__ import annotations

import re
from functools import partial
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.models.config import AdapterConfig, NetworkConfig
from pfnn_jax.models.layers import style_class, style_kinds
from pfnn_jax.models.layers.film import layer_norm
from pfnn_jax.models.network import Network, coefficients, forward, init_network
from pfnn_jax.models.style import Layer, Norm, Style, init_bank, init_style

Tree = TypeVar("Tree")

STYLE_KINDS = style_kinds()
LAYER_KINDS = tuple(kind for kind in STYLE_KINDS if issubclass(style_class(kind), Layer))


def randomise(tree: Tree, seed: int, scale: float = 1.0) -> Tree:
    """Returns the tree with normal leaves; the zero biases of fresh layers could hide a mistake.

    The leaves of the tree need no more than shapes: `jax.eval_shape` makes them without compiling.
    """
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(
        structure, [normal(seed + 1000 * i, *leaf.shape, scale=scale) for i, leaf in enumerate(leaves)]
    )


def random_network(sizes: NetworkConfig, seed: int, scale: float = 1.0) -> Network:
    """Returns a network with normal parameters."""
    return randomise(jax.eval_shape(lambda: init_network(sizes, key=jax.random.key(0))), seed, scale)


def normal(seed: int, *shape: int, scale: float = 1.0) -> jax.Array:
    """Returns normal numbers, drawn by NumPy: JAX compiles a function for every shape."""
    drawn = scale * np.random.default_rng(seed).normal(size=shape)
    return jnp.asarray(drawn, jnp.zeros(()).dtype)


def random_layer(kind: str, num_control_points: int, inputs: int, outputs: int, rank: int, seed: int = 0) -> Layer:
    """Returns a layer with normal parameters; `diagonal` and `bias` need inputs = outputs."""
    init = partial(style_class(kind).init, inputs, outputs, num_control_points, rank=rank)
    layer = jax.eval_shape(lambda: init(key=jax.random.key(0)))
    assert isinstance(layer, Layer)
    return randomise(layer, seed)


def random_style(kind: str, sizes: NetworkConfig, rank: int, seed: int = 0) -> Style:
    """Returns a style of any kind with normal parameters."""
    return randomise(jax.eval_shape(lambda: init_style(AdapterConfig(kind, rank), sizes, key=jax.random.key(0))), seed)


def random_bank(kind: str, num_styles: int, sizes: NetworkConfig, rank: int, seed: int = 0) -> Style:
    """Returns S styles of any kind with normal parameters, leaves [S, ...]."""
    init = partial(init_bank, AdapterConfig(kind, rank), sizes, num_styles)
    return randomise(jax.eval_shape(lambda: init(key=jax.random.key(0))), seed)


def shapes(tree: object) -> dict[str, tuple[tuple[int, ...], str]]:
    """Returns {path: (shape, dtype)} of a tree of parameters, as a checkpoint stores it."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path): (leaf.shape, str(leaf.dtype)) for path, leaf in leaves}


def array_sizes(text: str) -> set[int]:
    """Returns the numbers of elements of all arrays in StableHLO (`tensor<2x3xf32>`) or HLO (`f32[2,3]`) text."""
    found = re.findall(r"tensor<((?:\d+x)+)[a-z]", text) + re.findall(r"\b[a-z]+\d+\[([\d,]+)\]", text)
    return {int(np.prod([int(size) for size in re.findall(r"\d+", shape)])) for shape in found}


def predict(
    network: Network, style: Style | None, x: jax.Array, gating_input: jax.Array, norm: Norm = layer_norm
) -> jax.Array:
    """Returns the output [O] of a network for the input x [I] and a phase or gating input, all normalised."""
    return forward(network, style, coefficients(network, gating_input), x, norm=norm)
