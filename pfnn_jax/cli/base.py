"""What all commands share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from pfnn_jax.io.files import refuse_existing, require_suffix

FLAT = tyro.conf.arg(name="")
"""Settings appear as --hidden, not --config.hidden."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """What every command takes.

    Attributes:
        json: write the result to this file, for scripts.
    """

    json: Path | None = None


def check_file(path: Path, suffix: str, overwrite: bool) -> None:
    """A file that a command is to write, before long work.

    Raises:
        InputError: for another suffix than that of its kind, or if the file exists and must not be overwritten.
    """
    require_suffix(path, (suffix,))
    refuse_existing(path, overwrite)
