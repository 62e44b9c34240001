"""Training data too large for the device: minibatches read ahead from disk while the device works."""

from __future__ import annotations

from collections.abc import Iterator

from pfnn_jax.training.batches import Batch, Rows, gather_from
from pfnn_jax.training.order import StepOrder

AHEAD = 2
"""Dispatches that are prepared while the device works on one."""


def stream_batches(data: Rows, order: StepOrder, dispatches: list[tuple[int, int]]) -> Iterator[Batch]:
    """The minibatches of dispatches (first step, number of steps), leaves [n, B, ...], read ahead in threads.

    The same numbers as the path that keeps the data on the device: a minibatch is a function of its step alone.
    """
    import grain  # two seconds of imports, which only data of this size should cost

    def batches(dispatch: tuple[int, int]) -> Batch:
        return gather_from(data, order.draw(*dispatch))

    options = grain.ReadOptions(num_threads=AHEAD, prefetch_buffer_size=AHEAD)
    return iter(grain.MapDataset.source(dispatches).map(batches).to_iter_dataset(options))
