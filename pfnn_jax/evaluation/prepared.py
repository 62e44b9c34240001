"""A preparation measured from outside: in an interpreter of its own, so that its memory is its own."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.datasets.workers import default_workers, map_in_order

UNIT = 1 if sys.platform == "darwin" else 1024
"""Bytes of the system's unit of memory."""


class Prepared(NamedTuple):
    """What one preparation took."""

    rows: int
    seconds: float
    peak_bytes: int


def measure_preparation(files: Sequence[ClipFile], layout: str) -> Prepared:
    """Prepares clips into a folder that is thrown away.

    Args:
        files: the clips.
        layout: name in `LAYOUTS`.

    Returns:
        Rows written, mirrored ones included; seconds; and the most memory of the process, plus that of its workers.
    """
    (found,) = map_in_order(_prepare, [(tuple(files), layout)], 2)
    return found


def _prepare(task: tuple[tuple[ClipFile, ...], str]) -> Prepared:
    files, layout = task
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        dataset = prepare(files, Path(folder) / "dataset", PrepareConfig(layout=layout))
        rows, seconds = sum(dataset.frames.values()), time.perf_counter() - started
    own, largest = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return Prepared(rows, seconds, UNIT * (own + default_workers() * largest))
