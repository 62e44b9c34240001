"""What training minimises: squared error, a small L1 penalty (Mason 2018 Eq. 3), bone lengths (Mason 2022 Eq. 5b)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, get_args

import chex
import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.errors import check_not_negative, check_one_of
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Statistics
from pfnn_jax.training.config import PenaltyNorm

Array = jax.Array | np.ndarray

L1 = 0.01
"""λ of Mason 2018 Eq. 3, used with the layouts of 2017 and 2018."""

BONE_LENGTH = 1.0
"""Weight of the bone-length loss, used with the layouts of 2022 (§4.4 adds it without a weight)."""


def squared_error(prediction: jax.Array, target: Array) -> jax.Array:
    """Returns the mean over all axes of the squared difference of two arrays of one shape; [], normalised squared."""
    chex.assert_equal_shape([prediction, target])
    return jnp.mean(jnp.square(prediction - target))


def l1_penalty(params: Any, norm: PenaltyNorm = "mean") -> jax.Array:
    """Returns the L1 size [] of a tree of parameters, to be scaled by λ (Mason 2018 Eq. 3).

    Args:
        params: any tree of arrays.
        norm: `mean` averages |W| over each array and then over the arrays, as the authors' code does; `sum` is
            ‖β‖₁ as the paper writes it, which at λ = 0.01 outweighs the error a thousandfold.
    """
    leaves = jax.tree.leaves(params)
    if norm == "sum":
        return sum((jnp.sum(_absolute(leaf)) for leaf in leaves), start=jnp.zeros(()))
    return sum((jnp.mean(_absolute(leaf)) for leaf in leaves), start=jnp.zeros(())) / len(leaves)


@struct.dataclass
class Bones:
    """The B bones of a skeleton of J joints, and the statistics that bring normalised outputs back to metres.

    An argument of compiled functions like any other data: skeletons of one layout share one compilation.
    """

    joint: Array  # [B] int32 joint at the end of each bone
    parent: Array  # [B] int32 joint at its beginning
    mean: Array  # [Dy] of the outputs
    std: Array  # [Dy] of the outputs
    layout: FrameLayout = struct.field(pytree_node=False)  # names the columns that are joint positions

    def length_error(self, prediction: jax.Array, target: Array) -> jax.Array:
        """Returns how far the bones' lengths are off (Mason 2022 Eq. 5b), in metres.

        Mean over the batch of the sum over bones of |length predicted - length true|, divided by the number of joints
        J as the authors' code does.

        Args:
            prediction, target: [B, Dy] normalised outputs.
        """
        chex.assert_equal_shape([prediction, target])
        off = jnp.sum(_absolute(self._lengths(prediction) - self._lengths(jnp.asarray(target))), axis=1)
        return jnp.mean(off) * (self.layout.length_unit / self.layout.num_joints)

    def _lengths(self, y: jax.Array) -> jax.Array:
        columns = self.layout.output_slice("joint_position")
        mean, std = (jnp.asarray(values, y.dtype)[None, columns] for values in (self.mean, self.std))
        positions = (y[:, columns] * std + mean).reshape(y.shape[0], -1, 3)
        return _norm(positions[:, self.joint] - positions[:, self.parent])


def make_bones(layout: FrameLayout, parents: Sequence[int] | np.ndarray, outputs: Statistics) -> Bones:
    """Returns the bones of a skeleton.

    Args:
        layout: of the outputs.
        parents: [J] parent joints, -1 for the root.
        outputs: statistics [Dy] that the outputs were normalised with.
    """
    parents = np.asarray(parents, np.int32)
    joint = np.flatnonzero(parents >= 0).astype(np.int32)
    return Bones(joint=joint, parent=parents[joint], mean=outputs.mean, std=outputs.std, layout=layout)


@dataclass(frozen=True)
class Objective:
    """The loss of a minibatch: squared error + l1 · |parameters| + bone_length · error of bone lengths.

    Attributes:
        l1, l1_norm: weight and kind of the L1 penalty; 0 for none.
        bone_length: weight of the bone-length loss; 0 for none.
    """

    l1: float = 0.0
    l1_norm: PenaltyNorm = "mean"
    bone_length: float = 0.0

    def __post_init__(self):
        check_not_negative(self, "l1", "bone_length")
        check_one_of(self, "l1_norm", get_args(PenaltyNorm))

    @classmethod
    def for_layout(
        cls,
        layout: FrameLayout,
        l1: float | None = None,
        l1_norm: PenaltyNorm = "mean",
        bone_length: float | None = None,
    ) -> Objective:
        """Returns the loss for rows of a layout; weights that are None are those of the layout's paper."""
        of_2022 = layout.next_frame
        l1 = (0.0 if of_2022 else L1) if l1 is None else l1
        bone_length = (BONE_LENGTH if of_2022 else 0.0) if bone_length is None else bone_length
        return cls(l1, l1_norm, bone_length)

    def loss(
        self, prediction: jax.Array, target: Array, params: Sequence[Any], bones: Bones | None = None
    ) -> tuple[jax.Array, jax.Array]:
        """Returns (loss, squared error) of normalised outputs [B, Dy].

        Args:
            prediction, target: normalised outputs.
            params: the trees that are trained. FiLM parameters are not penalised: their identity is scale 1, not 0.
            bones: None leaves out the bone-length loss.
        """
        loss = error = squared_error(prediction, target)
        if self.l1:
            weights = [tree for tree in params if not isinstance(tree, FiLMStyle)]
            loss = loss + self.l1 * sum((l1_penalty(tree, self.l1_norm) for tree in weights), start=jnp.zeros(()))
        if self.bone_length and bones is not None:
            loss = loss + self.bone_length * bones.length_error(prediction, target)
        return loss, error


def _absolute(values: jax.Array) -> jax.Array:
    # The gradient of `jnp.abs` at 0 is 1, which would push biases that start at zero.
    return values * jnp.sign(values)


def _norm(vectors: jax.Array) -> jax.Array:
    """Returns lengths of vectors [..., 3], with gradient zero at length zero, where the square root's is infinite."""
    squared = jnp.sum(jnp.square(vectors), axis=-1)
    positive = squared > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, squared, 1.0)), 0.0)
