"""Fixtures shared by all tests: where the real data lies, and strict numerics."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


def _folder(variable: str, default: Path) -> Path:
    folder = Path(os.environ.get(variable, default))
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: set {variable} to the folder of real data")
    return folder


@pytest.fixture(scope="session")
def mocap() -> Path:
    """Folder of real motion capture; skips where it is absent."""
    return _folder("PFNN_JAX_MOCAP", SHARED / "mocap")


@pytest.fixture(scope="session")
def reference() -> Path:
    """Folder of the authors' weights and golden files; skips where it is absent."""
    return _folder("PFNN_JAX_REFERENCE", SHARED / "reference")
