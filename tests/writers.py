"""Another process that writes a run, for tests of what is refused meanwhile."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

HOLDS = """
import sys
from pfnn_jax.io.locks import writing
with writing(sys.argv[1]):
    print("held", flush=True)
    sys.stdin.read()
"""


@contextmanager
def another_writer(run: Path) -> Iterator[subprocess.Popen]:
    """Starts a process that writes the run until the block ends."""
    command = [sys.executable, "-c", HOLDS, str(run)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdin is not None and process.stdout is not None
        assert process.stdout.readline() == b"held\n"
        yield process
        process.kill()
