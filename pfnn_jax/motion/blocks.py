"""Named blocks of a vector: which columns bear which name, where blocks stand one after another or interleaved."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

Block = tuple[str, int]
"""Name and number of columns."""

Columns = slice | np.ndarray
"""Where a block stands: good for `y[:, columns]`, `y.at[columns].set` and `np.r_[columns]`."""


@dataclass(frozen=True)
class Interleaved:
    """Blocks that take turns: `parts` stand one after another, `count` times.

    The block of a part has `count * size` columns. Interleaved joints read as `y[:, columns].reshape(N, J, 3)`.

    Attributes:
        count: how often the parts are repeated.
        parts: (block, size of one turn) in order.
    """

    count: int
    parts: tuple[Block, ...]


Blocks = tuple[Block | Interleaved, ...]
"""All blocks of a vector, in order."""


@lru_cache(maxsize=256)
def column_names(blocks: Blocks) -> tuple[str, ...]:
    """[D] name of the block of every column."""
    return tuple(name for name, size in _turns(blocks) for _ in range(size))


@lru_cache(maxsize=256)
def block_columns(blocks: Blocks) -> dict[str, Columns]:
    """Columns of every block, by name in order of first appearance.

    Contiguous or regularly strided blocks are slices, others read-only arrays of indices.

    Raises:
        ValueError: if a name belongs to two blocks, or a size is not positive.
    """
    parts = [part for block in blocks for part in (block.parts if isinstance(block, Interleaved) else (block,))]
    names = [name for name, _ in parts]
    if len(set(names)) < len(names):
        raise ValueError(f"A block's name must be its own, got {names}.")
    counts = [block.count for block in blocks if isinstance(block, Interleaved)]
    if min([size for _, size in parts] + counts, default=1) < 1:
        raise ValueError(f"A block must have at least one column, got {blocks}.")
    owners = np.array(column_names(blocks))
    return {name: _columns(np.flatnonzero(owners == name)) for name in names}


def _turns(blocks: Blocks) -> Iterator[Block]:
    for block in blocks:
        yield from block.parts * block.count if isinstance(block, Interleaved) else (block,)


def _columns(index: np.ndarray) -> Columns:
    first, last = int(index[0]), int(index[-1])
    steps = set(np.diff(index).tolist())
    if steps <= {1}:
        return slice(first, last + 1)
    if len(steps) == 1:
        return slice(first, last + 1, steps.pop())
    # Unsigned, so that JAX need not wrap them around: it remembers the width of signed constants from one program to
    # the next, and refuses them where another precision is in force.
    index = index.astype(np.uint32)
    index.setflags(write=False)
    return index
