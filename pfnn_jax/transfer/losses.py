"""Losses of a result: what it must keep of its content and take from its style (Holden et al. 2017, Eq. 4 to 9).

Hidden units are those of the motion autoencoder; rows are in layout units. Losses are means, as in the authors' code of
2016, so that weights mean the same for clips of any length. Those of constraints are in centimetres, metres per second
and radians per second, so that they mean the same in every layout.

A `mask` weighs frames: clips of many lengths are padded to few, and padded frames must not count.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from pfnn_jax.models.convolution import POOLING
from pfnn_jax.motion.body_points import POINT_NAMES, POINT_PARENTS
from pfnn_jax.motion.ground import turn
from pfnn_jax.motion.trajectory import Root
from pfnn_jax.transfer.clip_rows import FEET, decode_rows, ground_contacts
from pfnn_jax.transfer.layout import LAYOUT_FPS, WINDOW_FRAMES, ClipLayout

Array = jax.Array | np.ndarray

# Unsigned, as the columns of layouts are, because of how JAX caches the width of signed constants.
ENDS = np.arange(1, len(POINT_NAMES), dtype=np.uint32)
STARTS = np.array(POINT_PARENTS[1:], np.uint32)
"""Points at the end and at the start of each of the 20 bones."""

CENTIMETRES = 100.0


@struct.dataclass
class Constraints:
    """What the content demands of every frame of the result.

    Attributes:
        contacts: [T, 4] 1 where a left heel, left toe, right heel or right toe is on the ground.
        bone_lengths: [20] metres.
        velocity: [T, 2] of the root, metres per second, to the left and forward.
        yaw_rate: [T] of the root, radians per second, to the right.
    """

    contacts: Array
    bone_lengths: Array
    velocity: Array
    yaw_rate: Array


def content_constraints(rows: np.ndarray, layout: ClipLayout, speed_ratio: float = 1.0) -> Constraints:
    """Returns what the rows of a content demand.

    Args:
        rows: [T, D] in layout units.
        layout: of the rows.
        speed_ratio: by which the content's velocity is scaled (Holden et al. 2016: the style's speed over the
            content's).
    """
    start = Root(np.zeros((1, 2)), np.array([[0.0, 1.0]]))
    positions, _ = decode_rows(np.asarray(rows, float), layout, start)
    positions[..., 1] -= positions[:, FEET, 1].min()
    lengths = np.linalg.norm(positions[:, ENDS] - positions[:, STARTS], axis=-1)
    velocity, yaw_rate = root_rates(np.asarray(rows, float), layout)
    made = Constraints(ground_contacts(positions), np.median(lengths, axis=0), speed_ratio * velocity, yaw_rate)
    return jax.tree.map(lambda values: np.asarray(values, np.float32), made)


def gram(hidden: Array, mask: Array | None = None) -> jax.Array:
    """Returns the Gram matrix [F, F] of hidden units [T, F] (Eq. 6).

    The sum over frames is scaled to the 120 frames of a window, so that clips of any lengths can be compared and the
    paper's weight of the style loss keeps its meaning.
    """
    weight = jnp.ones(len(hidden), hidden.dtype) if mask is None else mask
    share = weight * (WINDOW_FRAMES // POOLING / jnp.sum(weight))
    return jnp.asarray(hidden * share[:, None]).T @ hidden


def content_loss(hidden: Array, content: Array, mask: Array | None = None) -> jax.Array:
    """Returns the mean squared difference of hidden units [T, F] from the content's (Eq. 4)."""
    return _mean(jnp.mean(jnp.square(hidden - content), axis=-1), mask)


def style_loss(hidden: Array, target: Array, mask: Array | None = None) -> jax.Array:
    """Returns the mean squared difference of the Gram matrix of hidden units [T, F] from `target` [F, F] (Eq. 5)."""
    return jnp.mean(jnp.square(gram(hidden, mask) - target))


def foot_loss(rows: Array, constraints: Constraints, layout: ClipLayout, mask: Array | None = None) -> jax.Array:
    """Returns the mean squared velocity in the world of feet on the ground, in (m/s)² (Eq. 7).

    The velocity adds the root's, its turn and the foot's own. The turn is a rotation and not the paper's cross product,
    its linear part, so that a foot that stands still in the world has no loss at any rate.

    Args:
        rows: [T, D] in layout units.
        constraints: a foot counts from a frame to the next if it is on the ground in both.
        layout: of the rows.
        mask: [T] weights of frames.
    """
    feet = row_points(rows, layout)[:, np.array(FEET)]
    velocity, yaw_rate = root_rates(rows, layout)
    step = jnp.stack([velocity[:-1, 0], jnp.zeros_like(velocity[:-1, 0]), velocity[:-1, 1]], axis=-1)
    own = (feet[1:] - turn(feet[:-1], yaw_rate[:-1] / LAYOUT_FPS)) * LAYOUT_FPS
    squared = jnp.sum(jnp.square(own + step[:, None]), axis=-1)
    standing = constraints.contacts[1:] * constraints.contacts[:-1]
    return _mean(jnp.sum(standing * squared, axis=-1), None if mask is None else mask[1:] * mask[:-1])


def bone_loss(rows: Array, constraints: Constraints, layout: ClipLayout, mask: Array | None = None) -> jax.Array:
    """Returns the mean squared error of the bones' lengths in cm² (Eq. 8); arguments as of `foot_loss`."""
    at = row_points(rows, layout)
    squared = jnp.sum(jnp.square(at[:, ENDS] - at[:, STARTS]), axis=-1)
    # A bone without length has a gradient of zero, not of infinity.
    lengths = jnp.where(squared > 0, jnp.sqrt(jnp.where(squared > 0, squared, 1.0)), 0.0)
    error = CENTIMETRES * (lengths - constraints.bone_lengths[None])
    return _mean(jnp.mean(jnp.square(error), axis=-1), mask)


def trajectory_loss(rows: Array, constraints: Constraints, layout: ClipLayout, mask: Array | None = None) -> jax.Array:
    """Returns the mean squared error of the root's velocity in (m/s)² and of its turning in (rad/s)² (Eq. 9).

    Arguments are those of `foot_loss`.
    """
    velocity, yaw_rate = root_rates(rows, layout)
    error = jnp.sum(jnp.square(velocity - constraints.velocity), axis=-1)
    return _mean(error + jnp.square(yaw_rate - constraints.yaw_rate), mask)


def row_points(rows: Array, layout: ClipLayout) -> Array:
    """Returns the points [T, 21, 3] of rows [T, D] in layout units, relative to the root, in metres."""
    return layout.length_unit * rows[:, layout.joint_position].reshape(len(rows), -1, 3)[:, -len(POINT_NAMES) :]


def root_rates(rows: Array, layout: ClipLayout) -> tuple[Array, Array]:
    """Returns the root's velocity [T, 2] in m/s and its yaw rate [T] in rad/s, of rows [T, D] in layout units."""
    velocity = (LAYOUT_FPS * layout.length_unit) * rows[:, layout.root_velocity]
    return velocity, LAYOUT_FPS * rows[:, layout.root_yaw_rate.start]


def _mean(values: jax.Array, mask: Array | None) -> jax.Array:
    """Returns the mean [] of values [T], weighted by a mask."""
    return jnp.mean(values) if mask is None else jnp.sum(values * mask) / jnp.sum(mask)
