"""Data-parallel training: every device takes an equal share of each minibatch and holds all but the largest parameters.

The devices, of one process or of several, form a mesh of one axis, `data`. The training step stays the function of one
minibatch that it is on one device: what the step reads is placed on the mesh, and XLA derives which device computes
what, and where gradients are summed. Random numbers belong to frames and not to devices (`jax_threefry_partitionable`),
so that the number of devices changes the order of sums and nothing else.

Arrays of more than `SPREAD_BYTES`, those of a bank of many wide styles, are spread: each device holds a share of every
style's outputs, and updates it. Nothing of them travels then but the activations of one style, and all devices have
equal work. A share of the styles for each device would leave all devices but one idle in a step of one style, and XLA
gathers the whole bank on every device to read one style of it (docs/scale.md).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from pfnn_jax.errors import InputError
from pfnn_jax.training.data import Batch, Draw
from pfnn_jax.training.hosts import broadcast, is_first

Tree = TypeVar("Tree")

DATA = "data"
"""Name of the mesh's axis, along which minibatches are split."""

SPREAD_BYTES = 2**30
"""Bytes of the largest array of parameters, or of moments of the optimiser, that every device holds whole."""


def data_mesh(batch_size: int, devices: Sequence[Any] | None = None) -> Mesh | None:
    """Returns the mesh on which minibatches are trained, or None for JAX's first device, where nothing is placed.

    Args:
        batch_size: B frames of a minibatch.
        devices: of JAX, equally many of each process; by default as many of all as divide B.

    Raises:
        ValueError: if none are given, or their number does not divide B.
    """
    if devices is None:
        devices = default_devices(batch_size)
    if not len(devices) or batch_size % len(devices):
        raise ValueError(f"`batch_size` must be a multiple of the {len(devices)} devices, got {batch_size}.")
    if jax.process_count() == 1 and list(devices) == jax.devices()[:1]:
        return None
    return Mesh(np.asarray(devices), (DATA,), axis_types=(AxisType.Auto,))


def default_devices(batch_size: int) -> list[Any]:
    """Returns the devices of a training: equally many of each process, one process after another."""
    processes = jax.process_count()
    count = num_devices(batch_size, _available(), processes) // processes
    return [device for process in range(processes) for device in jax.local_devices(process_index=process)[:count]]


def num_devices(batch_size: int, available: int, processes: int = 1) -> int:
    """Returns the largest number of devices, of those available, that divides a batch size; each process has its share.

    Raises:
        InputError: if the number of processes does not divide it.
    """
    if batch_size % processes:
        rule = f"must be a multiple of the {processes} processes, each of which takes an equal share"
        raise InputError("training", "batch_size", batch_size, rule)
    return max(count for count in range(processes, available + 1, processes) if batch_size % count == 0)


def describe_devices(batch_size: int) -> str | None:
    """Returns which devices a training uses by default, for the user; None where there is but one.

    Raises:
        InputError: if the number of processes does not divide a minibatch.
    """
    processes, available = jax.process_count(), jax.device_count()
    used = num_devices(batch_size, _available(), processes)
    if available == 1:
        return None
    of_processes = f" of {processes} processes" if processes > 1 else ""
    if used == available:
        return f"training on {used} devices{of_processes}"
    rule = "their number must divide" if processes == 1 else "each must have as many as the others, to divide"
    return f"training on {used} of {available} devices{of_processes}: {rule} batch_size {batch_size}"


def shard_step(step: Callable, mesh: Mesh) -> Callable:
    """Returns the step (state, batch, frozen) -> (state, loss) with its batch split, and the state as `place_state`."""

    def sharded(state: Any, batch: Batch, frozen: Any):
        batch = jax.tree.map(lambda leaf: jax.lax.with_sharding_constraint(leaf, _along(mesh, leaf.shape, 0)), batch)
        result = step(state, batch, frozen)
        return jax.tree.map(lambda leaf: jax.lax.with_sharding_constraint(leaf, _of_state(mesh, leaf)), result)

    return sharded


def replicate(tree: Tree, mesh: Mesh) -> Tree:
    """Returns a tree of arrays, the same in every process, with a copy on every device."""
    return jax.tree.map(lambda leaf: _place(leaf, NamedSharding(mesh, PartitionSpec())), tree)


def place_state(state: Tree, mesh: Mesh) -> Tree:
    """Returns a state of training on all devices: small arrays whole on each, large ones spread.

    Of several processes the first one's state counts; those of the others need only have its shapes and types.
    """
    leaves, structure = jax.tree.flatten(state)
    shardings = [_of_state(mesh, leaf) for leaf in leaves]
    if jax.process_count() == 1:
        return jax.tree.unflatten(structure, jax.device_put(leaves, shardings))
    both = list(zip(leaves, shardings, strict=True))
    whole = iter(broadcast([leaf for leaf, sharding in both if sharding.is_fully_replicated]))
    _connect(mesh)
    placed = [
        _place(next(whole), sharding) if sharding.is_fully_replicated else _send_slices(leaf, sharding)
        for leaf, sharding in both
    ]
    return jax.tree.unflatten(structure, placed)


def is_spread(state: Any, mesh: Mesh | None) -> bool:
    """Returns whether a state, of which shapes suffice, has arrays that no device holds whole."""
    return mesh is not None and not all(_of_state(mesh, leaf).is_fully_replicated for leaf in jax.tree.leaves(state))


@contextmanager
def in_host_memory(needed: bool) -> Iterator[None]:
    """Makes and loads arrays in host memory during the block, where no device holds all of them."""
    with jax.default_device(jax.local_devices(backend="cpu")[0]) if needed else nullcontext():
        yield


def first_copy(tree: Tree) -> Tree:
    """Returns a state with the first copy of every replicated array, on one device; nothing is copied."""
    return jax.tree.map(lambda leaf: leaf.addressable_data(0) if leaf.is_fully_replicated else leaf, tree)


def collect(tree: Tree) -> Tree:
    """Returns a state as one process can read it: what is spread over several is collected by the first of them.

    Its arrays come into the host memory of that process style by style; the others keep what they have. All processes
    must call this.
    """

    def whole(leaf: Any) -> Any:
        return leaf if isinstance(leaf, np.ndarray) or leaf.is_fully_addressable else _receive_slices(leaf)

    return jax.tree.map(whole, tree)


def split_steps(tree: Tree, mesh: Mesh) -> Tree:
    """Returns the draws or batches of n steps, leaves [n, B, ...], with each device's rows on that device."""
    return jax.tree.map(lambda leaf: _place(leaf, _along(mesh, leaf.shape, 1)), tree)


def process_share(draw: Draw, mesh: Mesh) -> Draw:
    """Returns the rows and windows of n steps that the devices of this process need."""

    def share(leaf: np.ndarray) -> np.ndarray:
        parts: Any = _along(mesh, leaf.shape, 1).addressable_devices_indices_map(leaf.shape).values()
        edges = [part[1].indices(leaf.shape[1]) for part in parts]
        return leaf[:, min(begin for begin, _, _ in edges) : max(end for _, end, _ in edges)]

    return jax.tree.map(share, draw)


def join_shares(batch: Batch, draw: Draw, mesh: Mesh) -> Batch:
    """Returns the minibatches of n steps, of which every process has gathered its `process_share` of the draw."""

    def joined(leaf: Any, numbers: Any) -> jax.Array:
        shape = *numbers.shape[:2], *leaf.shape[2:]
        return jax.make_array_from_process_local_data(_along(mesh, shape, 1), leaf, shape)

    rows = Batch(*(joined(leaf, draw.rows) for leaf in (batch.x, batch.y, batch.phase)))
    return rows if batch.clip is None else replace(rows, clip=joined(batch.clip, draw.windows))


def _along(mesh: Mesh, shape: Sequence[int], axis: int) -> NamedSharding:
    """Returns how an array is placed: split along an axis that the devices divide, else whole on each of them.

    Frames are always split; clips of a FiLM generator can be fewer than devices.
    """
    split = shape[axis] % mesh.size == 0
    return NamedSharding(mesh, PartitionSpec(*[None] * axis, DATA) if split else PartitionSpec())


def _of_state(mesh: Mesh, leaf: Any) -> NamedSharding:
    """Returns how an array of a state is placed: spread along its last axis that the devices divide, where it is large.

    Never along the first, which is that of styles.
    """
    if leaf.size * leaf.dtype.itemsize > SPREAD_BYTES:
        axes = [axis for axis in range(1, leaf.ndim) if leaf.shape[axis] % mesh.size == 0]
        if axes:
            return NamedSharding(mesh, PartitionSpec(*[None] * axes[-1], DATA))
    return NamedSharding(mesh, PartitionSpec())


def _connect(mesh: Mesh) -> None:
    """Sums over the devices once, while all processes are here.

    On CPUs the processes must come to the first sum of a mesh within 30 seconds, and to later ones whenever they do:
    they may compile the training step at very different speed.
    """
    ones = _place(np.ones(mesh.size, np.float32), NamedSharding(mesh, PartitionSpec(DATA)))
    jax.jit(jnp.sum, out_shardings=NamedSharding(mesh, PartitionSpec()))(ones).block_until_ready()


def _place(leaf: Any, sharding: NamedSharding) -> jax.Array:
    """Returns an array that every process has whole, with each device's part on that device."""
    if sharding.is_fully_addressable:
        return jax.device_put(leaf, sharding)
    if jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key):
        data = _place(jax.random.key_data(leaf), sharding)
        return jax.random.wrap_key_data(data, impl=jax.random.key_impl(leaf))
    whole = np.asarray(leaf)
    return jax.make_array_from_callback(whole.shape, sharding, lambda index: whole[index])


def _send_slices(leaf: Any, sharding: NamedSharding) -> jax.Array:
    """Returns the first process's array [S, ...] spread over the devices of all, sent slice by slice."""
    places: Any = sharding.addressable_devices_indices_map(leaf.shape)
    shape = sharding.shard_shape(leaf.shape)
    parts = {device: np.empty(shape, leaf.dtype) for device in places}
    for number in range(leaf.shape[0]):
        whole: Any = broadcast(leaf[number] if is_first() else jax.ShapeDtypeStruct(leaf.shape[1:], leaf.dtype))
        for device, index in places.items():
            parts[device][number] = whole[index[1:]]
    arrays = [jax.device_put(part, device) for device, part in parts.items()]
    return jax.make_array_from_single_device_arrays(leaf.shape, sharding, arrays)


def _receive_slices(leaf: jax.Array) -> np.ndarray | jax.Array:
    """Returns an array [S, ...] in the first process, slice by slice; the others send, and keep their share."""
    sharding: Any = leaf.sharding
    take = jax.jit(lambda leaf, number: leaf[number], out_shardings=NamedSharding(sharding.mesh, PartitionSpec()))
    whole = np.empty(leaf.shape if is_first() else 0, leaf.dtype)
    for number in range(leaf.shape[0]):
        part = take(leaf, number)
        if is_first():
            whole[number] = np.asarray(part)
    return whole if is_first() else leaf


def _available() -> int:
    """Returns how many devices can be used: as many of each process as the one with the fewest has."""
    if jax.process_count() == 1:
        return jax.device_count()
    processes = range(jax.process_count())
    return len(processes) * min(len(jax.local_devices(process_index=process)) for process in processes)
