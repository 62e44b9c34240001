"""What training minimises: squared error and a small L1 penalty on the weights (Mason 2018 Eq. 3)."""

from __future__ import annotations

from typing import Literal

import chex
import jax
import jax.numpy as jnp
import numpy as np

PenaltyNorm = Literal["mean", "sum"]


def squared_error(prediction: jax.Array, target: jax.Array | np.ndarray) -> jax.Array:
    """Mean over all axes of the squared difference of two arrays of one shape; [] in normalised units squared."""
    chex.assert_equal_shape([prediction, target])
    return jnp.mean(jnp.square(prediction - target))


def l1_penalty(parameters, norm: PenaltyNorm = "mean") -> jax.Array:
    """L1 size of a tree of parameters, to be scaled by λ (Mason 2018 Eq. 3).

    Args:
        parameters: any tree of arrays.
        norm: `mean` averages |W| over each array and then over the arrays, as the authors' code does; `sum` is
            ‖β‖₁ as the paper writes it, which at λ = 0.01 outweighs the error a thousandfold.

    Returns:
        [] penalty.
    """
    leaves = jax.tree.leaves(parameters)
    if norm == "sum":
        return sum((jnp.sum(_absolute(leaf)) for leaf in leaves), start=jnp.zeros(()))
    return sum((jnp.mean(_absolute(leaf)) for leaf in leaves), start=jnp.zeros(())) / len(leaves)


def _absolute(values: jax.Array) -> jax.Array:
    # The gradient of `jnp.abs` at 0 is 1, which would push biases that start at zero.
    return values * jnp.sign(values)
