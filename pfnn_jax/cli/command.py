"""What all sub-commands have in common."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import locate, refuse_existing, require_suffix
from pfnn_jax.motion.reading import ReadOptions

FLAT = tyro.conf.arg(name="")
"""The fields of a configuration become options without a prefix: --hidden, not --config.hidden."""

Run = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(name="run", metavar="RUN")]
"""A run directory, the word `base` or `hf://OWNER/NAME`, as a positional argument; `open_run` returns the directory."""

BASE = Path("base")
"""Word of the command line for the user's copy of the package's base network."""

Reading = Annotated[ReadOptions, FLAT]
"""The options of every command that reads clips: --unit, --up, --source-fps, --travel."""


@dataclass(frozen=True, kw_only=True)
class Command:
    """Options that every sub-command takes.

    Attributes:
        json: also write the result to this JSON file.
        given: names of the options on the command line, as those of attributes: what was asked for, not defaulted.
    """

    json: Path | None = None
    given: tyro.conf.Suppress[frozenset[str]] = frozenset()

    def run(self) -> Any:
        """Runs the command, prints its result, and returns what `--json` writes."""
        raise NotImplementedError

    def ending(self) -> AbstractContextManager[None]:
        """Returns a context for the end of the program, which sees its exit code."""
        return nullcontext()


def open_run(run: Path) -> Path:
    """Returns the directory of the run that a command line names, and checks that it can be loaded.

    The word `base` names the base network, unless the working directory holds something of that name, which is said.
    When the base network is first copied into the user's data folder, a line says where. `hf://OWNER/NAME` names a run
    on the Hugging Face Hub, which is copied there too.

    Raises:
        InputError: if it is not a run directory or not yet trained, or if the base network or the run of the Hub cannot
            be copied.
    """
    from pfnn_jax.run_config import check_finished
    from pfnn_jax.workflows.hub import hub_run, is_hub_address

    if is_hub_address(run):
        return hub_run(run)
    if run == BASE and locate(run) is None:
        return _open_base()
    if run == BASE:
        print_notes(run, [f"is {run.absolute()}, not the base network of the package; rename it to use that"])
    check_finished(run)
    return run


def _open_base() -> Path:
    from pfnn_jax.workflows.base import open_base

    base = open_base()
    if base.is_new:
        print(f"base: copied to {base.path}; styles learned on it are kept there")
        for path in base.earlier:
            print_notes(path, ["holds styles learned on an earlier base network; it stays, and can be used as a run"])
    return base.path


def print_notes(file: Path | str, notes: Iterable[str]) -> None:
    """Prints what was assumed about a clip's file and may be wrong, a line each."""
    for note in notes:
        print(f"note: {file}: {note}")


def check_output(path: Path, overwrite: bool, *suffixes: str) -> None:
    """Checks a file or folder that a command is going to write, before it does long work.

    Args:
        path: of the output.
        overwrite: whether it may exist.
        suffixes: of a file, one of which it must have; none for a folder, whose parents are made.

    Raises:
        InputError: for another suffix, for a file in a folder that does not exist or is not writable, or for an output
            that exists and must not be overwritten.
    """
    if suffixes:
        require_suffix(path, suffixes)
        check_writable(path)
    refuse_existing(path, overwrite)


def check_writable(path: Path) -> None:
    """Checks that a file can be created where `path` says.

    Raises:
        InputError: if its folder is absent, is a file, or is not writable.
    """
    import os

    folder = path.parent
    if not folder.is_dir():
        value = "is a file" if folder.exists() else "does not exist"
        raise InputError(path, "folder", f"{folder} {value}", "must exist: create it first")
    if path.is_dir():
        raise InputError(path, "output", "is a folder", "must be a file")
    if not os.access(folder, os.W_OK):
        raise InputError(path, "folder", f"{folder} is read-only", "must be writable")


def parse_choice(style: str | None, run: Path) -> str | dict[str, float] | None:
    """Returns the style, or the weights of a mixture, that an option `--style` names.

    Raises:
        InputError: for a style that the run does not have, or a mixture that is malformed.
    """
    from pfnn_jax.inference.style_choice import parse_style
    from pfnn_jax.run_config import list_styles, style_note

    if style is None:
        return None
    choice = parse_style(style, list_styles(run), run)
    for name in (choice,) if isinstance(choice, str) else choice:
        style_note(run, name)
    return choice
