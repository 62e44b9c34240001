"""Renaming and deleting styles that were learned in a run, with a way back.

A deleted style and its uploaded clip are moved into a hidden folder of the run, which is removed when the program ends
or, if it did not end properly, by the next one. Everything is moved by renaming: a style is at one place or the other,
complete.
"""

from __future__ import annotations

import os
import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure, is_running, read_note, write_json
from pfnn_jax.run_config import check_new_style, list_styles

TRASH = re.compile(r"\.deleted\.(\d+)")
"""Name of the hidden folder: with the number of the process that has made it."""


@dataclass(frozen=True)
class DeletedStyle:
    """A style that can be restored.

    Attributes:
        name: of the style.
        folder: where it is now.
        clip: where its uploaded clip is now, or None if it had none.
    """

    name: str
    folder: Path
    clip: Path | None


def rename_style(run: Path, old: str, new: str) -> None:
    """Gives a style of a run another name.

    Raises:
        InputError: for an unknown style, a name that cannot be a folder's or is taken, or a run that cannot be written.
    """
    _check_saved(run, old)
    _check_free(run, new)
    folder = run / "styles" / new
    try:
        (run / "styles" / old).rename(folder)
        note = read_note(folder, "style.json", "must be a style's note")
        write_json(folder / "style.json", {**note, "name": new})
    except OSError as error:
        raise InputError(run / "styles" / old, "style", failure(error), "the run's folder must be writable") from error


def delete_style(run: Path, name: str) -> DeletedStyle:
    """Moves a style of a run, and its uploaded clip, into the hidden folder.

    Raises:
        InputError: for an unknown style, or a run that cannot be written.
    """
    _check_saved(run, name)
    try:
        trash = run / f".deleted.{os.getpid()}"
        trash.mkdir(exist_ok=True)
        place = next(place for number in range(10**6) if not (place := trash / str(number)).exists())
        place.mkdir()
        (run / "styles" / name).rename(place / "style")
    except OSError as error:
        raise InputError(run / "styles" / name, "style", failure(error), "the run's folder must be writable") from error
    clip = next(iter(sorted((run / "uploads").glob(f"{_escaped(name)}.*"))), None)
    kept = None if clip is None else place / clip.name
    if clip is not None and kept is not None:
        try:
            clip.rename(kept)
        except OSError:  # the style is gone, which is what was asked for
            kept = None
    return DeletedStyle(name, place / "style", kept)


def restore_style(run: Path, deleted: DeletedStyle) -> None:
    """Moves a deleted style and its clip back.

    Raises:
        InputError: if a style of this name has been made meanwhile, or the run cannot be written.
    """
    _check_free(run, deleted.name)
    try:
        deleted.folder.rename(run / "styles" / deleted.name)
        if deleted.clip is not None and not (run / "uploads" / deleted.clip.name).exists():
            deleted.clip.rename(run / "uploads" / deleted.clip.name)
    except OSError as error:
        rule = "could not be restored; the run's folder must be writable"
        raise InputError(run / "styles" / deleted.name, "style", failure(error), rule) from error


def empty_trash(run: Path) -> None:
    """Removes what this process has deleted, and what processes have deleted that have ended."""
    with suppress(OSError):
        for folder in run.iterdir():
            found = TRASH.fullmatch(folder.name)
            number = int(found[1]) if found is not None else None
            if number is not None and (number == os.getpid() or not is_running(number)) and not folder.is_symlink():
                shutil.rmtree(folder, ignore_errors=True)


def _check_saved(run: Path, name: str) -> None:
    if name not in list_styles(run):
        raise InputError(run, "style", ascii(name)[:60], "must be a style that was learned in this run")


def _check_free(run: Path, name: str) -> None:
    """Refuses a name that is no folder's, or that another style has, in letters of any case."""
    if name.lower() in (style.lower() for style in list_styles(run)):
        raise InputError(run, "style name", name, "is taken by another style; choose another name")
    check_new_style(run, name)


def _escaped(name: str) -> str:
    """Returns a name for `glob`; names of styles can hold square brackets."""
    return re.sub(r"([\[\]])", r"[\1]", name)
