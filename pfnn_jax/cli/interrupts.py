"""Ctrl-C: one line, and the process ends at once with exit code 130, also while XLA compiles.

Python runs signal handlers between two bytecodes of the main thread. A compilation would delay them by many seconds; an
exception that they raise can be swallowed by a callback of the garbage collector; and an interpreter that shuts down
under a compiling thread ends in a segmentation fault. Therefore a thread waits for the signal, gives the main thread a
moment to remove its temporary files, and ends the process without shutting the interpreter down.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

CODE = 130
"""Exit code of an interrupted command: 128 + SIGINT, as shells count."""

MESSAGE = "pfnn-jax: interrupted\n"

GRACE = 0.5
"""Seconds in which the main thread may remove temporary files. A second Ctrl-C ends the process without them."""

POLL = 0.001
"""Seconds between two looks at whether the line is printed."""

_interrupted = threading.Event()
_announcing = threading.Lock()


@contextmanager
def ends_on_interrupt(*, process: bool) -> Iterator[None]:
    """Ends the block with exit code 130 on Ctrl-C.

    Args:
        process: end the whole process, at once. Otherwise, or where another handler of Ctrl-C is installed already, a
            `KeyboardInterrupt` becomes `SystemExit(130)`.
    """
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not process or not usual or threading.current_thread() is not threading.main_thread():
        with _exit_code():
            yield
        return
    reader, writer = socket.socketpair()
    writer.setblocking(False)
    signal.signal(signal.SIGINT, _handle)
    signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(reader,), name="interrupts", daemon=True).start()
    try:
        yield
    except KeyboardInterrupt:
        _announce()
    finally:
        if _interrupted.is_set():  # also where the interrupt came out of a library as another error
            _end()
        release()
        writer.close()


def release() -> None:
    """Restores Python's own handling of Ctrl-C, for a command that ends by itself when it is interrupted."""
    if signal.getsignal(signal.SIGINT) is _handle:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def _exit_code() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        sys.stderr.write(MESSAGE)
        raise SystemExit(CODE) from None


def _handle(number: int, frame: FrameType | None) -> NoReturn:
    """Interrupts the main thread, once it runs Python again and the watching thread has printed the line.

    Takes no lock: a second signal may interrupt this handler, or the main thread while it holds one.
    """
    for _ in range(round(GRACE / POLL)):
        if _interrupted.is_set():
            break
        time.sleep(POLL)
    raise KeyboardInterrupt


def _watch(reader: socket.socket) -> None:
    """Waits for the bytes that Python writes for each signal, as soon as it arrives."""
    while number := reader.recv(1):
        if number[0] == signal.SIGINT:
            _announce()
            reader.settimeout(GRACE)
            try:
                reader.recv(1)  # a second Ctrl-C
            except TimeoutError:
                pass
            _end()


def _announce() -> None:
    """Prints the one line, after which nothing more reaches standard error: errors that follow are consequences."""
    with _announcing:
        if _interrupted.is_set():
            return
        clear = "\r\x1b[2K\x1b[?25h" if os.isatty(2) else ""  # a progress bar, which hides the cursor
        os.write(2, (clear + MESSAGE).encode())
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        _interrupted.set()


def _end() -> NoReturn:
    for worker in multiprocessing.active_children():
        worker.kill()
    flushing = threading.Thread(target=sys.stdout.flush, daemon=True)  # the main thread may be blocked in a write
    flushing.start()
    flushing.join(0.2)
    os._exit(CODE)
