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

from pfnn_jax.training.data import Batch, Draw

Tree = TypeVar("Tree")

DATA = "data"
"""Name of the mesh's axis, along which minibatches are split."""


def data_mesh(batch_size: int, devices: Sequence[Any] | None = None) -> Mesh | None:
    """Returns the mesh on which minibatches are trained, or None for JAX's first device, where nothing is placed.

    Args:
        batch_size: B frames of a minibatch.
        devices: of JAX; by default as many of all as divide B.

    Raises:
        ValueError: if there is none, or the number of those given, or of all of several hosts, does not divide B.
    """
    if devices is None:
        devices = jax.devices()
        if jax.process_count() == 1:  # otherwise a host could be left without a device
            devices = devices[: num_devices(batch_size, len(devices))]
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
    """Returns a tree of arrays with a copy on every device; every process gives the same values."""
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec()))


def first_copy(tree: Tree) -> Tree:
    """Returns this process's first copy of a replicated tree, on one device; nothing is copied."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)


def split_draw(draw: Draw, mesh: Mesh) -> Draw:
    """Returns the draws of n steps, leaves [n, B, ...], with the numbers of each device's rows on that device."""

    def split(leaf: Any) -> jax.Array:
        return jax.make_array_from_callback(leaf.shape, _along(mesh, leaf.shape, 1), lambda index: leaf[index])

    return jax.tree.map(split, draw)


def local_draw(draw: Draw, mesh: Mesh) -> Draw:
    """Returns the part of the draws of n steps, leaves [n, B, ...], whose rows this process reads."""

    def part(leaf: Any) -> Any:
        owned = _along(mesh, leaf.shape, 1).addressable_devices_indices_map(leaf.shape).values()
        columns = [index[1].indices(leaf.shape[1]) for index in owned if index is not None]
        return leaf[:, min(first for first, _, _ in columns) : max(stop for _, stop, _ in columns)]

    return jax.tree.map(part, draw)


def join_local(local: Batch, draw: Draw, mesh: Mesh) -> Batch:
    """Returns the batches of n steps on the mesh, from the rows that each process has read for its `local_draw`.

    Args:
        local: leaves [n, B of this process, ...].
        draw: of all processes.
        mesh: of all devices.
    """

    def join(leaf: Any, drawn: Any) -> jax.Array:
        shape = (*drawn.shape[:2], *leaf.shape[2:])
        return jax.make_array_from_process_local_data(_along(mesh, shape, 1), np.asarray(leaf), shape)

    return Batch(
        x=join(local.x, draw.rows),
        y=join(local.y, draw.rows),
        phase=join(local.phase, draw.rows),
        clip=None if local.clip is None else join(local.clip, draw.windows),
    )


def _along(mesh: Mesh, shape: Sequence[int], axis: int) -> NamedSharding:
    """Returns how an array is placed: split along an axis that the devices divide, else whole on each of them.

    Frames are always split; clips of a FiLM generator can be fewer than devices.
    """
    split = shape[axis] % mesh.size == 0
    return NamedSharding(mesh, PartitionSpec(*[None] * axis, DATA) if split else PartitionSpec())
