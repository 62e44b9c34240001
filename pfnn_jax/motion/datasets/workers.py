"""Spreads work over processes, with results in the order of the tasks.

The processes are loky's. Unlike those of `multiprocessing`, they never run the caller's script again, so that a script
without a `__main__` guard, a notebook and a test runner may all start them; and when one of them dies, the caller gets
an error instead of waiting for ever.
"""

from __future__ import annotations

import os
import re
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterable
from typing import TypeVar

from pfnn_jax.errors import InputError

Task = TypeVar("Task")
Result = TypeVar("Result")

LOOKAHEAD = 2
"""Tasks submitted per process ahead of the result that is awaited: bounds the results held in memory."""

MAX_WORKERS = 8
"""Default limit on processes: with more, computing is faster than the one process that writes."""

IDLE_SECONDS = 60.0
"""A process without work ends after this time, so that none outlives a parent that was killed."""

ENVIRONMENT = {
    **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    # glibc: keep freed memory for the next array instead of returning it to the system, which takes a tenth of the time
    "MALLOC_MMAP_THRESHOLD_": str(2**30),
    "MALLOC_TRIM_THRESHOLD_": str(2**32),
    "MALLOC_TOP_PAD_": str(2**26),
}


def map_in_order(
    function: Callable[[Task], Result], tasks: Iterable[Task], workers: int
) -> Generator[Result, None, None]:
    """Yields the function's result for each task, in the order of the tasks.

    All processes have ended when the generator has, also when it is closed early or interrupted.

    Args:
        function: applied to each task; it and its results must be picklable.
        tasks: picklable; taken as they are needed.
        workers: number of processes; 1 works in this one.

    Raises:
        InputError: if a process dies, for example because memory runs out.
        Exception: whatever the function raises.
    """
    if workers <= 1:
        yield from map(function, tasks)
        return
    from loky import ProcessPoolExecutor  # here, because one process needs none of it
    from loky.process_executor import TerminatedWorkerError

    executor = ProcessPoolExecutor(workers, timeout=IDLE_SECONDS, initializer=_ignore_interrupts, env=ENVIRONMENT)
    waiting = deque()
    try:
        for task in tasks:
            waiting.append(executor.submit(function, task))
            if len(waiting) >= LOOKAHEAD * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except TerminatedWorkerError as error:
        codes = re.search(r"\{(.*)\}", str(error))
        value = f"worker died (exit code {codes[1] if codes else 'unknown'})"
        raise InputError("workers", "process", value, "probably out of memory; use fewer workers") from error
    finally:
        executor.shutdown(kill_workers=True)


def default_workers() -> int:
    """Returns the number of processors this process may use, at most `MAX_WORKERS`."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, MAX_WORKERS)


def _ignore_interrupts() -> None:
    """Leaves Ctrl-C, which the terminal sends to all processes, to the parent, which ends its workers."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
