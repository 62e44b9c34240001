"""Small runs by layout and kind of style, created once for all tests of this folder."""

from __future__ import annotations

from functools import cache

import pytest

from pfnn_jax.run import Run
from tests.interop.small_runs import make_run


@pytest.fixture(scope="session")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")

    @cache
    def make(name: str, kind: str) -> Run:
        return make_run(folder / f"{name}_{kind}", name, kind)

    return make
