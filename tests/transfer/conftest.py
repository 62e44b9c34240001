"""Fixtures for tests of style transfer."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import pytest


@pytest.fixture
def float64() -> Iterator[None]:
    """Enables double precision inside one test: finite differences need it."""
    with jax.enable_x64(True):
        yield
