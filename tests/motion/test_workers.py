"""Work in several processes: results in order, errors passed on, and no process left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest

from pfnn_jax.motion.datasets.workers import map_in_order
from tests.motion.tasks import KILL, die, invert
from tests.raising import assert_refused

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("workers", [1, 2])
def test_results_are_in_the_order_of_the_tasks(workers):
    assert list(map_in_order(invert, [1, 3, 5, 7] * 5, workers)) == [1, 1 / 3, 1 / 5, 1 / 7] * 5


@pytest.mark.parametrize("workers", [1, 2])
def test_errors_of_a_task_are_raised_in_their_order(workers):
    results = map_in_order(invert, [1, 2, 3], workers)
    assert next(results) == 1
    assert_refused(partial(next, results), file="numbers", place="value", value=2, rule_mentions="must be odd")
    with pytest.raises(KeyError, match="9"):
        list(map_in_order(invert, [9], 2))


@pytest.mark.parametrize("code", [5, KILL])
def test_a_worker_that_dies_is_refused_in_one_line(code):
    call = partial(next, map_in_order(die, [code, code], 2))
    error = assert_refused(call, place="process", rule_mentions="use fewer workers")
    assert str(code) in str(error.value)


def running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


SCRIPT = """
import sys
from pathlib import Path
from pfnn_jax.motion.datasets.workers import map_in_order
from tests.motion.tasks import note_and_sleep
list(map_in_order(note_and_sleep, [Path(sys.argv[1])] * 2, 2))
"""


def test_an_interrupt_ends_all_workers(tmp_path):
    command = [sys.executable, "-c", SCRIPT, str(tmp_path)]
    script = subprocess.Popen(command, cwd=ROOT, start_new_session=True, stderr=subprocess.PIPE, text=True)
    workers: list[int] = []
    for _ in range(600):
        workers = [int(path.name) for path in tmp_path.iterdir()]
        if len(workers) == 2:
            break
        time.sleep(0.1)
    assert len(workers) == 2
    os.killpg(script.pid, signal.SIGINT)  # as a terminal does on Ctrl-C
    _, printed = script.communicate(timeout=60)
    assert "KeyboardInterrupt" in printed and printed.count("Traceback") == 1
    assert not any(map(running, workers))
