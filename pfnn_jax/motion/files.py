"""Files and folders that appear whole or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Collection
from pathlib import Path

from pfnn_jax.errors import InputError


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Before long work, so that it is not done in vain.

    Raises:
        InputError: if the path exists and must not be overwritten.
    """
    if path.exists() and not overwrite:
        raise InputError(path, "output", "exists", "existing output is replaced only with --overwrite")


def require_suffix(path: Path, suffixes: Collection[str]) -> None:
    """A file's name tells what is in it: refuse another kind's, or none, before long work.

    Args:
        path: file to write.
        suffixes: those of the kind, in lower case with their dots; capitals in the name are taken too.

    Raises:
        InputError: for another suffix.
    """
    if path.suffix.lower() not in suffixes:
        rule = f"must be {'one of ' if len(suffixes) > 1 else ''}{', '.join(suffixes)}"
        raise InputError(path, "suffix", path.suffix or "none", rule)


def failure(error: Exception) -> str:
    """Why a file could not be read or written, in one line that does not repeat the path beside which it stands."""
    reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
    return reason or type(error).__name__


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file so that it appears whole or not at all; text as UTF-8, its line ends as they are.

    Raises:
        InputError: if it cannot be written, as on a full disk; nothing is left behind.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(path, "output", error.strerror or error, "must be writable and the disk have room") from None
    finally:
        temporary.unlink(missing_ok=True)


def swap_folder(new: Path, target: Path) -> None:
    """Put a finished folder in its place; what stood there is kept until the new one does, then removed.

    Args:
        new: the finished folder, beside `target` so that it can be renamed.
        target: its place, with or without something there.

    Raises:
        OSError: if it cannot be renamed; then what stood there still does.
    """
    old = new.with_name(f"{new.name}.old")
    if not target.exists() and not target.is_symlink():
        new.rename(target)
        return
    target.rename(old)
    try:
        new.rename(target)
    except OSError:
        old.rename(target)
        raise
    if old.is_dir() and not old.is_symlink():
        shutil.rmtree(old)
    else:
        old.unlink()
