"""A clip dropped on the page becomes a style: checked, kept in the run's folder, learned, and taken on stage.

What a browser sends is bytes and a name. The bytes are read as the text of a BVH file and as nothing else; the name
becomes the name of a style and of a file in RUN/uploads/, whatever was in it. When anything is wrong, the run's folder
is left as it was.
"""

from __future__ import annotations

import os
import re
import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import write_whole
from pfnn_jax.motion.datasets.sources import ClipFile, is_symmetric
from pfnn_jax.run import Run, list_styles
from pfnn_jax.training.few_shot import FILM, FewShotConfig
from pfnn_jax.viewer.page import background
from pfnn_jax.viewer.page.stage import Cast, Stage, rehearse_walks
from pfnn_jax.workflows.learn import learn_style, rehearse

MOST_BYTES = 10_000_000
"""Size of the largest file taken."""

MOST_JOINTS = 200
MOST_FRAMES = 20_000
LONGEST = 60.0
"""Seconds of the longest clip: what is learned from longer ones is better learned by `pfnn-jax few-shot`."""

LONGEST_NAME = 40
"""Characters of a style's name that are taken from the file's."""

NICENESS = 10
"""How far learning stands back behind the characters that move meanwhile, where the system lets threads differ."""

QUICK_FILM = replace(FILM, learning_rates=(3e-3, 1e-2), stops=(25, 50))
"""Films on a page: higher rates than `FILM` and half its epochs, for the same errors on held-out frames."""

Progress = Callable[[float, str], None]

_learning = threading.Lock()  # one at a time: two would both take twice as long
_unfinished: set[Path] = set()


class GivenUp(Exception):
    """The page ends while a style is being learned."""


def page_config(run: Run) -> FewShotConfig:
    """How a style is learned on the page: of the kind of the run's styles, by few-shot's own settings for adapters."""
    adapter = run.config.adapter
    return QUICK_FILM if adapter.kind == "film" else FewShotConfig(adapter.kind, adapter.rank)


def prepare_learning(stage: Stage, run: str) -> None:
    """Compiles what learning needs, in the background of a page that has just been opened; see `rehearse`.

    An upload goes first, and waits for the preparation of its own run alone.
    """
    with _learning:
        pass
    cast = stage.cast(run)
    with stage.preparation(run):
        background.do(partial(rehearse, cast.run, page_config(cast.run)), niceness=NICENESS)
        background.do(partial(rehearse_walks, cast.controller), niceness=NICENESS)


def give_up(stage: Stage, wait: float = 0.5) -> None:
    """Leaves out what is being learned, for the page ends: the runs' folders are as if it had never been begun.

    Args:
        stage: where it is learned; nothing can be learned there any more.
        wait: seconds for which it may take notice, before only its traces are removed.
    """
    stage.ended.set()
    if _learning.acquire(timeout=wait):
        _learning.release()
    for path in tuple(_unfinished):
        _remove(path)


def learn_upload(
    stage: Stage, run: str, filename: str, data: bytes, progress: Progress = lambda share, what: None
) -> str:
    """Learns a style from an uploaded BVH file; characters can choose it when this returns.

    The style is that of `pfnn-jax few-shot` with the same settings (`page_config`). It is saved in RUN/styles/ and its
    clip in RUN/uploads/, both under the file's name, with a number where that is taken. One style is learned at a
    time; others wait.

    Args:
        stage: where the run is played.
        run: its name there.
        filename: as the browser tells it.
        data: the file's bytes.
        progress: told the share that is done, 0 to 1, and what is being done, from another thread.

    Returns:
        The style's name.

    Raises:
        InputError: for an unknown run; for a file that is too large, no text, no BVH, of too many joints or frames, too
            short or long, without steps where the run needs them, or of another skeleton; for a run's folder that
            cannot be written to. Then nothing has changed.
        GivenUp: if the page ends meanwhile.
    """
    name = style_name(filename)
    check_upload(name, data)
    loaded = stage.cast(run).run
    if not _learning.acquire(blocking=False):
        progress(0.0, "waiting")
        _learning.acquire()

    def told(share: float, what: str) -> None:
        if stage.ended.is_set():
            raise GivenUp
        progress(share, what)

    try:
        with _naming_files(loaded.path), _kept_upload(stage.cast(run), name, data) as clip:
            style = clip.style
            with stage.preparation(run):
                background.do(partial(_learn, loaded, clip, told), niceness=NICENESS)
            with _saved_style(loaded.path, clip):
                background.do(partial(stage.add_style, run, style))
    except InputError as error:
        if stage.ended.is_set():  # its clip has been taken away
            raise GivenUp from error
        raise
    finally:
        _learning.release()
    progress(1.0, "done")
    return style


def style_name(filename: str) -> str:
    """A style's name from a file's: its last part without suffix, letters, digits, spaces, dashes and underscores kept.

    Raises:
        InputError: unless it ends in `.bvh`.
    """
    last = re.split(r"[/\\]", filename)[-1].strip()
    if not last.lower().endswith(".bvh"):
        raise InputError("upload", "file name", ascii(last)[:60], "must end in .bvh")
    kept = re.sub(r"[^\w -]+", "_", last[:-4], flags=re.ASCII).strip(" _-")[:LONGEST_NAME].strip(" _-")
    return kept or "clip"


def check_upload(name: str, data: bytes) -> None:
    """Refuses, before anything is written or parsed, bytes that cannot be a short clip.

    Raises:
        InputError: naming the limit.
    """
    file = f"{name}.bvh"
    if len(data) > MOST_BYTES:
        raise InputError(file, "size", f"{len(data) / 1e6:.1f} MB", f"must be at most {MOST_BYTES / 1e6:g} MB")
    if b"\0" in data or not data.strip():
        raise InputError(file, "file", "empty" if not data.strip() else "not text", "must be the text of a BVH file")
    joints = len(re.findall(rb"\bJOINT\b", data, re.IGNORECASE)) + 1
    if joints > MOST_JOINTS:
        raise InputError(file, "hierarchy", f"{joints} joints", f"must have at most {MOST_JOINTS}")
    stated = re.search(rb"Frames\s*:\s*(\d{1,12})\s+Frame\s+Time\s*:\s*([0-9.eE+-]{1,30})", data, re.IGNORECASE)
    if stated is None:
        return  # the reader will say what is wrong
    frames = int(stated[1])
    if frames > MOST_FRAMES:
        raise InputError(file, "frames", frames, f"must be at most {MOST_FRAMES}")
    try:
        seconds = frames * float(stated[2])
    except ValueError:
        return
    if seconds > LONGEST:
        raise InputError(file, "length", f"{seconds:.0f} s", f"must be at most {LONGEST:g} s: cut the clip")


def _learn(run: Run, clip: ClipFile, progress: Progress) -> None:
    try:
        learn_style(run, clip, page_config(run), mirror=is_symmetric(clip.style), progress=progress)
    except InputError as error:
        file = clip.path.name if error.file == str(clip.path) else error.file
        raise InputError(file, error.place, error.value, error.rule) from error


@contextmanager
def _naming_files(run: Path) -> Iterator[None]:
    """Turns the system's errors, as of a run that may not be written to, into ones that a page can tell."""
    try:
        yield
    except OSError as error:
        file = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else run
        shown = Path(run.name) / file.relative_to(run) if file.is_relative_to(run) else file
        rule = "a run that learns must be readable and writable, and its uploads a folder"
        raise InputError(shown, "file", (error.strerror or type(error).__name__).lower(), rule) from error


@contextmanager
def _kept_upload(cast: Cast, name: str, data: bytes) -> Iterator[ClipFile]:
    """The clip in RUN/uploads/ under a name that is free there and among the styles; removed if the block fails."""
    run = cast.run.path
    folder = run / "uploads"
    new = not folder.exists()
    if folder.resolve() != run.resolve() / "uploads":
        raise InputError(folder, "folder", "leads elsewhere", "must be a folder of the run itself")
    # What is played need not be on disk: of a run without styles, the network as it is.
    taken = {style.lower() for style in (*list_styles(run), *cast.styles)}
    taken |= set() if new else {path.stem.lower() for path in folder.iterdir()}
    free = next(free for free in _numbered(name) if free.lower() not in taken)
    path = folder / f"{free}.bvh"
    _unfinished.add(path)
    try:
        folder.mkdir(exist_ok=True)
        write_whole(path, data)
        yield ClipFile(path, free, symmetric=is_symmetric(free))
    except BaseException:
        _remove(path)
        raise
    finally:
        _unfinished.discard(path)


@contextmanager
def _saved_style(run: Path, clip: ClipFile) -> Iterator[None]:
    """A block in which a style that has been learned is taken on stage: it is removed again if that fails.

    If the page ends in the midst of it, style and clip stay: the next one has them.
    """
    _unfinished.discard(clip.path)
    try:
        yield
    except BaseException:
        folder = run / "styles" / clip.style
        aside = folder.with_name(f".{clip.style}.removed")  # a style half removed would still be listed
        with suppress(OSError):
            folder.rename(aside)
            shutil.rmtree(aside)
        raise


def _remove(upload: Path) -> None:
    """An upload, and its folder if nothing else is in it; where neither can be removed, neither was written."""
    with suppress(OSError):
        upload.unlink(missing_ok=True)
        upload.parent.rmdir()


def _numbered(name: str) -> Iterator[str]:
    yield name
    number = 2
    while True:
        yield f"{name} {number}"
        number += 1
