"""Places in a run's folder that the page may change: never behind a link."""

from __future__ import annotations

from pathlib import Path

from pfnn_jax.errors import InputError


def own_folder(run: Path, *parts: str) -> Path:
    """Returns a folder of a run, which need not exist.

    Raises:
        InputError: if it or one above it within the run is a link: what is moved or deleted there could be outside.
    """
    folder = run.joinpath(*parts)
    if folder.resolve() != run.resolve().joinpath(*parts):
        raise InputError(folder, "folder", "is a link", "must be a folder of the run itself")
    return folder
