"""Training by several processes, each with the devices of its host: JAX's own distributed runtime.

Every process runs the same program. Process 0 writes the run, and what it reads of it is sent to the others, so that
only its own host needs the run's folder. A process that dies ends the others: a sum over devices fails at once, and the
runtime ends the whole process when the coordinator is gone, or after `HEARTBEAT` without a sign of life of another.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import jax
import numpy as np
from jax.experimental import multihost_utils

from pfnn_jax.errors import InputError, LostProcessError

Tree = TypeVar("Tree")

HEARTBEAT = 60
"""Seconds without a sign of life after which a process counts as dead; threads that do not compute give them."""

SHUTDOWN = 30
"""Seconds for which a process that ends waits for the others to end too."""

LOST = ("gloo", "nccl", "rccl", "unavailable:", "coordination service", "connection")
"""What the error of a sum over devices says, in small letters, where another process is the reason."""


def initialise(coordinator: str | None = None, process_id: int | None = None, processes: int | None = None) -> None:
    """Connects this process with the others; to be called before any device is used.

    Args:
        coordinator: HOST:PORT of process 0; None where SLURM, GKE, Cloud TPU or Open MPI announce it and the rest.
        process_id: number of this process, from 0.
        processes: number of all.

    Raises:
        InputError: if nothing announces the processes, or process 0 cannot open the port. The runtime itself ends a
            process that does not find process 0 within five minutes.
    """
    loopback = coordinator is not None and coordinator.rsplit(":", 1)[0] in ("localhost", "127.0.0.1", "[::1]")
    try:
        jax.distributed.initialize(
            coordinator,
            processes,
            process_id,
            coordinator_bind_address=coordinator if loopback else None,  # by default all interfaces
            heartbeat_timeout_seconds=HEARTBEAT,
            shutdown_timeout_seconds=SHUTDOWN,
        )
    except (ValueError, RuntimeError) as error:
        first = str(error).splitlines()[0]
        rule = "must be HOST:PORT of process 0, with a free port, or auto under SLURM, GKE, Cloud TPU or Open MPI"
        raise InputError("command line", "coordinator", f"{coordinator or 'auto'}: {first}", rule) from error
    wait_for_all("start")  # connects the devices of all: later, processes might come to a first sum minutes apart


def is_first() -> bool:
    """Returns whether this process writes: the only one, or process 0 of several."""
    return jax.process_index() == 0


def wait_for_all(moment: str) -> None:
    """Waits until all processes are at the same moment; a process that dies ends the waiting.

    Raises:
        LostProcessError: if another process has ended.
    """
    with reporting_lost_process():
        multihost_utils.sync_global_devices(moment)


def broadcast(tree: Tree) -> Tree:
    """Returns the first process's arrays in every process, in host memory; the others need only have the shapes.

    Raises:
        LostProcessError: if another process has ended.
    """

    def sent(leaf: Any) -> np.ndarray:
        return np.asarray(leaf) if is_first() else np.zeros(leaf.shape, leaf.dtype)

    with reporting_lost_process():
        return multihost_utils.broadcast_one_to_all(jax.tree.map(sent, tree))


def check_same(what: str, *values: Any) -> None:
    """Refuses settings or data that differ between processes: their sums would be of different things.

    Args:
        what: is compared, for the message.
        values: arrays, or anything whose `repr` says all of it.

    Raises:
        InputError: in each process whose values are not those of process 0.
    """
    if jax.process_count() == 1:
        return
    digest = hashlib.sha256()
    for value in values:
        digest.update(np.ascontiguousarray(value).data if isinstance(value, np.ndarray) else repr(value).encode())
    mine = np.frombuffer(digest.digest(), np.uint8)
    if not np.array_equal(broadcast(mine), mine):
        number = f"differ in process {jax.process_index()}"
        raise InputError("training", what, number, "must be the same as in process 0")


@contextmanager
def reporting_lost_process() -> Iterator[None]:
    """Turns the error of a sum over devices that another process has left into one line.

    Raises:
        LostProcessError: instead of it.
    """
    try:
        yield
    except InputError:  # a ValueError too, and what it says is already known
        raise
    except (jax.errors.JaxRuntimeError, ValueError) as error:
        text = str(error)
        if jax.process_count() == 1 or not any(word in text.lower() for word in LOST):
            raise
        raise LostProcessError(text.splitlines()[0]) from error
