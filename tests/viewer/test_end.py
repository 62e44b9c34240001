"""The end of the page's program: at once, whatever is being compiled, and without a word of complaint."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

AT_ONCE = 3.0  # seconds
PROGRAM = "from pfnn_jax.cli import main; main()"


@pytest.mark.skipif(os.name != "posix", reason="other systems have no such signals")
def test_a_signal_ends_the_page_while_it_compiles(played_run, tmp_path: Path):
    pytest.importorskip("viser", reason="viser is not installed")
    told = tmp_path / "told.json"
    command = [sys.executable, "-c", PROGRAM, "play", str(played_run), "--port", "0", "--json", str(told)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as program:
        assert program.stdout is not None
        for line in program.stdout:
            if "compiling" in line:
                break
        time.sleep(0.5)
        before = time.monotonic()
        program.send_signal(signal.SIGTERM)
        rest = program.stdout.read()
        code = program.wait(AT_ONCE)
    assert time.monotonic() - before < AT_ONCE
    assert (code, rest) == (0, "Ended.\n")
    assert json.loads(told.read_text()) == {"runs": [str(played_run)]}
