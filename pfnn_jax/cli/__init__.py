"""The command `pfnn-jax`: parsing, and one function call for each sub-command."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager


def main(args: Sequence[str] | None = None) -> None:
    """Runs a command line.

    Bad input ends with one line on standard error and exit code 2; so do words that are no command line, with tyro's
    own explanation, of several lines. Ctrl-C ends in 130.
    """
    try:
        with _ended_by_interrupts():
            from pfnn_jax.cli.command_line import run  # seconds, for libraries are loaded
            from pfnn_jax.viewer.page.background import ends_with
        with ends_with():
            run(args)
    except KeyboardInterrupt:
        print("pfnn-jax: interrupted", file=sys.stderr)
        raise SystemExit(130) from None


@contextmanager
def _ended_by_interrupts() -> Iterator[None]:
    """Meanwhile Ctrl-C ends the process: raised while a library is loaded, it comes out as an error of that library."""
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
