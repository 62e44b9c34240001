"""Work in background threads, which do not delay the end of the program."""

from __future__ import annotations

import atexit
import ctypes
import os
import shutil
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, TypeVar

from pfnn_jax.errors import InputError, TrainingError

LONGEST_ERROR = 300
"""Characters shown of an unexpected error."""

M_ARENA_MAX = -8
"""Option of `mallopt`: how many heaps there are at most."""

Result = TypeVar("Result")

_working: set[threading.Thread] = set()
_folders: set[str] = set()
_left = False


def do(work: Callable[[], Result], *, niceness: int = 0) -> Result:
    """Runs work in another thread and waits for it; Ctrl-C ends the waiting at once, but not the work.

    A compilation cannot be interrupted, and Python waits for a thread pool when the program ends.

    Args:
        work: function without arguments.
        niceness: of the thread, on systems whose threads have their own.

    Returns:
        The result of the work.

    Raises:
        Whatever the work raises.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            if niceness and sys.platform == "linux":  # on other systems niceness applies to the whole process
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), niceness)
            results.append(work())
        except BaseException as error:  # raised again below, in the waiting thread
            errors.append(error)
        finally:
            _working.discard(thread)
            done.set()
            release_memory()

    done, thread = threading.Event(), threading.Thread(target=run, name="work", daemon=True)
    _working.add(thread)
    thread.start()
    done.wait()
    if errors:
        raise errors[0]
    return results[0]


def share_heap() -> None:
    """Makes all threads allocate from one heap, with the GNU C library alone; to be called before there are threads.

    It gives threads several heaps, and `release_memory` cannot return the free end of any but the first: with each
    style that is learned some 10 MB more would be kept, up to a gigabyte.
    """
    set_option = _c_function("mallopt")
    if set_option is not None:
        set_option(M_ARENA_MAX, 1)


def release_memory() -> None:
    """Returns free heap memory to the system, with the GNU C library alone, which keeps it by default.

    Compiling allocates much memory temporarily: after the preparation of learning it is a third of the page's.
    """
    trim = _c_function("malloc_trim")
    if trim is not None:
        trim(ctypes.c_size_t(0))


@cache
def _c_function(name: str) -> Any | None:
    """Returns a function of the C library of a Linux system, or None where it has none of this name."""
    if sys.platform != "linux":
        return None
    try:
        return getattr(ctypes.CDLL(None), name, None)
    except OSError:  # a Python without dynamic libraries
        return None


@contextmanager
def shown_errors(show: Callable[[str], None], about: str = "") -> Iterator[None]:
    """Shows the errors of the block on the page: what is refused ends there, what is unexpected is raised again.

    Args:
        show: shows a text.
        about: what an unexpected error concerns, such as a file.
    """
    try:
        yield
    except (InputError, TrainingError) as error:
        show(str(error))
    except Exception as error:
        show(unexpected(error, about))
        raise


def unexpected(error: Exception, about: str = "") -> str:
    """Returns a line for the page on an error that nobody foresaw."""
    return ": ".join(part for part in (about, type(error).__name__, str(error)) if part)[:LONGEST_ERROR]


@contextmanager
def temporary_folder() -> Iterator[str]:
    """Yields a temporary folder, which is removed after the block, or by `leave_work` if the program ends before."""
    with tempfile.TemporaryDirectory() as folder:
        _folders.add(folder)
        try:
            yield folder
        finally:
            _folders.discard(folder)


def leave_work(code: int = 0) -> None:
    """Lets the program end while work is running, after its exit handlers.

    A thread that compiles cannot be stopped, and if it is still compiling while Python shuts down, the process aborts.

    Args:
        code: exit code if work is running then, unless `ends_with` sets another; without work the program's own code
            applies.
    """
    global _left
    _left = True
    atexit.unregister(_end_at_once)
    atexit.register(_end_at_once, code)


@contextmanager
def ends_with() -> Iterator[None]:
    """Makes the exit code of the block replace that of `leave_work`, because later steps of the program can fail."""
    try:
        yield
    except SystemExit as end:
        if _left and isinstance(end.code, int):
            leave_work(end.code)
        raise


def _end_at_once(code: int) -> None:
    if _working:
        sys.stdout.flush()
        sys.stderr.flush()
        for folder in tuple(_folders):
            shutil.rmtree(folder, ignore_errors=True)
        os._exit(code)
