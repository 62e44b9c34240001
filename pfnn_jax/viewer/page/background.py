"""Work beside a page: in threads of their own, for which the end of the program does not wait."""

from __future__ import annotations

import atexit
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

Result = TypeVar("Result")

_working: set[threading.Thread] = set()
_left = False


def do(work: Callable[[], Result], *, niceness: int = 0) -> Result:
    """Does the work in another thread and waits for it; Ctrl-C ends the waiting at once, though not the work.

    A compilation cannot be interrupted, and a thread pool would be waited for when the program ends.

    Args:
        work: what to do.
        niceness: how far it stands back behind other threads, where the system lets threads differ.

    Returns:
        What the work returns, or raises what it raises.
    """
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            if niceness and sys.platform == "linux":  # elsewhere niceness is of the whole process
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), niceness)
            results.append(work())
        except BaseException as error:  # raised again below, where the work is waited for
            errors.append(error)
        finally:
            _working.discard(thread)
            done.set()

    done, thread = threading.Event(), threading.Thread(target=run, name="work", daemon=True)
    _working.add(thread)
    thread.start()
    done.wait()
    if errors:
        raise errors[0]
    return results[0]


def leave_work(code: int = 0) -> None:
    """Lets the program end although work is going on, once its other parts have ended.

    A thread that compiles cannot be stopped, and one that still does when Python is taken down aborts the process.

    Args:
        code: with which the program ends if work is going on then, unless `ends_with` knows better; without work its
            own counts.
    """
    global _left
    _left = True
    atexit.unregister(_end_at_once)
    atexit.register(_end_at_once, code)


@contextmanager
def ends_with() -> Iterator[None]:
    """The block ends the program: its exit code goes before that of `leave_work`, as what came last may fail."""
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
        os._exit(code)
