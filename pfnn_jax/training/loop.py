"""The training loop: many compiled steps at a time, with a donated state, a finite check and progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple, TypeVar

import jax
import numpy as np
from flax import struct
from jax.sharding import Mesh

from pfnn_jax.errors import TrainingError
from pfnn_jax.training.data import Batch, Rows, make_gather
from pfnn_jax.training.hosts import reporting_lost_process
from pfnn_jax.training.order import StepOrder
from pfnn_jax.training.sharding import (
    first_copy,
    join_shares,
    place_state,
    process_share,
    replicate,
    shard_step,
    split_steps,
)

State = TypeVar("State")

AHEAD = 2
"""Chunks of minibatches that are read ahead while the device works on one."""


@struct.dataclass
class TrainState:
    """Everything that training changes.

    Attributes:
        params: the parameters that are trained.
        opt_state: of the optimiser, for `params`.
        step: [] int32 number of steps taken.
    """

    params: Any
    opt_state: Any
    step: jax.Array


class Progress(NamedTuple):
    """The progress of training after a chunk of steps."""

    step: int  # steps taken
    steps: int  # steps in all
    loss: float  # mean squared error over the chunk's steps
    frames_per_second: float


def no_progress(*report: Any) -> None:
    """Ignores progress: the default of every `progress_callback`."""


def chunks(begin: int, end: int, size: int) -> list[tuple[int, int]]:
    """Returns (first step, number of steps) of consecutive chunks from `begin` on that end at multiples of `size`."""
    edges = [begin, *range((begin // size + 1) * size, end, size), end]
    return [(a, b - a) for a, b in zip(edges[:-1], edges[1:], strict=True) if b > a]


def train_steps(
    state: State,
    scan: Callable[[State, int, int], tuple[State, Any]],
    plan: Sequence[tuple[int, int]],
    callback: Callable[[State, int, Any], Any],
) -> State:
    """Trains chunk by chunk: the loop of pretraining, of generator tuning and of few-shot learning.

    Args:
        state: donated; read the returned one.
        scan: (state, first step, number of steps) -> (state, losses), compiled.
        plan: the chunks, as `chunks` returns them.
        callback: called after each chunk with the state, the steps taken and the chunk's losses.
    """
    for first, count in plan:
        state, losses = scan(state, first, count)
        jax.block_until_ready((state, losses))
        callback(state, first + count, losses)
    return state


def scan_steps(step: Callable, read: Callable[[Any, Any], Batch], *, rolled: bool = True) -> Callable:
    """Compiles (state, draws of n steps, data, frozen) -> (state, losses [n]).

    The state is donated: its buffers are reused, and the argument must not be read afterwards.

    Args:
        step: (state, batch, frozen) -> (state, loss); `frozen` is any tree that training does not change.
        read: (data, draw of one step) -> batch.
        rolled: one compiled `lax.scan` of n steps; otherwise n calls of one compiled step, which is what convolutions
            need: their gradients are several times slower inside a compiled loop on CPUs.
    """

    def one(state: Any, draw: Any, data: Any, frozen: Any):
        return step(state, read(data, draw), frozen)

    if rolled:

        @partial(jax.jit, donate_argnums=0)
        def scan(state: Any, draws: Any, data: Any, frozen: Any):
            return jax.lax.scan(lambda state, draw: one(state, draw, data, frozen), state, draws)

        return scan

    single = jax.jit(one, donate_argnums=0)

    def one_by_one(state: Any, draws: Any, data: Any, frozen: Any):
        losses = []
        for number in range(len(jax.tree.leaves(draws)[0])):
            state, loss = single(state, jax.tree.map(lambda leaf, i=number: leaf[i], draws), data, frozen)
            losses.append(loss)
        return state, np.array(losses)

    return one_by_one


@dataclass(frozen=True, eq=False)
class RowTraining:
    """Training on minibatches of rows, from a state at any step to the last.

    Attributes:
        step: (state, batch, frozen) -> (state, squared error); a function of its arguments alone, so that a resumed
            training repeats itself bit for bit.
        rows: what is trained on; kept on the device where it fits `device_bytes`, else read chunk by chunk.
        order: of the minibatches.
        steps: in all.
        steps_per_dispatch: steps of one chunk.
        device_bytes: largest rows that are kept on the device.
        mesh: of the devices that minibatches are split over; None for one device. Where they are of several processes,
            all of them must call `run`, with the same training.
    """

    step: Callable[[Any, Batch, Any], tuple[Any, jax.Array]]
    rows: Rows
    order: StepOrder
    steps: int
    steps_per_dispatch: int
    device_bytes: int = 2**32
    mesh: Mesh | None = None

    def run(
        self,
        state: TrainState,
        frozen: Any,
        callback: Callable[[TrainState, Progress], Any],
    ) -> tuple[TrainState, np.ndarray]:
        """Trains from the state's step to the end; returns the last state and the losses [n] of the steps taken.

        Args:
            state: donated; read the returned one. Of several processes the first one's counts.
            frozen: what the step reads and training does not change.
            callback: called after each chunk of steps, e.g. to save the state; what is spread over several processes
                can be read after `collect`.

        Raises:
            TrainingError: when a loss is not finite, before `callback` sees that state.
            LostProcessError: if another process has ended.
        """
        with reporting_lost_process():
            return self._run(state, frozen, callback)

    def _run(
        self, state: TrainState, frozen: Any, callback: Callable[[TrainState, Progress], Any]
    ) -> tuple[TrainState, np.ndarray]:
        if self.mesh is not None:
            state, frozen = place_state(state, self.mesh), replicate(frozen, self.mesh)
        plan = chunks(int(state.step), self.steps, self.steps_per_dispatch)
        started, found = time.perf_counter(), [np.empty(0, np.float32)]

        def report(state: TrainState, step: int, losses: Any) -> None:
            nonlocal started
            losses = np.asarray(losses)
            check_finite(losses, step - losses.size, self.rows.styles)
            found.append(losses)
            rate = losses.size * self.order.batch_size / (time.perf_counter() - started)
            copy = state if self.mesh is None else first_copy(state)
            callback(copy, Progress(step, self.steps, float(losses.mean()), rate))
            started = time.perf_counter()  # the time of saving does not count

        state = train_steps(state, self._scan(plan, frozen), plan, report)
        return state if self.mesh is None else first_copy(state), np.concatenate(found)

    def _scan(self, plan: Sequence[tuple[int, int]], frozen: Any) -> Callable:
        """Returns (state, first step, number of steps) -> (state, losses), to be called for the chunks of the plan."""
        rolled, mesh = not self.order.num_clips, self.mesh  # clips go through convolutions
        step = self.step if mesh is None else shard_step(self.step, mesh)
        if self.rows.is_normalised and self.rows.nbytes <= self.device_bytes:
            scan = scan_steps(step, make_gather(self.rows.layout), rolled=rolled)
            data = self.rows.on_device() if mesh is None else replicate(self.rows.in_memory().parts[0], mesh)
            place = (lambda draw: draw) if mesh is None else partial(split_steps, mesh=mesh)
            return lambda state, first, count: scan(state, place(self.order.draw(first, count)), data, frozen)
        scan = scan_steps(step, lambda _, batch: batch, rolled=rolled)
        batches = stream_batches(self.rows, self.order, plan, mesh)
        return lambda state, first, count: scan(state, next(batches), None, frozen)


def stream_batches(
    rows: Rows, order: StepOrder, plan: Sequence[tuple[int, int]], mesh: Mesh | None = None
) -> Iterator[Batch]:
    """Reads the minibatches of each chunk, leaves [n, B, ...], ahead of their use in threads.

    They are the same numbers as with the rows on the device: a minibatch is a function of its step alone. Of several
    processes each reads what its devices need.
    """
    import grain  # takes two seconds to import, which only data of this size should cost

    def batches(chunk: tuple[int, int]) -> Batch:
        draw = order.draw(*chunk)
        return rows.gather(draw) if mesh is None else join_shares(rows.gather(process_share(draw, mesh)), draw, mesh)

    options = grain.ReadOptions(num_threads=AHEAD, prefetch_buffer_size=AHEAD)
    return iter(grain.MapDataset.source(list(plan)).map(batches).to_iter_dataset(options))


def check_finite(losses: np.ndarray, first_step: int, styles: Sequence[str]) -> None:
    """Refuses losses [n] that are not finite; step i belongs to style i mod S.

    Raises:
        TrainingError: naming the step and its style.
    """
    bad = np.flatnonzero(~np.isfinite(losses))
    if bad.size:
        step = first_step + int(bad[0])
        raise TrainingError(step, styles[step % len(styles)], float(losses[bad[0]]))
