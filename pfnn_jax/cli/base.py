"""What all commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from pfnn_jax.errors import InputError

FLAT = tyro.conf.arg(name="")
"""Settings appear as --hidden, not --config.hidden."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """What every command takes.

    Attributes:
        json: write the result to this file, for scripts.
    """

    json: Path | None = None


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Before long work, so that it is not done in vain.

    Raises:
        InputError: if the path exists and must not be overwritten.
    """
    if path.exists() and not overwrite:
        raise InputError(path, "output", "exists", "existing output is replaced only with --overwrite")
