"""A closed pipe, as in `pfnn-jax --help | head`: the program ends quietly, as other programs do."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

CODE = 141
"""Exit code of a program whose reader is gone: 128 + SIGPIPE, as shells count."""


@contextmanager
def ends_on_closed_pipe() -> Iterator[None]:
    """Ends the block with exit code 141 if standard output is a pipe that nobody reads any more."""
    try:
        try:
            yield
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # what is left in the buffer must not fail again when the interpreter shuts down
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(CODE) from None
