"""Progress of long work on standard error: a bar on a terminal, a line for every tenth of the work elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

LINES = 10
"""Lines that describe a whole piece of work where there is no terminal."""


class Report(Protocol):
    """Reports how much of the work is done; `total` is in the same unit as `done`."""

    def __call__(self, done: float, total: float, note: str = "", /) -> None: ...


@contextmanager
def progress(work: str, *, in_bytes: bool = False) -> Iterator[Report]:
    """Shows the progress of one piece of work.

    Args:
        work: what is being done, such as "training".
        in_bytes: the amounts are bytes, and are shown with their rate.
    """
    if sys.stderr.isatty():
        with _bar(work, in_bytes) as report:
            yield report
    else:
        yield _lines(work)


@contextmanager
def stages(work: str) -> Iterator[Callable[[str], None]]:
    """Shows the stages of work whose length is not known in advance: a spinner, or one line for each stage."""
    if not sys.stderr.isatty():
        yield lambda stage: print(f"{work}: {stage}", file=sys.stderr, flush=True)
        return
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    with Progress(SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), console=_console()) as bar:
        task = bar.add_task(work)
        yield lambda stage: bar.update(task, description=f"{work}: {stage}")


def _console():
    from rich.console import Console

    return Console(stderr=True)


@contextmanager
def _bar(work: str, in_bytes: bool) -> Iterator[Report]:
    from rich import progress as rich

    amounts = (rich.DownloadColumn(), rich.TransferSpeedColumn()) if in_bytes else (rich.TaskProgressColumn(),)
    columns = (rich.TextColumn("{task.description}"), rich.BarColumn(), *amounts, rich.TimeRemainingColumn())
    with rich.Progress(*columns, rich.TextColumn("{task.fields[note]}"), console=_console()) as bar:
        task = bar.add_task(work, total=None, note="")

        def report(done: float, total: float, note: str = "", /) -> None:
            bar.update(task, total=total, completed=done, note=note)

        yield report


def _lines(work: str) -> Report:
    """Returns a report that prints a line whenever another tenth is done."""
    begun, printed = time.monotonic(), 0

    def report(done: float, total: float, note: str = "", /) -> None:
        nonlocal begun, printed
        tenths = int(LINES * done / total) if total else 0
        if tenths < printed:  # the next stage
            begun, printed = time.monotonic(), 0
        if tenths <= printed:
            return
        printed = tenths
        left = (time.monotonic() - begun) * (total - done) / done
        remaining = f", {left:.0f} s left" if done < total else ""
        print(f"{work}: {100 * tenths // LINES} %{remaining}{note and f', {note}'}", file=sys.stderr, flush=True)

    return report
