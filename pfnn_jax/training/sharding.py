"""Data-parallel training: every device holds all parameters and takes an equal share of each minibatch.

The devices form a mesh of one axis, `data`. The training step stays the function of one minibatch that it is on one
device: what the step reads is placed on the mesh, and XLA derives which device computes what, and where gradients are
summed. Random numbers belong to frames and not to devices (`jax_threefry_partitionable`), so that the number of devices
changes the order of sums and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from pfnn_jax.training.data import Batch

Tree = TypeVar("Tree")

DATA = "data"
"""Name of the mesh's axis, along which minibatches are split."""


def data_mesh(batch_size: int, devices: Sequence[Any] | None = None) -> Mesh | None:
    """Returns the mesh on which minibatches are trained, or None for JAX's first device, where nothing is placed.

    Args:
        batch_size: B frames of a minibatch.
        devices: of JAX; by default as many of all as divide B.

    Raises:
        ValueError: if none are given, or their number does not divide B.
    """
    if devices is None:
        devices = jax.devices()[: num_devices(batch_size, jax.device_count())]
    if not len(devices) or batch_size % len(devices):
        raise ValueError(f"`batch_size` must be a multiple of the {len(devices)} devices, got {batch_size}.")
    if list(devices) == jax.devices()[:1]:
        return None
    return Mesh(np.asarray(devices), (DATA,), axis_types=(AxisType.Auto,))


def num_devices(batch_size: int, available: int) -> int:
    """Returns the largest number of devices, of those available, that divides a batch size."""
    return max(count for count in range(1, available + 1) if batch_size % count == 0)


def describe_devices(batch_size: int) -> str | None:
    """Returns which devices a training uses by default, for the user; None where there is but one."""
    available = jax.device_count()
    used = num_devices(batch_size, available)
    if available == 1:
        return None
    if used == available:
        return f"training on {used} devices"
    return f"training on {used} of {available} devices: their number must divide batch_size {batch_size}"


def shard_step(step: Callable, mesh: Mesh) -> Callable:
    """Returns the step (state, batch, frozen) -> (state, loss) with its batch split, and the rest on every device."""

    def sharded(state: Any, batch: Batch, frozen: Any):
        batch = jax.tree.map(lambda leaf: jax.lax.with_sharding_constraint(leaf, _along(mesh, leaf.shape, 0)), batch)
        return jax.lax.with_sharding_constraint(step(state, batch, frozen), NamedSharding(mesh, PartitionSpec()))

    return sharded


def replicate(tree: Tree, mesh: Mesh) -> Tree:
    """Returns a tree of arrays with a copy on every device."""
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec()))


def first_copy(tree: Tree) -> Tree:
    """Returns the first copy of a replicated tree, on one device; nothing is copied."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)


def split_steps(tree: Tree, mesh: Mesh) -> Tree:
    """Returns the draws or batches of n steps, leaves [n, B, ...], with each device's rows on that device."""
    return jax.tree.map(lambda leaf: jax.device_put(leaf, _along(mesh, leaf.shape, 1)), tree)


def _along(mesh: Mesh, shape: Sequence[int], axis: int) -> NamedSharding:
    """Returns how an array is placed: split along an axis that the devices divide, else whole on each of them.

    Frames are always split; clips of a FiLM generator can be fewer than devices.
    """
    split = shape[axis] % mesh.size == 0
    return NamedSharding(mesh, PartitionSpec(*[None] * axis, DATA) if split else PartitionSpec())
