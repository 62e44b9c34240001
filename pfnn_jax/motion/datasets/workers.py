"""Work spread over processes, with results in the order of the tasks.

The processes are plain Python interpreters that import this file and nothing else, fed through pipes. Unlike those of
`multiprocessing`, they never run the caller's script again, so that a script without a `__main__` guard, a notebook and
a test runner may all start them, on every system.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from queue import SimpleQueue
from typing import Any, NamedTuple, TypeVar

from pfnn_jax.errors import InputError

Task = TypeVar("Task")
Result = TypeVar("Result")

AHEAD = 2
"""Tasks begun for each process before the first result is taken: bounds the results that wait in memory."""

TRACEBACK = 1
"""Exit code of an interpreter that an error has ended."""

MOST = 8
"""Processes used where nobody asks for more: beyond, one process writes slower than they compute."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

KEEP_MEMORY = {
    "MALLOC_MMAP_THRESHOLD_": str(2**30),
    "MALLOC_TRIM_THRESHOLD_": str(2**32),
    "MALLOC_TOP_PAD_": str(2**26),
}
"""For glibc: memory of one array serves the next instead of going back to the system, a tenth of the time."""

PIPE = 2**20
"""Bytes on their way between processes, where the system lets us choose."""


def map_in_order(
    function: Callable[[Task], Result], tasks: Iterable[Task], workers: int
) -> Generator[Result, None, None]:
    """The function's result for each task, in the order of the tasks.

    Args:
        function: at the top of a module that can be imported.
        tasks: that can be pickled; taken as they are needed.
        workers: processes; 1 works in this one.

    Raises:
        InputError: as the function raises it; or if a process ended, as for want of memory.
        RuntimeError: for another error of the function in a process, which has printed its traceback.
    """
    if workers <= 1:
        yield from map(function, tasks)
        return
    processes = [_Process() for _ in range(workers)]
    idle: SimpleQueue[_Process] = SimpleQueue()
    for process in processes:
        idle.put(process)

    def call(task: Task) -> Result:
        process = idle.get()
        try:
            return process.call(function, task)
        finally:
            idle.put(process)

    threads = ThreadPoolExecutor(workers)
    waiting: deque[Future[Result]] = deque()
    try:
        for task in tasks:
            waiting.append(threads.submit(call, task))
            if len(waiting) >= AHEAD * workers:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        for future in waiting:
            future.cancel()
        for process in processes:
            process.kill()
        threads.shutdown()
        for process in processes:
            process.close()


def default_workers() -> int:
    """The processors this process may use, at most `MOST`."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(usable, MOST)


class _Refusal(NamedTuple):
    """An `InputError` on its way between processes."""

    file: str
    place: str
    value: str
    rule: str


class _Process:
    """One interpreter that answers calls until its input ends."""

    def __init__(self) -> None:
        command = f"from {__name__} import serve; serve()"
        paths = os.pathsep.join(path for path in (*sys.path, os.getcwd()) if path)
        self._popen = subprocess.Popen(
            [sys.executable, "-c", command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env={**os.environ, **ONE_THREAD, **KEEP_MEMORY, "PYTHONPATH": paths},
            pipesize=PIPE,
        )

    def call(self, function: Callable[[Task], Result], task: Task) -> Result:
        assert self._popen.stdin is not None and self._popen.stdout is not None
        try:
            pickle.dump((function, task), self._popen.stdin, pickle.HIGHEST_PROTOCOL)
            self._popen.stdin.flush()
            answer = pickle.load(self._popen.stdout)
        except (OSError, EOFError, pickle.UnpicklingError) as error:
            raise self._ended() from error
        if isinstance(answer, _Refusal):
            raise InputError(*answer)
        return answer

    def kill(self) -> None:
        """Ends whatever it does."""
        self._popen.kill()

    def close(self) -> None:
        """Waits for its end and frees its pipes."""
        self._popen.communicate()

    def _ended(self) -> Exception:
        code = self._popen.wait()
        if code == TRACEBACK:
            return RuntimeError("a process failed; its traceback stands above")
        rule = "it must live until its work is done; fewer workers need less memory"
        return InputError("workers", "process", f"ended with code {code}", rule)


def serve() -> None:
    """Answers the calls on standard input, one after another, until it ends."""
    calls, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # what a library prints must not come between answers
    try:
        while True:
            function, task = pickle.load(calls)
            pickle.dump(_answer(function, task), answers, pickle.HIGHEST_PROTOCOL)
            answers.flush()
    except (EOFError, KeyboardInterrupt):
        return


def _answer(function: Callable[[Any], Any], task: Any) -> Any:
    try:
        return function(task)
    except InputError as error:
        return _Refusal(error.file, error.place, str(error.value), error.rule)
