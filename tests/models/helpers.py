"""What several tests of the networks share."""

from __future__ import annotations

import re
from typing import TypeVar

import jax
import numpy as np

from pfnn_jax.models.layers import Layer, init_bias, init_blended, init_cp, init_dense, init_diagonal

Tree = TypeVar("Tree")

KINDS = ("blended", "cp", "diagonal", "bias", "dense")


def randomise(tree: Tree, seed: int) -> Tree:
    """The same tree with every leaf normal: fresh layers have zero biases, which would hide a mistake."""
    leaves, structure = jax.tree.flatten(tree)
    keys = jax.random.split(jax.random.key(seed), len(leaves))
    return jax.tree.unflatten(structure, [jax.random.normal(k, v.shape) for k, v in zip(keys, leaves, strict=True)])


def random_layer(kind: str, num_control_points: int, inputs: int, outputs: int, rank: int, seed: int = 0) -> Layer:
    """A layer of one of `KINDS` whose parameters are all normal; `diagonal` and `bias` need inputs = outputs."""
    key = jax.random.key(seed)
    layer: Layer = {
        "blended": lambda: init_blended(key, num_control_points, inputs, outputs),
        "cp": lambda: init_cp(key, num_control_points, inputs, outputs, rank),
        "diagonal": lambda: init_diagonal(key, num_control_points, outputs),
        "bias": lambda: init_bias(num_control_points, outputs),
        "dense": lambda: init_dense(key, inputs, outputs),
    }[kind]()
    return randomise(layer, seed)


def shapes(tree: object) -> dict[str, tuple[tuple[int, ...], str]]:
    """{path: (shape, dtype)} of a tree of parameters: what a checkpoint holds, in one screen."""
    leaves = jax.tree_util.tree_leaves_with_path(tree)
    return {jax.tree_util.keystr(path): (leaf.shape, str(leaf.dtype)) for path, leaf in leaves}


def array_sizes(text: str) -> set[int]:
    """Numbers of elements of every array in StableHLO (`tensor<2x3xf32>`) or HLO (`f32[2,3]`) text."""
    found = re.findall(r"tensor<((?:\d+x)+)[a-z]", text) + re.findall(r"\b[a-z]+\d+\[([\d,]+)\]", text)
    return {int(np.prod([int(size) for size in re.findall(r"\d+", shape)])) for shape in found}
