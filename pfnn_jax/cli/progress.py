"""Progress bars on standard error for long work, with loss, frames per second and time left."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    DownloadColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
    TransferSpeedColumn,
)

from pfnn_jax.training.pretraining import Progress as TrainingProgress


def _bar(*columns: ProgressColumn) -> Progress:
    """On standard error, and nothing at all where that is not a terminal."""
    console = Console(stderr=True, log_path=False)
    return Progress(*columns, console=console, disable=not console.is_terminal)


@contextmanager
def training_progress() -> Iterator[Callable[[TrainingProgress], None]]:
    """A bar over training steps."""
    columns = (TextColumn("training"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with _bar(*columns, TextColumn("{task.fields[note]}")) as bar:
        task = bar.add_task("training", total=None, note="compiling")

        def progress_callback(progress: TrainingProgress) -> None:
            note = f"loss {progress.loss:.4f}  {progress.frames_per_second:,.0f} frames/s"
            bar.update(task, total=progress.steps, completed=progress.step, note=note)

        yield progress_callback


@contextmanager
def clip_progress() -> Iterator[Callable[[int, int, str], None]]:
    """A bar over clips."""
    columns = (TextColumn("preparing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with _bar(*columns, TextColumn("{task.fields[note]}")) as bar:
        task = bar.add_task("clips", total=None, note="")
        yield lambda done, total, name: bar.update(task, total=total, completed=done, note=name)


@contextmanager
def frame_progress() -> Iterator[Callable[[int, int], None]]:
    """A bar over a film's frames."""
    with _bar(TextColumn("drawing"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()) as bar:
        task = bar.add_task("frames", total=None)
        yield lambda done, total: bar.update(task, total=total, completed=done)


@contextmanager
def byte_progress() -> Iterator[Callable[[str, int, int], None]]:
    """A bar over bytes for each thing done with them: fetched, verified, unpacked."""
    columns = (TextColumn("{task.description}"), BarColumn(), DownloadColumn(), TransferSpeedColumn())
    with _bar(*columns, TimeRemainingColumn()) as bar:
        tasks: dict[str, TaskID] = {}

        def on_bytes(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage)
            bar.update(tasks[stage], total=total, completed=done)

        yield on_bytes


@contextmanager
def stage_progress() -> Iterator[Callable[[str], None]]:
    """A spinner that names the stage."""
    with _bar(SpinnerColumn(), TextColumn("{task.description}")) as bar:
        task = bar.add_task("starting", total=None)

        def on_stage(stage: str) -> None:
            bar.update(task, description=stage)
            bar.log(stage)

        yield on_stage
