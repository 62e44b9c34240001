"""Processes that train together, for tests."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

LONGEST = 600
"""Seconds that a process may take, on a machine with much else to do."""


def free_port() -> int:
    """Returns a port of this machine on which nothing listens."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def start(*arguments: object) -> subprocess.Popen[str]:
    """Starts Python on CPUs with these arguments, in the root of the repository."""
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    program = [sys.executable, *map(str, arguments)]
    return subprocess.Popen(
        program, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def outputs(processes: Sequence[subprocess.Popen[str]]) -> list[str]:
    """Waits for processes that train together, and returns what each has printed; all must succeed, none is left."""
    try:
        ended = [process.communicate(timeout=LONGEST) for process in processes]
    finally:
        for process in processes:
            process.kill()
    assert [process.returncode for process in processes] == [0] * len(processes), ended
    return [output for output, _ in ended]
