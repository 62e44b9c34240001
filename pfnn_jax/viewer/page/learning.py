"""What is being learned on the page, and what was learned last: shared by all tabs, and there after a reload."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from pfnn_jax.errors import InputError

if TYPE_CHECKING:
    from pfnn_jax.viewer.page.uploads import LearnedUpload

USUAL_SECONDS = 40.0
"""Seconds that learning takes on two cores, for the first style of a session; later ones as long as the one before."""

TRUSTED = 0.15
"""Share that must be done before its speed says how long the rest takes."""

MOST_JOBS = 8
"""Styles that are learned or wait for it; more are refused, because each holds its clip in memory and a thread."""

SHOWN = 600.0
"""Seconds for which a result is shown in tabs that are opened later."""


@dataclass(eq=False)
class Job:
    """A style that is being learned.

    Attributes:
        run: that learns it.
        name: of the style, as far as it is known.
        began: seconds of the board's clock.
        share: 0 to 1, the part that is done.
        waiting: whether another style is learned first.
    """

    run: str
    name: str
    began: float
    share: float = 0.0
    waiting: bool = False


@dataclass(frozen=True)
class Outcome:
    """The end of a job.

    Attributes:
        number: counts the outcomes, from 1.
        run, name: as in the job.
        learned: the style, or None if it could not be learned.
        error: why it could not be learned.
        ended: seconds of the board's clock.
    """

    number: int
    run: str
    name: str
    learned: LearnedUpload | None
    error: str
    ended: float


@dataclass(eq=False)
class LearningBoard:
    """The jobs that are running and the last outcome. Safe to use from several threads.

    Args:
        clock: returns seconds.
    """

    clock: Callable[[], float] = time.monotonic
    _jobs: list[Job] = field(default_factory=list)
    _outcome: Outcome | None = None
    _seconds: float = USUAL_SECONDS
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def begin(self, run: str, name: str) -> Job:
        """Notes that a style is being learned.

        Raises:
            InputError: if `MOST_JOBS` are already.
        """
        job = Job(run, name, self.clock())
        with self._lock:
            if len(self._jobs) >= MOST_JOBS:
                raise InputError(
                    name, "learning", f"{MOST_JOBS} clips are being learned or waiting", "try this one again later"
                )
            self._jobs.append(job)
        return job

    def report(self, job: Job, share: float, waiting: bool) -> None:
        """Notes how far a job is; callable from any thread."""
        if job.waiting and not waiting:
            job.began = self.clock()
        job.share, job.waiting = min(max(share, 0.0), 1.0), waiting

    def end(self, job: Job, learned: LearnedUpload | None = None, error: str = "") -> None:
        """Notes the outcome of a job; with neither a style nor an error it ends without one."""
        with self._lock:
            self._jobs.remove(job)
            now = self.clock()
            if learned is not None:
                self._seconds = now - job.began
            if learned is not None or error:
                number = 1 if self._outcome is None else self._outcome.number + 1
                self._outcome = Outcome(number, job.run, job.name, learned, error, now)

    def jobs(self) -> tuple[tuple[Job, float], ...]:
        """Returns the running jobs, each with the seconds that it probably still takes."""
        with self._lock:
            return tuple((job, self._left(job)) for job in self._jobs)

    def outcome(self) -> Outcome | None:
        """Returns the last outcome, unless it is too old to be shown."""
        with self._lock:
            found = self._outcome
            return found if found is not None and self.clock() - found.ended < SHOWN else None

    def _left(self, job: Job) -> float:
        elapsed = self.clock() - job.began
        if job.waiting or job.share < TRUSTED:
            return max(self._seconds - elapsed, 1.0)
        return max(elapsed * (1.0 - job.share) / job.share, 1.0)
