"""The authors' local-phase network with its 100 styles, imported once for all tests of this folder."""

from __future__ import annotations

import pytest

from pfnn_jax.interop.released.mason2022 import import_released_lpn
from pfnn_jax.run import Run


@pytest.fixture(scope="session")
def lpn_run(reference, tmp_path_factory) -> Run:
    return import_released_lpn(reference / "lpn", tmp_path_factory.mktemp("released") / "lpn")
