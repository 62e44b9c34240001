"""One process at a time writes a run: a lock that the system releases when its process ends, however it ends.

The lock is a file next to the run, `.NAME.lock`, so that it stays in place while the run's folder is replaced. Where
that folder cannot be written, as next to a mounted volume, the run itself cannot be replaced either, and the file is in
it. Who holds the lock is written into the file, for messages only: what counts is the system's lock on it. A process
that is killed leaves the file without the lock, and the next one takes it over; no age and no process number is
compared, so neither a clock that jumps nor a number that is used again can block a run.

File systems without locks (some network ones) report so, and nothing is locked there.
"""

from __future__ import annotations

import errno
import os
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure, reporting_full_disk, undo_exchange

RULE = "must be written by one process at a time: wait until that one has ended"

_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP)  # the last two differ on macOS

_NOT_WRITABLE = (errno.EACCES, errno.EPERM, errno.EROFS)

_NO_LINKS = getattr(os, "O_NOFOLLOW", 0)  # what a link points to would be emptied


@dataclass(eq=False)
class _Held:
    """A lock of this process; threads of one process do not exclude each other, and are counted."""

    process: int
    descriptor: int
    path: Path
    count: int = 0


_held: dict[Path, _Held] = {}
_entering = threading.Lock()


@contextmanager
def writing(run: str | Path) -> Iterator[None]:
    """Keeps other processes from writing a run during the block; blocks may be nested, in any threads of a process.

    A run that was moved aside by a process that was killed while it replaced the run is moved back.

    Args:
        run: its directory, which need not exist; parents are made.

    Raises:
        InputError: if another process is writing it, naming that process and its machine; if no lock file can be made.
    """
    target = Path(run).resolve()
    with _entering:
        held = _held.get(target)
        if held is None or held.process != os.getpid():  # a forked process has a copy of this record, not the lock
            held = _held[target] = _take(target, Path(run))
            with suppress(OSError):  # what cannot be renamed cannot be written either, which is reported then
                undo_exchange(target)
        held.count += 1
    try:
        yield
    finally:
        with _entering:
            held.count -= 1
            if not held.count and held.process == os.getpid():
                del _held[target]
                _release(held)


def writer_of(run: str | Path) -> str | None:
    """Returns the other process that is writing a run, as "process NUMBER on MACHINE", or None."""
    target = Path(run).resolve()
    held = _held.get(target)
    if held is not None and held.process == os.getpid():
        return None
    for path in _places(target):
        try:
            descriptor = _open_file(path)
        except OSError:
            continue
        try:
            if not _lock(descriptor):
                return _holder(descriptor)
        except OSError:
            continue
        finally:
            os.close(descriptor)
    return None


def _places(target: Path) -> tuple[Path, Path]:
    """Returns the paths of a run's lock file: next to it, and in it."""
    return target.with_name(f".{target.name}.lock"), target / ".lock"


def _take(target: Path, run: Path) -> _Held:
    """Returns the lock, taken.

    Raises:
        InputError: as `writing`.
    """
    while True:
        path, descriptor = _open(target, run)
        try:
            taken = _lock(descriptor)
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise InputError(path, "lock", failure(error), "must be on a file system that works") from error
            taken = True
        if not taken:
            holder = _holder(descriptor)
            os.close(descriptor)
            raise InputError(run, "run", f"is being written by {holder}", RULE)
        if _is_at(descriptor, path):
            with suppress(OSError):  # on a full disk the lock has no text, and still holds
                os.ftruncate(descriptor, 0)
                os.lseek(descriptor, 0, os.SEEK_SET)
                os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
            return _Held(os.getpid(), descriptor, path)
        os.close(descriptor)  # its holder has removed it between our opening and locking it


def _open(target: Path, run: Path) -> tuple[Path, int]:
    """Opens the lock file: next to the run, or in it where its folder cannot be written."""
    outside, inside = _places(target)
    try:
        with reporting_full_disk(run):
            target.parent.mkdir(parents=True, exist_ok=True)
            try:
                return outside, _open_file(outside, os.O_CREAT)
            except OSError as error:
                if error.errno not in _NOT_WRITABLE or not target.is_dir() or os.path.lexists(outside):
                    raise
                return inside, _open_file(inside, os.O_CREAT)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise InputError(error.filename, "lock", "is a link", "must be a file: remove the link") from error
        raise InputError(run, "folder", failure(error), "must be writable: runs are written in it") from error


def _open_file(path: Path, flags: int = 0) -> int:
    """Opens a lock file; that of another user can be locked, if not written.

    Raises:
        OSError: if it is a link, cannot be read, or does not exist and cannot be made.
    """
    try:
        return os.open(path, os.O_RDWR | _NO_LINKS | flags, 0o666)
    except OSError as error:
        if error.errno in _NOT_WRITABLE:
            with suppress(FileNotFoundError):  # it is the folder that cannot be written
                return os.open(path, os.O_RDONLY | _NO_LINKS)
        raise


def _release(held: _Held) -> None:
    with suppress(OSError):  # removed before it is unlocked: nobody can take a file that is about to go
        held.path.unlink()
    os.close(held.descriptor)
    with suppress(OSError):  # Windows removes no open file
        if sys.platform == "win32":
            held.path.unlink()


def _is_at(descriptor: int, path: Path) -> bool:
    """Returns whether an open file is still the one at its path."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.stat())
    except FileNotFoundError:
        return False


def _holder(descriptor: int) -> str:
    """Returns who holds a lock; it may not have written its text yet."""
    os.lseek(descriptor, 0, os.SEEK_SET)
    text = os.read(descriptor, 300).decode("utf-8", "replace").strip()
    return text.partition("\n")[0] if text.startswith("process ") else "another process"


if sys.platform == "win32":
    import msvcrt

    _FAR = 2**30  # a byte that nobody reads: a locked one cannot be read by others

    def _lock(descriptor: int) -> bool:
        """Locks an open file; returns whether that succeeded."""
        os.lseek(descriptor, _FAR, os.SEEK_SET)
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
else:
    import fcntl

    def _lock(descriptor: int) -> bool:
        """Locks an open file; returns whether that succeeded.

        Raises:
            OSError: where the file system has no locks.
        """
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
