"""The base network of the package, on which a style is learned without training a network first.

The package holds one small run in `pfnn_jax/base_network/`; its `CARD.md` says what it was trained on. A package may
be read-only and is replaced by updates. Styles are therefore learned on a copy in the user's own data folder. Each
network has its own copy, so that an update with another network leaves the earlier one and its styles alone.
"""

from __future__ import annotations

import filecmp
import re
from dataclasses import dataclass
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import ARRAYS, copy_once, failure, read_note
from pfnn_jax.run_config import check_finished, list_styles, load_config

BASE_NETWORK = Path(__file__).resolve().parents[1] / "base_network"
"""The run in the package, which is never written to."""

FIXED = ("differences", "normaliser", "shared")
"""Folders of the run that no command changes."""

DIGITS = 12
"""Of the network's fingerprint, in the name of the copy."""


@dataclass(frozen=True)
class BaseRun:
    """The user's copy of the base network.

    Attributes:
        path: its run directory.
        is_new: whether this call has made it.
        earlier: copies of the base networks of other versions of the package, in which styles have been learned.
    """

    path: Path
    is_new: bool
    earlier: tuple[Path, ...]


def base_run() -> Path:
    """Returns the run directory of the package's base network, in the user's own data folder.

    The first call copies it there, complete or not at all; several processes may do so at once. Learned styles are
    saved in it, and stay when the package is updated. The folder is `pfnn_jax/base-FINGERPRINT` in `$XDG_DATA_HOME` or
    `~/.local/share` on Linux, `~/Library/Application Support` on macOS, and `%LOCALAPPDATA%` on Windows.

    Raises:
        InputError: if the data folder cannot be written, or the copy is damaged.
    """
    return open_base().path


def open_base() -> BaseRun:
    """Returns what `base_run` does, and what a command says about it.

    Raises:
        InputError: as `base_run`.
    """
    target = _copy_path()
    try:
        is_new = copy_once(BASE_NETWORK, target)
    except OSError as error:
        rule = "must be writable: the base network is copied there, and styles learned on it are saved in it"
        raise InputError(target, "data folder", failure(error), rule) from error
    _check_copy(target)
    return BaseRun(target, is_new, _earlier(target))


def is_base(run: Path) -> bool:
    """Returns whether a run directory is the user's copy of this version's base network, which users know as `base`."""
    return run.resolve() == _copy_path().resolve()


def _copy_path() -> Path:
    return data_folder() / f"base-{_fingerprint(BASE_NETWORK)[:DIGITS]}"


def data_folder() -> Path:
    """Returns the folder in which the package keeps a user's own copies of runs; it need not exist."""
    from platformdirs import user_data_path

    return user_data_path("pfnn_jax", appauthor=False)


def _fingerprint(run: Path) -> str:
    return read_note(run / "shared", "shared.json", "the package must hold its base network: install it again")[
        "fingerprint"
    ]


def _check_copy(copy: Path) -> None:
    """Refuses a copy whose configuration cannot be read, or whose network is not that of the package."""
    fresh = "remove the folder to get a fresh copy, after moving what you want to keep of its styles"
    try:
        check_finished(copy)
    except InputError as error:
        raise InputError(error.file, error.place, error.value, f"{error.rule}; {fresh}") from error
    for original in (path for folder in FIXED for path in (BASE_NETWORK / folder).rglob("*") if path.is_file()):
        file = copy / original.relative_to(BASE_NETWORK)
        if file.name == ARRAYS and not file.exists():  # a copy of an earlier version; it follows from the others
            continue
        if not file.is_file() or not filecmp.cmp(original, file, shallow=False):
            value = "damaged" if file.is_file() else "absent"
            raise InputError(copy, file.relative_to(copy).as_posix(), value, f"must be as in the package; {fresh}")


def _earlier(copy: Path) -> tuple[Path, ...]:
    """Returns the other copies next to one in which styles have been learned."""
    name = re.compile(rf"base-[0-9a-f]{{{DIGITS}}}")
    others = (path for path in copy.parent.iterdir() if name.fullmatch(path.name) and path != copy)
    return tuple(sorted(path for path in others if _has_learned_styles(path)))


def _has_learned_styles(run: Path) -> bool:
    try:
        return bool(set(list_styles(run)) - set(load_config(run).styles))
    except InputError:
        return False
