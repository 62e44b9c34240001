"""Files while they come from a browser: viser gathers them in memory before anybody sees them."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any

from pfnn_jax.viewer.page.learning import MOST_BYTES

MOST_GATHERED = 4 * MOST_BYTES
"""Bytes that are gathered at most, of all files that a tab sends at a time. A file between `MOST_BYTES` and this is
refused when it has come, by what reads it."""


class _Passing(dict[int, bytes]):
    """Parts of a file of which only that they came is kept."""

    def __setitem__(self, index: int, content: bytes) -> None:
        super().__setitem__(index, b"")


def drop_large(transfers: MutableMapping[str, Any]) -> list[str]:
    """Forgets what has come, and what comes yet, of files that are too large to be gathered.

    They are let come to their end, for a page counts what it is told of a file's parts and takes no other file before;
    viser then drops them, for their length is wrong.

    Args:
        transfers: viser's files that are coming, in the order in which they began.

    Returns:
        What to tell of each file that has been dropped by this call.
    """
    told, gathered = [], 0
    for state in list(transfers.values()):
        if isinstance(state["parts"], _Passing):
            continue
        size = max(state["total_bytes"], state["transferred_bytes"])
        if gathered + size <= MOST_GATHERED:
            gathered += size
            continue
        with state["lock"]:
            state["parts"] = _Passing(dict.fromkeys(state["parts"], b""))
        rule = f"is far larger than {MOST_BYTES / 1e6:g} MB" if size > MOST_GATHERED else "comes with too many others"
        told.append(f"{state['filename'][:80]}: the file {rule}")
    return told
