"""The compiled code that `play` keeps, so that later starts skip most of compiling, and how long starts have taken.

JAX loads compiled code from its cache and runs it: whoever can write into the folder can run programs as the user. It
therefore lies in the user's own cache folder, readable and writable for nobody else, and is refused otherwise.
"""

from __future__ import annotations

import json
import os
import stat
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure, write_whole

VARIABLE = "JAX_COMPILATION_CACHE_DIR"
"""Environment variable that names another folder; JAX reads it."""

LEAST_SECONDS = 0.05
"""Compilations that took less than this are not kept: reading them back saves nothing."""

LONGEST_UNUSED = 60
"""Days after which what was compiled is removed: every version of JAX and every network leaves its own files."""

TIMES = "start_times.json"
"""File with the seconds of earlier starts."""

FIRST_SECONDS, KEPT_SHARE = 45.0, 0.3
"""Seconds of a start for which there is no earlier one, and the share of it that a start with kept code takes."""


def cache_folder() -> Path:
    """Returns the folder of the user's own cache directory; it need not exist."""
    from platformdirs import user_cache_path

    return user_cache_path("pfnn_jax", appauthor=False) / "compiled"


def use_private_cache() -> Path | None:
    """Makes JAX keep what it compiles in `cache_folder`, unless the environment or the program names another folder.

    Returns:
        The folder that JAX uses; None if its cache is switched off.

    Raises:
        InputError: if the folder could be written by others or cannot be made. Nothing is kept then.
    """
    import jax

    if not getattr(jax.config, "jax_enable_compilation_cache"):  # noqa: B009 - the class does not declare its options
        return None
    named = getattr(jax.config, "jax_compilation_cache_dir")  # noqa: B009 - by the program or the variable
    if named:
        return Path(named)
    folder = private_folder(cache_folder())
    _remove_unused(folder)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_SECONDS)
    return folder


def private_folder(folder: Path) -> Path:
    """Returns a folder that only the user can read and write, and makes it where it does not exist.

    Raises:
        InputError: if it is a link or not a folder, belongs to somebody else, can be written by others, or lies in a
            folder in which others could replace it; if it cannot be made.
    """
    rule = f"must be a folder of your own that nobody else can write to; name another with {VARIABLE}"
    try:
        _make_private(folder)
        if os.name == "posix":
            _check_private(folder, rule)
            folder.chmod(0o700)
    except OSError as error:
        raise InputError(folder, "compilation cache", failure(error), rule) from error
    return folder


def _make_private(folder: Path) -> None:
    """Makes a folder, and those above it that do not exist, for the user alone whatever the umask is."""
    for place in (*reversed(folder.parents), folder):
        if not place.exists():
            place.mkdir(mode=0o700, exist_ok=True)


def _check_private(folder: Path, rule: str) -> None:
    """Refuses a folder that others could have written into, or could replace."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        raise InputError(folder, "compilation cache", "is not a folder", rule)
    if found.st_uid != os.geteuid():
        raise InputError(folder, "compilation cache", f"belongs to user {found.st_uid}", rule)
    if found.st_mode & 0o022:
        raise InputError(folder, "compilation cache", f"mode {stat.S_IMODE(found.st_mode):o}", rule)
    for parent in folder.resolve().parents:
        above = parent.stat()
        if above.st_uid not in (0, os.geteuid()):
            raise InputError(parent, "compilation cache", f"belongs to user {above.st_uid}", rule)
        if _others_can_write(above) and not above.st_mode & stat.S_ISVTX:
            raise InputError(parent, "compilation cache", f"mode {stat.S_IMODE(above.st_mode):o}", rule)


def _others_can_write(found: os.stat_result) -> bool:
    """Returns whether others than the owner can write into a folder, as everybody or as members of its group."""
    if found.st_mode & stat.S_IWOTH:
        return True
    return bool(found.st_mode & stat.S_IWGRP) and not _is_own_group(found.st_gid)


def _is_own_group(number: int) -> bool:
    """Returns whether a group is the user's alone: many systems give each user one, of the user's name."""
    import grp
    import pwd

    try:
        group, user = grp.getgrgid(number), pwd.getpwuid(os.geteuid())
    except KeyError:
        return False
    return group.gr_name == user.pw_name and user.pw_gid == number and set(group.gr_mem) <= {user.pw_name}


def _remove_unused(folder: Path) -> None:
    """Removes compiled code that was written long ago."""
    oldest = time.time() - LONGEST_UNUSED * 24 * 3600
    for file in folder.glob("*-cache"):
        with suppress(OSError):  # another program may remove it at the same time
            if file.stat().st_mtime < oldest:
                file.unlink()


class StartTimes:
    """Seconds that earlier starts have taken on this machine, kept in a file next to the compiled code.

    Args:
        runs: a text for every run that is started, such as its path.
        kept: folder in which JAX keeps compiled code, or None.
        file: that holds the times of all starts.
    """

    def __init__(self, runs: Sequence[str], kept: Path | None, file: Path | None = None) -> None:
        self._file = file or cache_folder().parent / TIMES
        self._key, self._kept = " ".join([f"jax {jax_version()}", *runs]), kept
        found = self._read().get(self._key)
        self._times: dict[str, object] = found if isinstance(found, dict) else {}
        compiled = kept is not None and any(kept.glob("*-cache"))
        self._warm = compiled and self._times.get("folder") == str(kept)

    @property
    def expected(self) -> float:
        """Seconds that this start probably takes: as long as the last one, or by default as measured on two cores."""
        last = self._seconds("kept" if self._warm else "new")
        if last is not None:
            return last
        return (self._seconds("new") or FIRST_SECONDS) * (KEPT_SHARE if self._warm else 1.0)

    def note(self, seconds: float) -> None:
        """Keeps the seconds of this start; nothing happens where the file cannot be written."""
        entry = {**self._times, "kept" if self._warm else "new": round(seconds, 1)}
        entry["folder"] = None if self._kept is None else str(self._kept)
        with suppress(InputError, OSError):
            _make_private(self._file.parent)
            write_whole(self._file, json.dumps({**self._read(), self._key: entry}, indent=1))

    def _seconds(self, which: str) -> float | None:
        value = self._times.get(which)
        return float(value) if isinstance(value, int | float) and 0.0 < value < 1e5 else None

    def _read(self) -> dict[str, object]:
        try:
            found = json.loads(self._file.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}


def jax_version() -> str:
    """Returns the version of the installed JAX, whose compiled code other versions cannot use."""
    return version("jax")
