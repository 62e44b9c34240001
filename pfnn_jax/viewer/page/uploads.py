"""Learning a style from a clip that is uploaded on the page.

A browser sends bytes and a name. The bytes are read as BVH or glTF, as the name says, and as nothing else; the name is
reduced to harmless characters and names the style and a file in RUN/uploads/. If anything fails, the run's folder is
left as it was.
"""

from __future__ import annotations

import os
import re
import shutil
import threading
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import write_whole
from pfnn_jax.io.locks import writing
from pfnn_jax.motion.clip_files import CLIP_SUFFIXES
from pfnn_jax.motion.datasets.sources import ClipFile, check_style_name
from pfnn_jax.run import Run
from pfnn_jax.training.config import FILM_FEW_SHOT, FewShotConfig
from pfnn_jax.viewer.page import background
from pfnn_jax.viewer.page.run_library import LoadedRun, RunLibrary, compile_calibration
from pfnn_jax.viewer.page.run_places import own_folder
from pfnn_jax.viewer.page.style_files import taken_names, unfinished_mark
from pfnn_jax.workflows.learn import default_config, learn_style, precompile, precompile_rollouts

MOST_BYTES = 10_000_000
"""Size of the largest file taken as a clip."""

MOST_CHARACTER_BYTES = 32_000_000
"""Size of the largest character taken; most hold textures of some megabytes."""

MOST_BUFFERED = 4 * MOST_BYTES
"""Most bytes held in memory of all files that a tab sends at once. A larger file than `MOST_BYTES` within this limit is
refused by `check_upload` once it is complete."""

MOST_JOINTS = 200
MOST_FRAMES = 20_000
LONGEST = 60.0
"""Seconds of the longest clip; `pfnn-jax few-shot` is the better tool for longer ones."""

LONGEST_NAME = 40
"""Most characters of the file's name that become the style's name."""

ACCEPTED = ",".join(CLIP_SUFFIXES)
"""What the browser's dialog offers for an upload button."""

NICENESS = 10
"""Niceness of learning, so that characters keep moving, on systems whose threads have their own."""

WAITING = "waiting"
"""What is reported as the present activity while another style is learned, or another clip restyled, first."""

QUICK_FILM = replace(FILM_FEW_SHOT, learning_rates=(3e-3, 1e-2), eval_epochs=(25, 50))
"""FiLM styles on the page: higher learning rates and half the epochs of `FILM_FEW_SHOT`, with the same errors on
held-out frames."""

Progress = Callable[[float, str], None]

_learning = threading.Lock()  # one style at a time: two would both take twice as long
_unfinished: set[Path] = set()


class LearnedUpload(NamedTuple):
    """A style that was learned from an upload.

    Attributes:
        style: its name.
        notes: what was assumed and done to read the clip, one line each.
        warnings: what may be wrong with the clip or the style, one line each.
    """

    style: str
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class LearningCancelled(Exception):
    """Raised when the page ends while a style is being learned."""


def page_config(run: Run) -> FewShotConfig:
    """Returns the settings for learning a style of the run's kind; for adapters they are the defaults of few-shot."""
    kind, config = run.config.adapter.kind, default_config(run)
    if kind == "film":
        return QUICK_FILM
    return config if config.restyled else replace(config, method=kind)


def prepare_walks(library: RunLibrary, run: str) -> None:
    """Compiles the rollouts by which a style is judged, and its calibration, while a page is opened."""
    loaded = library.get(run)
    with library.preparation(run).calibration:
        background.do(partial(precompile_rollouts, loaded.run, page_config(loaded.run)), niceness=NICENESS)
        background.do(partial(compile_calibration, loaded.controller), niceness=NICENESS)


def prepare_training(library: RunLibrary, run: str) -> None:
    """Compiles the training of a style, in the background of a page that has just been opened; see `precompile`.

    An upload takes precedence, and waits for what is being compiled of its own run only.
    """
    with _learning:  # wait for an upload that is being learned
        pass
    loaded = library.get(run).run
    with library.preparation(run).training:
        background.do(partial(precompile, loaded, page_config(loaded)), niceness=NICENESS)


def cancel_learning(library: RunLibrary, wait: float = 0.5) -> None:
    """Cancels what is being learned because the page ends; the runs' folders are left as they were before.

    Args:
        library: the runs; no style can be learned after this.
        wait: seconds to wait for the learning thread to notice, before its files are removed.
    """
    library.closing.set()
    if _learning.acquire(timeout=wait):
        _learning.release()
    for path in tuple(_unfinished):
        _remove(path)


def learn_upload(
    library: RunLibrary,
    run: str,
    filename: str,
    data: bytes,
    progress: Progress = lambda share, what: None,
    *,
    name: str = "",
) -> LearnedUpload:
    """Learns a style from an uploaded clip; characters can choose it when this returns.

    The style equals that of `pfnn-jax few-shot` with the same settings (`page_config`). It is saved in RUN/styles/ and
    its clip in RUN/uploads/, both under its name, followed by a number if the name is taken. One style is learned at a
    time; others wait.

    Args:
        library: the runs.
        run: name of the run.
        filename: as sent by the browser.
        data: the file's bytes.
        progress: called from another thread with the fraction done, 0 to 1, and the present activity.
        name: of the style; "" for that of the file, reduced to harmless characters.

    Returns:
        The style's name, and what to say of it.

    Raises:
        InputError: for an unknown run, or a name that cannot be a file's; for a file that is too large, not of its
            kind, without a clip, with too many joints or frames, too short or long, without steps if the run needs
            them, or of a skeleton that is not a humanoid; for a run's folder that cannot be written, or that
            another process is writing. Nothing has changed then.
        LearningCancelled: if the page ends meanwhile.
    """
    style, suffix = check_style_name(name, "upload") if name else style_name(filename), suffix_of(filename)
    check_upload(style, data, suffix)
    loaded = library.get(run).run
    if not _learning.acquire(blocking=False):
        progress(0.0, WAITING)
        _learning.acquire()

    def report(share: float, what: str) -> None:
        if library.closing.is_set():
            raise LearningCancelled
        progress(share, what)

    try:
        with (
            _system_errors(loaded.path),
            writing(loaded.path),
            _kept_upload(library.get(run), style, suffix, data) as clip,
        ):
            style = clip.style
            with library.preparation(run).training:
                info = background.do(partial(_learn, loaded, clip, report), niceness=NICENESS)
            with _saved_style(loaded.path, clip), library.preparation(run).calibration:
                background.do(partial(library.add_style, run, style))
    except InputError as error:
        if library.closing.is_set():  # its clip has been removed by `cancel_learning`
            raise LearningCancelled from error
        raise
    finally:
        _learning.release()
    progress(1.0, "done")
    return LearnedUpload(style, tuple(info["notes"]), tuple(info["warnings"]))


def style_name(filename: str) -> str:
    """Returns the style's name for a file: letters, digits, spaces, dashes and underscores of its name without suffix.

    Raises:
        InputError: unless it ends as the name of a file with clips does.
    """
    last, suffix = _last_part(filename), suffix_of(filename)
    kept = re.sub(r"[^\w -]+", "_", last[: -len(suffix)], flags=re.ASCII).strip(" _-")[:LONGEST_NAME].strip(" _-")
    return kept or "clip"


def suffix_of(filename: str) -> str:
    """Returns the suffix of a file with clips, in lower case.

    Raises:
        InputError: for any other file.
    """
    last = _last_part(filename)
    _, dot, ending = last.lower().rpartition(".")
    suffix = f"{dot}{ending}"
    if suffix not in CLIP_SUFFIXES:
        rule = f"must end in {', '.join(CLIP_SUFFIXES[:-1])} or {CLIP_SUFFIXES[-1]}"
        raise InputError("upload", "file name", ascii(last)[:60], rule)
    return suffix


def _last_part(filename: str) -> str:
    return re.split(r"[/\\]", filename)[-1].strip()


def check_size(file: str, data: bytes, most: int = MOST_BYTES) -> None:
    """Refuses a file that is too large.

    Raises:
        InputError: that names the limit.
    """
    if len(data) > most:
        raise InputError(file, "size", f"{len(data) / 1e6:.1f} MB", f"must be at most {most / 1e6:g} MB")


def check_upload(name: str, data: bytes, suffix: str = ".bvh") -> None:
    """Refuses bytes that cannot be a short clip, before anything is written or parsed.

    Those of glTF are refused by their reader (`motion.gltf`), which takes nothing from outside the file's folder.

    Raises:
        InputError: that names the limit.
    """
    file = f"{name}{suffix}"
    check_size(file, data)
    if suffix != ".bvh":
        return
    if b"\0" in data or not data.strip():
        raise InputError(file, "file", "empty" if not data.strip() else "not text", "must be the text of a BVH file")
    joints = len(re.findall(rb"\bJOINT\b", data, re.IGNORECASE)) + 1
    if joints > MOST_JOINTS:
        raise InputError(file, "hierarchy", f"{joints} joints", f"must have at most {MOST_JOINTS}")
    stated = re.search(rb"Frames\s*:\s*(\d{1,12})\s+Frame\s+Time\s*:\s*([0-9.eE+-]{1,30})", data, re.IGNORECASE)
    if stated is None:
        return  # the parser reports what is wrong
    frames = int(stated[1])
    if frames > MOST_FRAMES:
        raise InputError(file, "frames", frames, f"must be at most {MOST_FRAMES}")
    try:
        seconds = frames * float(stated[2])
    except ValueError:
        return
    if seconds > LONGEST:
        raise InputError(file, "length", f"{seconds:.0f} s", f"must be at most {LONGEST:g} s: cut the clip")


def _learn(run: Run, clip: ClipFile, progress: Progress) -> dict[str, Any]:
    try:
        return learn_style(run, clip, page_config(run), progress_callback=progress)
    except InputError as error:
        file = clip.path.name if error.file == str(clip.path) else error.file
        raise InputError(file, error.place, error.value, error.rule) from error


@contextmanager
def _system_errors(run: Path) -> Iterator[None]:
    """Turns errors of the file system, such as a read-only run, into `InputError`, which the page shows."""
    try:
        yield
    except OSError as error:
        file = Path(os.fsdecode(error.filename)) if isinstance(error.filename, str | bytes) else run
        shown = Path(run.name) / file.relative_to(run) if file.is_relative_to(run) else file
        rule = "the run's folder must be readable and writable, and its uploads a folder"
        raise InputError(shown, "file", (error.strerror or type(error).__name__).lower(), rule) from error


@contextmanager
def _kept_upload(loaded: LoadedRun, name: str, suffix: str, data: bytes) -> Iterator[ClipFile]:
    """Writes the clip to RUN/uploads/ under a name that is free there and among the styles; removes it on failure."""
    run = loaded.run.path
    folder = own_folder(run, "uploads")
    # Not every style that is played is on disk: the unmodified network of a run without styles is not.
    taken = taken_names(run) | {style.lower() for style in loaded.styles}
    free = next(free for free in _numbered(name) if free.lower() not in taken)
    path = folder / f"{free}{suffix}"
    _unfinished.add(path)
    try:
        folder.mkdir(exist_ok=True)
        unfinished_mark(path).touch()
        write_whole(path, data)
        yield ClipFile(path, free)
    except BaseException:
        _remove(path)
        raise
    finally:
        _unfinished.discard(path)
        with suppress(OSError):
            unfinished_mark(path).unlink(missing_ok=True)


@contextmanager
def _saved_style(run: Path, clip: ClipFile) -> Iterator[None]:
    """Removes a learned style again if the block, which adds it to the library, fails.

    If the page ends meanwhile, style and clip are kept for the next start.
    """
    _unfinished.discard(clip.path)
    try:
        yield
    except BaseException:
        folder = run / "styles" / clip.style
        hidden = folder.with_name(f".{clip.style}.removed")  # a partly removed style would still be listed
        with suppress(OSError):
            folder.rename(hidden)
            shutil.rmtree(hidden)
        raise


def _remove(upload: Path) -> None:
    """Removes an upload, and its folder if it is empty; if neither can be removed, neither was written."""
    with suppress(OSError):
        upload.unlink(missing_ok=True)
        unfinished_mark(upload).unlink(missing_ok=True)
        upload.parent.rmdir()


def _numbered(name: str) -> Iterator[str]:
    """Yields "name", "name 2", "name 3" and so on."""
    yield name
    number = 2
    while True:
        yield f"{name} {number}"
        number += 1


class _DroppedParts(dict[int, bytes]):
    """Parts of a file whose content is dropped on arrival."""

    def __setitem__(self, index: int, content: bytes) -> None:
        super().__setitem__(index, b"")


def drop_large(transfers: MutableMapping[str, Any]) -> list[str]:
    """Drops the received and the future parts of files that are too large to be held in memory.

    Viser buffers uploads in memory before anything can check them. The transfer itself continues, because a page
    accepts no other file until all parts are acknowledged; viser then discards the file, whose length is wrong.

    Args:
        transfers: viser's uploads in progress, in the order of their beginning.

    Returns:
        A message for each file that has been dropped by this call.
    """
    messages, buffered = [], 0
    for state in list(transfers.values()):
        if isinstance(state["parts"], _DroppedParts):
            continue
        stated = state["total_bytes"] if isinstance(state["total_bytes"], int) else MOST_BUFFERED + 1
        size = max(stated, state["transferred_bytes"])
        if buffered + size <= MOST_BUFFERED:
            buffered += size
            continue
        with state["lock"]:
            state["parts"] = _DroppedParts(dict.fromkeys(state["parts"], b""))
        limits = f"{MOST_BYTES / 1e6:g} MB for clips, {MOST_CHARACTER_BYTES / 1e6:g} MB for characters"
        rule = f"is far larger than what is taken: {limits}" if size > MOST_BUFFERED else "comes with too many others"
        messages.append(f"{str(state['filename'])[:80]}: the file {rule}")
    return messages
