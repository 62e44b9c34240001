"""Moves of several files of a run that belong together, such as a style and its uploaded clip.

A process that is killed between two of them would leave the style under one name and its clip under another. What is
to be moved is therefore written down before, in a hidden file of the run, and the next program that opens the run does
the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path, PurePosixPath

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import read_json, read_note, write_json
from pfnn_jax.io.locks import writing

JOURNAL = ".moves.json"
"""Hidden file of a run with the moves of a change that has begun."""

RULE = "must be a list of moves within the run"


def move_together(run: Path, moves: Sequence[tuple[Path, Path]]) -> None:
    """Moves files and folders of a run; if one cannot be moved, none is. A style takes the name of its new folder.

    Args:
        run: that the caller is writing (`io.locks.writing`).
        moves: present and new place of each, both in the run.

    Raises:
        OSError: of the move that failed.
        InputError: for a style's note that cannot be read.
    """
    journal = run / JOURNAL
    with ExitStack() as undo:
        undo.callback(journal.unlink, missing_ok=True)
        with suppress(OSError):  # a full disk has room for moves, but not for a file
            write_json(journal, {"moves": [[_within(run, place) for place in move] for move in moves]})
        for before, after in moves:
            before.rename(after)
            undo.callback(after.rename, before)
            undo.callback(_take_name(run, after))
        undo.pop_all()
    journal.unlink(missing_ok=True)


def finish_moves(run: Path) -> None:
    """Makes the rest of the moves that a killed process has begun, unless another process writes the run."""
    if not (run / JOURNAL).is_file():
        return
    with suppress(OSError, InputError), writing(run):
        for before, after in _read_moves(run):
            if before.exists() and not after.exists():
                before.rename(after)
            _take_name(run, after)
        (run / JOURNAL).unlink()


def _within(run: Path, place: Path) -> str:
    return place.relative_to(run).as_posix()


def _read_moves(run: Path) -> Iterator[tuple[Path, Path]]:
    """Yields the moves of the journal, of which none leads out of the run.

    Raises:
        InputError: for anything else that the file holds.
    """
    moves = read_json(run / JOURNAL, RULE).get("moves")
    if not isinstance(moves, list) or not all(isinstance(move, list) and len(move) == 2 for move in moves):
        raise InputError(run / JOURNAL, "moves", ascii(moves)[:60], RULE)
    for before, after in moves:
        yield _place(run, before), _place(run, after)


def _place(run: Path, text: object) -> Path:
    """Returns a place in the run; refuses one outside, also by way of a link."""
    path = PurePosixPath(text if isinstance(text, str) and text.isprintable() else "..")
    above = path.parts[:-1]
    outside = path.is_absolute() or ".." in path.parts or path.name == ""
    if outside or run.joinpath(*above).resolve() != run.resolve().joinpath(*above):
        raise InputError(run / JOURNAL, "moves", ascii(text)[:60], RULE)
    return run / path


def _take_name(run: Path, folder: Path) -> Callable[[], None]:
    """Writes the name of a style's folder into its note; returns a function that puts the present note back."""
    if folder.parent != run / "styles":
        return lambda: None
    note = read_note(folder, "style.json", "must be a style's note")
    write_json(folder / "style.json", {**note, "name": folder.name})
    return partial(write_json, folder / "style.json", note)
