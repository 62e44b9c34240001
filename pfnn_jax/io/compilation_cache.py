"""The compiled code that commands and the page keep, so that later ones skip most of compiling.

JAX loads compiled code from its cache and runs it: whoever can write into the folder can run programs as the user. It
therefore lies in the user's own cache folder, readable and writable for nobody else, and is refused otherwise. Each
version of JAX and each processor has a folder of its own, so that a home folder can be shared between machines.

JAX's own bound on the folder's size (`jax_compilation_cache_max_size`) is not used: it takes a lock and writes a file
for every entry that is read, and fails where one was written without it.
"""

from __future__ import annotations

import hashlib
import os
import platform
import stat
import time
import warnings
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure

VARIABLE = "JAX_COMPILATION_CACHE_DIR"
"""Environment variable that names another folder; JAX reads it."""

LOG_LEVEL = "TF_CPP_MIN_LOG_LEVEL"
"""Environment variable with the least level of XLA's log messages; it reads it when it is loaded."""

OFF = ("0", "false", "f", "no", "n", "off")
"""Values of `JAX_ENABLE_COMPILATION_CACHE` with which JAX keeps nothing."""

OPTIONS = {"jax_persistent_cache_min_compile_time_secs": 0.05}
"""What JAX keeps: reading back what took less time to compile saves nothing."""

LONGEST_UNUSED, MOST_BYTES = 60, 256 * 2**20
"""Days after which what was compiled is removed, and bytes of which the oldest is removed: every version of JAX and
every network leaves its own files, about 1 MB for a command."""

REJECTED = "rejected"
"""File that says that XLA does not load on this processor what it has compiled there (jax-ml/jax#38445)."""


def cache_folder() -> Path:
    """Returns the folder of the user's own cache directory; it need not exist."""
    from platformdirs import user_cache_path

    return user_cache_path("pfnn_jax", appauthor=False) / "compiled"


def compiled_folder() -> Path:
    """Returns the folder in it for this version of JAX and this processor; it need not exist."""
    return cache_folder() / f"jax-{jax_version()}-{_processor()}"


def use_private_cache() -> Path | None:
    """Makes JAX keep what it compiles in `compiled_folder`, unless the environment or the program names another folder.

    Returns:
        The folder that JAX uses; None if its cache is switched off or useless on this processor.

    Raises:
        InputError: if the folder could be written by others or cannot be made. Nothing is kept then.
    """
    import jax

    if not getattr(jax.config, "jax_enable_compilation_cache"):  # noqa: B009 - the class does not declare its options
        return None
    named = getattr(jax.config, "jax_compilation_cache_dir")  # noqa: B009 - by the program or the variable
    if named:
        return Path(named)
    folder = _prepared_folder()
    if folder is not None:
        jax.config.update("jax_compilation_cache_dir", str(folder))
        for name, value in OPTIONS.items():
            jax.config.update(name, value)
    return folder


def folder_in_use() -> Path | None:
    """Returns `compiled_folder` if this process keeps what it compiles there, and None otherwise."""
    import jax

    on, named = (getattr(jax.config, f"jax_{name}") for name in ("enable_compilation_cache", "compilation_cache_dir"))
    folder = compiled_folder()
    return folder if on and named == str(folder) and folder.is_dir() else None


def name_private_cache() -> None:
    """Sets the variables that make JAX keep what it compiles in `compiled_folder`, for a process that may import JAX.

    Nothing happens where the user has named a folder or has switched the cache off, or where the folder is refused.
    What JAX warns of, because it cannot read or write an entry, is not shown: it compiles instead. Nor are the log
    messages of XLA, unless `TF_CPP_MIN_LOG_LEVEL` is set: on some processors it reports 3,000 characters for every
    entry that it loads, about hints of its own compiler that the processor is not asked for (jax-ml/jax#38445). What
    fails is raised as an exception.
    """
    if VARIABLE in os.environ or os.environ.get("JAX_ENABLE_COMPILATION_CACHE", "1").lower() in OFF:
        return
    with suppress(InputError):
        folder = _prepared_folder()
        if folder is not None:
            os.environ[VARIABLE] = str(folder)
            os.environ.setdefault(LOG_LEVEL, "3")
            for name, value in OPTIONS.items():
                os.environ.setdefault(name.upper(), str(value))
            _hide_warnings(folder)


def _prepared_folder() -> Path | None:
    """Returns the private folder, without what has been unused for long; None if XLA loads nothing from it."""
    folder = compiled_folder()
    private_folder(folder.parent)
    private_folder(folder)
    _remove_unused(folder.parent)
    return None if (folder / REJECTED).exists() else folder


def _processor() -> str:
    """Returns digits that name the processor and the instructions that it has."""
    found = [platform.machine(), platform.processor()]
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split("\n\n")[0].splitlines()
        found += [line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))]
    return hashlib.sha256("\n".join(found).encode()).hexdigest()[:12]


def _hide_warnings(folder: Path) -> None:
    """Hides warnings of an unusable entry, and notes in the folder where XLA rejects all that it compiles itself."""
    show = warnings.showwarning

    def showwarning(message: Any, *args: Any, **kwargs: Any) -> None:
        text = str(message)
        if not text.startswith(("Error reading persistent compilation", "Error writing persistent compilation")):
            show(message, *args, **kwargs)
        elif "machine type" in text.lower() or "machine feature" in text.lower():
            with suppress(OSError):
                (folder / REJECTED).touch()

    warnings.showwarning = showwarning


def private_folder(folder: Path) -> Path:
    """Returns a folder that only the user can read and write, and makes it where it does not exist.

    Raises:
        InputError: if it is a link or not a folder, belongs to somebody else, can be written by others, or lies in a
            folder in which others could replace it; if it cannot be made.
    """
    rule = f"must be a folder of your own that nobody else can write to; name another with {VARIABLE}"
    try:
        make_private(folder)
        if os.name == "posix":
            _check_private(folder, rule)
            folder.chmod(0o700)
    except OSError as error:
        raise InputError(folder, "compilation cache", failure(error), rule) from error
    return folder


def make_private(folder: Path) -> None:
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
    """Removes compiled code that was written long ago, and the oldest of what exceeds the bound on its size."""
    found = []
    for file in folder.rglob("*-cache"):
        with suppress(OSError):  # another program may remove it at the same time
            found.append((file.stat().st_mtime, file.stat().st_size, file))
    oldest, total = time.time() - LONGEST_UNUSED * 24 * 3600, 0
    for written, size, file in sorted(found, reverse=True):
        total += size
        if written < oldest or total > MOST_BYTES:
            with suppress(OSError):
                file.unlink()


def jax_version() -> str:
    """Returns the version of the installed JAX, whose compiled code other versions cannot use."""
    return version("jax")
