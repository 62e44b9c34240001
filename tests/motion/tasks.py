"""Tasks for worker processes, which import this file and little else."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from pfnn_jax.errors import InputError


def invert(value: int) -> float:
    """Returns 1 / value.

    Raises:
        InputError: for even numbers.
        KeyError: for 9.
    """
    if value == 9:
        raise KeyError(value)
    if value % 2 == 0:
        raise InputError("numbers", "value", value, "must be odd")
    print("output of a task")
    return 1 / value


def die(code: int) -> None:
    """Ends its process: with an exit code, or by a signal for a negative one."""
    if code < 0:
        os.kill(os.getpid(), -code)
    os._exit(code)


def note_and_sleep(folder: Path) -> None:
    """Writes its process id as the name of a file, and sleeps for longer than any test runs."""
    (folder / str(os.getpid())).touch()
    time.sleep(600)


KILL = -signal.SIGKILL
