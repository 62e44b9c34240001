"""What training minimises: squared error, a small L1 penalty (Mason 2018 Eq. 3), bone lengths (Mason 2022 Eq. 5b)."""

from __future__ import annotations

from typing import Literal

import chex
import jax
import jax.numpy as jnp
import numpy as np

from pfnn_jax.motion.features.layout import FrameLayout

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


def bone_length_loss(
    prediction: jax.Array,
    target: jax.Array | np.ndarray,
    layout: FrameLayout,
    parents: np.ndarray,
    output_std: np.ndarray,
    output_mean: np.ndarray,
) -> jax.Array:
    """How far the bones' lengths are off (Mason 2022 Eq. 5b), in metres.

    Mean over the batch of the sum over bones of |length predicted - length true|, divided by the number of joints J
    as the authors' code does.

    Args:
        prediction, target: [B, Dy] normalised outputs.
        layout: says which columns are joint positions.
        parents: [J] parent joints, -1 for the root.
        output_std, output_mean: [Dy] statistics that the outputs were normalised with.
    """
    chex.assert_equal_shape([prediction, target])
    columns = layout.output_slice("joint_position")
    std, mean = (jnp.asarray(values, prediction.dtype)[None, columns] for values in (output_std, output_mean))
    bones = np.flatnonzero(np.asarray(parents) >= 0)

    def lengths(y) -> jax.Array:
        positions = (y[:, columns] * std + mean).reshape(y.shape[0], len(parents), 3)
        return _norm(positions[:, bones] - positions[:, np.asarray(parents)[bones]])

    off = jnp.sum(_absolute(lengths(prediction) - lengths(jnp.asarray(target))), axis=1)
    return jnp.mean(off) * (layout.length_unit / len(parents))


def _norm(vectors: jax.Array) -> jax.Array:
    """Lengths of vectors [..., 3], with gradient zero at length zero, where that of the square root is infinite."""
    squared = jnp.sum(jnp.square(vectors), axis=-1)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
