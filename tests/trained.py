"""Trained runs that tests share: trained once per test session, by the first worker that needs one.

    from tests.trained import walking_run

    @pytest.fixture(scope="session")
    def run(tmp_path_factory) -> Run:
        return walking_run(tmp_path_factory)

The runs are shared by all tests and workers: a test that changes one copies its directory first.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.run import Run, load_run
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.workflows.pretrain import pretrain_run

WALKING_STYLES = ("neutral", "old", "proud")

MAX_WAIT = 1800.0
"""Seconds for which a worker waits for another to train."""


def walking_run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Returns a small run with three procedural styles and their mirror images, which walks and turns."""

    def train(folder: Path) -> None:
        takes = [clip for style in WALKING_STYLES for clip in synthetic_clips(style, 20.0)]
        dataset = prepare(takes, folder / "data", PrepareConfig())
        pretrain_run(dataset, folder / "run", PretrainConfig(hidden=64, steps=500, learning_rate=1e-3))

    return load_run(made_once(tmp_path_factory, "walking_run", train) / "run")


def made_once(tmp_path_factory: pytest.TempPathFactory, name: str, make: Callable[[Path], None]) -> Path:
    """Returns a folder that `make` has filled, once for all workers of the session.

    Args:
        tmp_path_factory: the fixture.
        name: of the folder.
        make: fills the folder that it is given.
    """
    base = tmp_path_factory.getbasetemp()
    base = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base  # a worker's own folder is inside the session's
    folder, lock, began = base / name, base / f"{name}.lock", time.monotonic()
    while not folder.exists():
        try:
            lock.mkdir()  # atomic: one worker makes the folder, the others wait
        except FileExistsError:
            if time.monotonic() - began > MAX_WAIT:
                raise TimeoutError(f"{lock} was not released; the worker that held it has probably died.") from None
            time.sleep(0.2)
            continue
        try:
            if not folder.exists():
                partial = base / f"{name}.partial.{os.getpid()}"
                partial.mkdir()
                make(partial)
                partial.rename(folder)
        finally:
            lock.rmdir()
    return folder
