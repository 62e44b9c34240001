"""Files and folders that appear complete or not at all, and JSON.

Everything is written under a temporary name next to its target, `.NAME.PID.new`, and renamed when it is complete. A
folder cannot be replaced in one step, so the last one is moved aside to `.NAME.old` for the moment of the exchange, and
`locate` finds it there. A program that is killed at any moment leaves the last complete output, and at most a
temporary one, which the next write removes.
"""

from __future__ import annotations

import errno
import json
import math
import os
import re
import shutil
import sys
import time
import uuid
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError


def _reasons(*codes: int) -> tuple[tuple[int, str], ...]:
    """Returns the system's errors with their texts, but for those that it has no text for."""
    found = ((code, os.strerror(code)) for code in codes)
    return tuple((code, text) for code, text in found if not text.startswith("Unknown error"))


_FULL = _reasons(errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""What the system reports when there is no room: on the disk, in a quota, or below the limit of a file's size."""

ARRAYS = "arrays.json"
"""File of a saved tree: type and shape of every array by its dotted name, as in "float32 [6, 31]". Saves of earlier
versions lack it."""

MAX_JSON = 64 * 2**20
"""Bytes of the largest JSON file that is read; configurations and notes have some kilobytes."""

ABANDONED = 3600.0
"""Seconds after which the unfinished copy of a folder is that of a program that was killed."""


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Refuses an output that exists; to be called before long work.

    Raises:
        InputError: if the path exists and `overwrite` is not set.
    """
    if not overwrite and locate(Path(path)) is not None:
        raise InputError(path, "output", "exists", "pass overwrite=True to replace it")


def require_suffix(path: Path, suffixes: Collection[str]) -> None:
    """Refuses a file name whose suffix does not match the kind of file; to be called before long work.

    Args:
        path: file to write.
        suffixes: those of the kind, in lower case with their dots; capitals in the name are accepted.

    Raises:
        InputError: for another suffix, or none.
    """
    if path.suffix.lower() not in suffixes:
        rule = f"must be {'one of ' if len(suffixes) > 1 else ''}{', '.join(suffixes)}"
        raise InputError(path, "suffix", path.suffix or "none", rule)


def failure(error: Exception) -> str:
    """Returns why a file could not be read or written, in one line that does not repeat the path."""
    reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
    return reason or type(error).__name__


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """Writes a file or a folder that appears complete or not at all.

    Args:
        target: the path to write; parents are made. An existing one is replaced when the block ends without an error.

    Yields:
        A temporary path next to `target`, at which nothing exists yet. The block writes a file or a folder there.

    Raises:
        InputError: if the disk is full or the target cannot be written; nothing is left of the attempt, and an earlier
            output stays.
    """
    new = target.with_name(f".{target.name}.{os.getpid()}.new")
    try:
        with reporting_disk_errors(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            _remove_stale(target)
            remove(new)
            yield new
            exchange(new, target)
    except BaseException:
        with suppress(OSError):  # what cannot be removed now, because threads still write it, must not hide the reason
            remove(new)
        raise


def copy_once(source: Path, target: Path) -> bool:
    """Copies a folder to a place where it appears complete or not at all; what exists there stays as it is.

    Unlike with `replacing`, several processes may copy at once, also on machines that share a file system: the first to
    finish makes the folder, and what is written into it meanwhile is not lost.

    Args:
        source: a folder; its permissions are not copied, since it may be read-only.
        target: the path to write; parents are made.

    Returns:
        Whether this call has made the folder.

    Raises:
        InputError: if the disk is full; nothing is left of the attempt.
        OSError: if the folder cannot be made for another reason.
    """
    for last in (False, True):
        try:
            return not target.exists() and _copy_into_place(source, target)
        except OSError as error:
            if target.exists():  # another process has made it in the meantime
                return False
            # A process whose clock is an hour ahead has taken the copy for an abandoned one: it is made once more.
            if last or not isinstance(error, FileNotFoundError):
                raise
    raise AssertionError("the last attempt returns or raises")


def _copy_into_place(source: Path, target: Path) -> bool:
    """Copies a folder, and returns True; nothing is left of an attempt that fails."""
    new = target.with_name(f".{target.name}.{uuid.uuid4().hex}.copy")
    try:
        with reporting_full_disk(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            _remove_abandoned(target)
            _copy_files(source, new)
            os.rename(new, target)
    finally:
        remove(new)
    return True


def write_whole(path: Path, content: str | bytes) -> None:
    """Writes a file that appears complete or not at all; text as UTF-8, with line ends unchanged.

    Raises:
        InputError: if it cannot be written; nothing is left behind.
    """
    if not path.parent.is_dir():
        raise InputError(path, "output", "No such file or directory", "its folder must exist")
    with replacing(path) as new:
        new.write_bytes(content.encode() if isinstance(content, str) else content)


def exchange(new: Path, target: Path) -> None:
    """Renames `new` to `target`; at every moment `locate(target)` is a complete output.

    Args:
        new: a complete file or folder next to `target`.
        target: its place; what exists there is removed afterwards.

    Raises:
        OSError: if it cannot be renamed; then what existed stays.
    """
    if not new.is_dir() and not target.is_dir():
        os.replace(new, target)
        return
    old = _old(target)
    if target.exists() or target.is_symlink():
        remove(old)
        os.rename(target, old)
    try:
        os.rename(new, target)
    except OSError:
        if old.exists() or old.is_symlink():
            os.rename(old, target)
        raise
    remove(old)


def undo_exchange(target: Path) -> None:
    """Moves the last complete output back to its place, if a kill has interrupted its replacement.

    Nobody else may be writing it meanwhile.
    """
    if not target.exists() and _old(target).exists():
        os.rename(_old(target), target)


def locate(target: Path) -> Path | None:
    """Returns where the last complete output is: at its own path, moved aside to `.NAME.old`, or None."""
    return next((path for path in (target, _old(target)) if path.exists()), None)


def saved_names(folder: Path) -> tuple[str, ...]:
    """Returns the names of the complete outputs in a folder, sorted; none where the folder does not exist."""
    entries = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
    aside = [name[1:-4] for name in entries if name.startswith(".") and name.endswith(".old")]
    return tuple(sorted({*aside, *(name for name in entries if not name.startswith("."))}))


def remove(path: Path) -> None:
    """Removes a file, a link or a folder with everything in it; nothing happens where the path does not exist."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


@contextmanager
def reporting_full_disk(target: Path) -> Iterator[None]:
    """Turns the system's error on a full disk into an `InputError` that names the target; other errors pass."""
    try:
        yield
    except (OSError, ValueError) as error:
        # Orbax writes through tensorstore, which reports the system's error only as text.
        found = (text for code, text in _FULL if getattr(error, "errno", None) == code or text in str(error))
        if full := next(found, None):
            raise InputError(target, "disk", full, "write aborted; free some disk space") from error
        raise


@contextmanager
def reporting_disk_errors(target: Path) -> Iterator[None]:
    """Turns what the system reports about a file or folder that is being written into an `InputError` that names it.

    Errors that name a file elsewhere pass.
    """
    try:
        with reporting_full_disk(target):
            yield
    except OSError as error:
        elsewhere = error.filename is not None and not _is_near(error.filename, target)
        if isinstance(error, BrokenPipeError) or error.errno is None or elsewhere:
            raise
        rule = "must be writable and the disk have room"
        raise InputError(target, "output", failure(error), rule) from error


def _is_near(path: str | bytes | int, target: Path) -> bool:
    """Returns whether a path is in the folder of a target, or one above it."""
    if isinstance(path, int):
        return False
    place, folder = Path(os.fsdecode(path)).absolute(), target.parent.absolute()
    return place.is_relative_to(folder) or folder.is_relative_to(place)


def write_json(path: Path, data: Mapping[str, Any]) -> None:
    """Writes a mapping as a JSON file, complete or not at all. NaN and infinities become null."""
    with replacing(path) as new:
        new.write_text(json_text(data), encoding="utf-8")


def read_json(path: Path, rule: str) -> dict[str, Any]:
    """Reads a JSON object.

    Args:
        path: the file.
        rule: what the file should be, for messages.

    Raises:
        InputError: if the file does not exist, is too large, not JSON (naming the line) or not an object.
    """
    try:
        if (size := path.stat().st_size) > MAX_JSON:
            raise InputError(path, "size", f"{size} bytes", f"must be at most {MAX_JSON}; {rule}")
        data = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise InputError(path, f"line {error.lineno}", error.msg, rule) from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", getattr(error, "strerror", None) or "not UTF-8 text", rule) from error
    except RecursionError as error:
        raise InputError(path, "file", "nested too deeply", rule) from error
    except InputError:
        raise
    except ValueError as error:  # a whole number of thousands of digits
        raise InputError(path, "file", failure(error)[:80], rule) from error
    if not isinstance(data, dict):
        raise InputError(path, "line 1", type(data).__name__, f"must be a JSON object; {rule}")
    return data


def json_text(value: Any) -> str:
    """Returns the text of a JSON file: `to_plain` of the value, indented, and a final newline.

    Raises:
        TypeError: as `to_plain`.
    """
    return json.dumps(to_plain(value), indent=2, allow_nan=False) + "\n"


def to_plain(value: Any) -> Any:
    """Returns a value as JSON can hold it: arrays as lists, dataclasses as mappings, paths as text, NaN and ∞ as null.

    Raises:
        TypeError: for anything else, naming its type.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if is_dataclass(value) and not isinstance(value, type):
        return to_plain(asdict(value))
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic) or hasattr(value, "__array__"):
        return to_plain(np.asarray(value).tolist())
    raise TypeError(f"JSON cannot hold a {type(value).__name__}.")


def _old(target: Path) -> Path:
    return target.with_name(f".{target.name}.old")


def _remove_stale(target: Path) -> None:
    """Removes temporary outputs of `target` whose process no longer exists."""
    pattern = re.compile(re.escape(f".{target.name}.") + r"(\d+)\.new")
    for entry in target.parent.iterdir():
        found = pattern.fullmatch(entry.name)
        if found is not None and not is_running(int(found[1])):
            remove(entry)


def _remove_abandoned(target: Path) -> None:
    """Removes old unfinished copies of `copy_once`. Their process may belong to another machine, so age decides."""
    for entry in target.parent.glob(f".{target.name}.*.copy"):
        with suppress(FileNotFoundError):  # another process may remove it at the same time
            if time.time() - entry.stat().st_mtime > ABANDONED:
                remove(entry)


def _copy_files(source: Path, new: Path) -> None:
    """Copies a folder's content, without permissions."""
    new.mkdir()
    for path in sorted(source.rglob("*")):
        place = new / path.relative_to(source)
        if path.is_dir():
            place.mkdir()
        else:
            shutil.copyfile(path, place)


def is_running(pid: int) -> bool:
    """Returns whether a process of this machine with this number is running; on Windows always True."""
    if sys.platform == "win32":  # where signal 0 is Ctrl-C
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):
        return True
    return True


def read_note(folder: Path, note_name: str, rule: str) -> dict[str, Any]:
    """Reads the note of the last complete `save_record`; `rule` as in `read_json`."""
    return read_json((locate(folder) or folder) / note_name, rule)
