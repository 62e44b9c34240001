"""Moves of several files of a run that belong together, such as a style and its uploaded clip.

A process that is killed between two of them would leave the style under one name and its clip under another. The moves
are therefore written into a hidden file of the run first, and the next page that opens the run completes them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import read_json, read_note, write_json
from pfnn_jax.io.locks import writing
from pfnn_jax.viewer.page.run_places import own_folder

JOURNAL = ".moves.json"
"""Hidden file of a run with the moves of a change that has begun."""

RULE = "must be a list of moves within the run"

Move = tuple[Path, Path]
"""Present and new place."""


def move_together(run: Path, moves: Sequence[Move]) -> None:
    """Moves files and folders of a run; if one cannot be moved, none is. A style takes the name of its new folder.

    Args:
        run: that the caller is writing (`io.locks.writing`).
        moves: of which all places are in the run.

    Raises:
        OSError: of the move that failed.
        InputError: for a style's note that cannot be read or written.
    """
    finish_moves(run)
    with ExitStack() as undo:
        undo.callback((run / JOURNAL).unlink, missing_ok=True)
        with suppress(OSError, InputError):  # a full disk has room for moves, but not for a file
            places = [[place.relative_to(run).as_posix() for place in move] for move in moves]
            write_json(run / JOURNAL, {"moves": places})
        for before, after in moves:
            before.rename(after)
            undo.callback(after.rename, before)
            undo.callback(_take_name(run, after))
        undo.pop_all()
    (run / JOURNAL).unlink(missing_ok=True)


def finish_moves(run: Path) -> None:
    """Completes the moves that a killed process began, all or none of them.

    None is made, and the journal dropped, if one of them has become impossible: because another style has taken its
    place, or because the journal is not one that `move_together` has written. The journal stays while another process
    writes the run, and where the run cannot be written.
    """
    if not has_unfinished_moves(run):
        return
    with suppress(OSError, InputError), writing(run):
        moves = _read_moves(run)
        if all(_is_done(*move) or _is_possible(*move) for move in moves):
            for before, after in moves:
                if not _is_done(before, after):
                    before.rename(after)
                with suppress(InputError):  # a note that cannot be read
                    _take_name(run, after)
        (run / JOURNAL).unlink()


def has_unfinished_moves(run: Path) -> bool:
    """Returns whether a killed process has left moves that are not completed yet."""
    return (run / JOURNAL).is_file()


def _is_done(before: Path, after: Path) -> bool:
    return after.exists() and not before.exists()


def _is_possible(before: Path, after: Path) -> bool:
    """Returns whether a file can be moved: to a free place, or to its own in letters of another case."""
    return before.exists() and after.parent.is_dir() and (not after.exists() or after.samefile(before))


def _read_moves(run: Path) -> list[Move]:
    """Returns the moves of the journal; none if one of them leads out of the run, or behind a link."""
    with suppress(InputError):
        moves = read_json(run / JOURNAL, RULE).get("moves")
        if isinstance(moves, list) and all(isinstance(move, list) and len(move) == 2 for move in moves):
            return [(_place(run, before), _place(run, after)) for before, after in moves]
    return []


def _place(run: Path, text: object) -> Path:
    """Returns a place in the run.

    Raises:
        InputError: for one outside, or behind a link, or a name that is a path on another system.
    """
    parts = text.split("/") if isinstance(text, str) and text.isprintable() else []
    if not parts or any(part in ("", ".", "..") or "\\" in part or ":" in part for part in parts):
        raise InputError(run / JOURNAL, "moves", ascii(text)[:60], RULE)
    return own_folder(run, *parts)


def _take_name(run: Path, folder: Path) -> Callable[[], None]:
    """Writes the name of a style's folder into its note; returns a function that restores the note."""
    if folder.parent != run / "styles":
        return lambda: None
    note = read_note(folder, "style.json", "must be a style's note")
    write_json(folder / "style.json", {**note, "name": folder.name})
    return partial(write_json, folder / "style.json", note)
