"""What a folder holds, and waiting for what another thread does."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

SECONDS = 60.0  # on a loaded machine


def contents(folder: Path) -> dict[str, bytes | None]:
    """Returns the bytes of every file of a folder, None for folders."""
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def until(what: Callable[[], bool]) -> bool:
    """Waits until a condition holds, and returns whether it did in time."""
    ends = time.monotonic() + SECONDS
    while not what() and time.monotonic() < ends:
        time.sleep(0.05)
    return what()
