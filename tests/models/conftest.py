"""Fixtures for tests of the networks."""

from __future__ import annotations

from collections.abc import Iterator

import jax
import pytest


@pytest.fixture(autouse=True)
def strict_dtypes() -> Iterator[None]:
    """Refuses every implicit conversion between types of arrays in the mathematics under test."""
    with jax.numpy_dtype_promotion("strict"):
        yield


@pytest.fixture
def float64() -> Iterator[None]:
    """Enables double precision inside one test: finite differences need it."""
    with jax.enable_x64(True):
        yield
