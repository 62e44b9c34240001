"""The page, served by a process with a home of its own, so that an experiment decides what is kept there."""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import psutil

from pfnn_jax.io.compilation_cache import LOG_LEVEL, VARIABLE

HOST = "127.0.0.1"

STARTING = 600.0
"""Seconds within which the page must have loaded its runs, on a busy machine."""

OPEN, LOADED = r"page is open at http://[^:]+:(\d+)", r"styles at http://[^:]+:(\d+)"
"""What the page prints with its port: once it can be opened, and once its characters can walk."""


HELD = "held.json"
"""File of what a watched page's memory holds; see `watched_page`."""


@contextlib.contextmanager
def serving(
    runs: Sequence[str], out: Path, until: str = LOADED, *, watched: bool = False
) -> Iterator[tuple[psutil.Process, int]]:
    """Runs the page in a process; yields it and its port once it has printed a line.

    Args:
        runs: arguments of `pfnn-jax play`; none for the base network.
        out: folder of the server's home and of its output, `server.log`. What an earlier one has kept there is used.
        until: the line.
        watched: whether the process notes what its memory holds in the file `held.json`.

    Raises:
        RuntimeError: if the process ends, or the line does not come.
    """
    home = out / "home"
    (home / "tmp").mkdir(parents=True, exist_ok=True)
    dropped = (VARIABLE, "JAX_ENABLE_COMPILATION_CACHE", LOG_LEVEL)  # JAX sets the last when it is imported
    kept = {name: value for name, value in os.environ.items() if name not in dropped}
    own = {"HOME": home, "XDG_CACHE_HOME": home / "cache", "XDG_DATA_HOME": home / "data", "TMPDIR": home / "tmp"}
    alone = ["-c", "from pfnn_jax.cli import main; main()"]
    program = ["-m", "experiments.common.watched_page", str(out / HELD)] if watched else alone
    words = [sys.executable, "-u", *program, "play", *runs, "--port", "0"]
    with (out / "server.log").open("w") as log:
        server = subprocess.Popen(
            words, stdout=log, stderr=subprocess.STDOUT, env={**kept, **{k: str(v) for k, v in own.items()}}
        )
        try:
            yield psutil.Process(server.pid), port_of(out / "server.log", server, until)
        finally:
            server.kill()
            server.wait()


def processor_time(process: psutil.Process) -> float:
    """Returns the processor time of a process in seconds."""
    return sum(process.cpu_times()[:2])


def port_of(log: Path, server: subprocess.Popen[Any], until: str = LOADED) -> int:
    """Returns the port of a page once it has printed a line.

    Raises:
        RuntimeError: if it ends, or the line does not come.
    """
    began = time.monotonic()
    while time.monotonic() - began < STARTING and server.poll() is None:
        found = re.search(until, log.read_text())
        if found:
            return int(found[1])
        time.sleep(0.02)
    raise RuntimeError(f"the page does not start: {log.read_text()}")
