"""Small runs by layout and kind of style, created once for all tests of this folder."""

from __future__ import annotations

from functools import cache

import pytest

from pfnn_jax.control.run_settings import default_speed
from pfnn_jax.interop.export.walks import Walk
from pfnn_jax.run import Run
from tests.interop.small_runs import make_run


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")

    @cache
    def make(name: str, kind: str) -> Run:
        return make_run(folder / f"{name}_{kind}", name, kind)

    return make


@pytest.fixture
def recorded_walks(monkeypatch):
    """Exports styles with their recorded speeds: measuring their walks takes most of the compilation.

    `test_folder.py` and `test_reference_loop.py` are about measured walks.
    """

    def walks_of(run, choices):
        speeds = [default_speed(run, choice) for choice in choices]
        return [Walk(speed, speed, speed, None) for speed in speeds]

    monkeypatch.setattr("pfnn_jax.interop.export.description.walks_of", walks_of)
