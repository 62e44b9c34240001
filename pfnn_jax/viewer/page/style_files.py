"""Renaming and deleting styles that were learned in a run, with a way back.

A deleted style and its uploaded clip are moved into a hidden folder of the run, which is removed when the program ends
or, if it did not end properly, by the next one. A style and its clip are moved together (`journal`).
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure, is_running
from pfnn_jax.io.locks import writing
from pfnn_jax.motion.clip_files import CLIP_SUFFIXES
from pfnn_jax.motion.datasets.sources import check_style_name
from pfnn_jax.run_config import check_new_style, list_styles
from pfnn_jax.viewer.page.journal import has_unfinished_moves, move_together
from pfnn_jax.viewer.page.run_places import own_folder

DELETED_FOLDER = re.compile(r"\.deleted\.(\d+)")
"""Name of the hidden folder: with the number of the process that has made it."""

UNFINISHED = ".unfinished"
"""Ending of the name of a hidden file next to an upload whose style is not saved yet."""


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
    """Gives a style of a run, and its uploaded clip, another name; if that fails, both keep the old one.

    Raises:
        InputError: for an unknown style, a note that cannot be read, a name that cannot be a folder's or is taken, a
            link, or a run that cannot be written or that another process is writing.
    """
    with _changing(run, old):
        before, clip = _saved_folder(run, old), uploaded_clip(run, old)
        if new.lower() == old.lower():
            check_style_name(new, run)
        else:
            _check_free(run, new)
        moves = [(before, own_folder(run, "styles", new))]
        if clip is not None:
            moves.append((clip, clip.with_name(f"{new}{clip.suffix}")))
        move_together(run, moves)


def delete_style(run: Path, name: str) -> DeletedStyle:
    """Moves a style of a run, and its uploaded clip, into the hidden folder; if that fails, both stay.

    Raises:
        InputError: for an unknown style, a link, or a run that cannot be written or that
            another process is writing.
    """
    with _changing(run, name):
        folder, clip = _saved_folder(run, name), uploaded_clip(run, name)
        hidden = own_folder(run, f".deleted.{os.getpid()}")
        hidden.mkdir(exist_ok=True)
        place = next(place for number in range(10**6) if not (place := hidden / str(number)).exists())
        place.mkdir()
        kept = None if clip is None else place / clip.name
        move_together(run, [(folder, place / "style"), *([] if clip is None or kept is None else [(clip, kept)])])
    return DeletedStyle(name, place / "style", kept)


def restore_style(run: Path, deleted: DeletedStyle) -> None:
    """Moves a deleted style and its clip back; if that fails, both stay deleted.

    Raises:
        InputError: if its name has been taken meanwhile, for a link, or a run that cannot be written or that
            another process is writing.
    """
    with _changing(run, deleted.name):
        _check_free(run, deleted.name)
        folder, uploads = own_folder(run, "styles", deleted.name), own_folder(run, "uploads")
        moves = [(deleted.folder, folder)]
        if deleted.clip is not None:
            uploads.mkdir(exist_ok=True)
            moves.append((deleted.clip, uploads / deleted.clip.name))
        move_together(run, moves)


def empty_trash(run: Path) -> None:
    """Removes what this process has deleted, and what processes have deleted that have ended.

    Nothing is removed while moves are unfinished: one of them may restore a style.
    """
    if has_unfinished_moves(run):
        return
    with suppress(OSError):
        for folder in run.iterdir():
            found = DELETED_FOLDER.fullmatch(folder.name)
            number = int(found[1]) if found is not None else None
            if number is not None and (number == os.getpid() or not is_running(number)) and not folder.is_symlink():
                shutil.rmtree(folder, ignore_errors=True)


def unfinished_mark(upload: Path) -> Path:
    """Returns the hidden file that is next to an upload until its style is saved."""
    return upload.with_name(f".{upload.name}{UNFINISHED}")


def remove_unfinished(run: Path) -> None:
    """Removes uploads whose style was not saved because the page was killed, unless another process writes the run."""
    with suppress(OSError, InputError):
        marks = [path for path in _uploads(run) if path.name.endswith(UNFINISHED)]
        if not marks:
            return
        with writing(run):
            for mark in marks:
                with suppress(OSError):
                    upload = mark.with_name(mark.name[1:].removesuffix(UNFINISHED))
                    if upload.stem not in list_styles(run):
                        upload.unlink(missing_ok=True)
                    mark.unlink()
            (run / "uploads").rmdir()  # if it is empty


def uploaded_clip(run: Path, style: str) -> Path | None:
    """Returns the uploaded clip of a style, or None; never one outside the run."""
    return next((path for path in _uploads(run) if path.stem == style and path.suffix in CLIP_SUFFIXES), None)


def taken_names(run: Path) -> set[str]:
    """Returns the names of styles and uploaded clips of a run, in small letters."""
    return {name.lower() for name in (*list_styles(run), *(path.stem for path in _uploads(run)))}


@contextmanager
def _changing(run: Path, style: str) -> Iterator[None]:
    """Keeps other processes from writing the run, and turns errors of the file system into `InputError`."""
    try:
        with writing(run):
            yield
    except OSError as error:
        raise InputError(
            run / "styles" / style, "style", failure(error), "the run's folder must be writable"
        ) from error


def _uploads(run: Path) -> list[Path]:
    """Returns what lies in the run's folder of uploads, sorted; nothing if that is a link."""
    folder = run / "uploads"
    inside = folder.is_dir() and folder.resolve() == run.resolve() / "uploads"
    return sorted(folder.iterdir()) if inside else []


def _saved_folder(run: Path, name: str) -> Path:
    if name not in list_styles(run):
        raise InputError(run, "style", ascii(name)[:60], "must be a style that was learned in this run")
    return own_folder(run, "styles", name)


def _check_free(run: Path, name: str) -> None:
    """Refuses a name that is no folder's, or that another style or upload has, in letters of any case."""
    if name.lower() in taken_names(run):
        raise InputError(run, "style name", name, "is taken by another style; choose another name")
    check_new_style(run, name)
