"""Restyling a clip on the page: an uploaded clip takes the style of another, and is shown next to both.

Nothing is written into a run. As in `uploads`, a browser sends bytes and a name; the bytes are read as BVH or glTF, as
the name says, and as nothing else.
"""

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

from pfnn_jax.errors import InputError
from pfnn_jax.motion.blending import Parts
from pfnn_jax.transfer.run import BASE_AUTOENCODER, TransferRun, load_transfer_run
from pfnn_jax.viewer.draw.annotated_clip import annotate_clips
from pfnn_jax.viewer.page import background
from pfnn_jax.viewer.page.recording import bvh_bytes
from pfnn_jax.viewer.page.uploads import NICENESS, WAITING, Progress, check_upload, style_name, suffix_of
from pfnn_jax.viewer.page.worn_character import clip_bytes, read_content
from pfnn_jax.viewer.player.player import player_page
from pfnn_jax.workflows.transfer import transfer_clip

MOST_WAITING = 4
"""Clips that are restyled or wait for it; more are refused, because each holds two clips in memory and a thread."""

_restyling = threading.Lock()  # one clip at a time: two would both take twice as long
_waiting = threading.BoundedSemaphore(MOST_WAITING)


class ClipUpload(NamedTuple):
    """A clip that a browser has sent, or a sample.

    Attributes:
        name: its file's name without suffix, reduced to harmless characters.
        data: the bytes of the file.
        suffix: that of its kind.
    """

    name: str
    data: bytes
    suffix: str = ".bvh"


class Restyled(NamedTuple):
    """A restyled clip.

    Attributes:
        name: of the result's files: CONTENT_STYLE.
        title: "CONTENT in the style of STYLE".
        bvh: the result as the bytes of a BVH file.
        page: complete HTML page with the content, the style and the result in step.
        notes: what was assumed and done, one line each.
        seconds: that it took.
    """

    name: str
    title: str
    bvh: bytes
    page: str
    notes: tuple[str, ...]
    seconds: float


def check_clip(filename: str, data: bytes) -> ClipUpload:
    """Returns an upload that may be a short clip; it is parsed later.

    Raises:
        InputError: for a file of another kind, one without a motion, and as `uploads.check_upload`.
    """
    name, suffix = style_name(filename), suffix_of(filename)
    content = read_content(filename, data)
    if not content.clips:
        rule = "must hold the motion of a clip: this file holds a character alone, which can be worn"
        raise InputError(f"{name}{suffix}", "motion", "none", rule)
    filename, data = clip_bytes(filename, data, content, content.clips[0])  # the likely walk
    name, suffix = style_name(filename), suffix_of(filename)
    check_upload(name, data, suffix)
    return ClipUpload(name, data, suffix)


def restyle(
    content: ClipUpload,
    style: ClipUpload,
    strength: float,
    parts: Parts,
    progress: Progress = lambda share, what: None,
) -> Restyled:
    """Puts a clip into the style of another as `pfnn-jax transfer` does; one at a time, others wait.

    Args:
        content, style: the clips.
        strength, parts: as in `workflows.transfer_clip`.
        progress: called from another thread with the fraction done, 0 to 1, and the present activity.

    Raises:
        InputError: as `transfer_clip`, with files named as they were uploaded; if too many clips wait already.
    """
    if not _waiting.acquire(blocking=False):
        raise InputError(
            "page", "restyling", f"{MOST_WAITING} clips are being restyled or waiting", "try this one again later"
        )
    try:
        if not _restyling.acquire(blocking=False):
            progress(0.0, WAITING)
            _restyling.acquire()
        try:
            return background.do(partial(_restyle, content, style, strength, parts, progress), niceness=NICENESS)
        finally:
            _restyling.release()
    finally:
        _waiting.release()


def _restyle(
    content: ClipUpload, style: ClipUpload, strength: float, parts: Parts, progress: Callable[[float, str], None]
) -> Restyled:
    with background.temporary_folder() as folder:
        paths = [_write(Path(folder) / role, clip) for role, clip in (("content", content), ("style", style))]
        try:
            done = transfer_clip(*paths, run=_autoencoder(), strength=strength, parts=parts, progress_callback=progress)
        except InputError as error:
            value = _shown(str(error.value), folder)
            raise InputError(_shown(error.file, folder), error.place, value, error.rule) from error
    clips, names = (done.content, done.styles[0], done.clip), (content.name, style.name, "result")
    title = f"{content.name} in the style of {style.name}"
    return Restyled(
        f"{content.name}_{style.name}",
        title,
        bvh_bytes(done.clip, done.unit),
        player_page(annotate_clips(clips, names), title=title),
        tuple(_shown(note, folder) for note in done.notes),
        done.seconds,
    )


@cache
def _autoencoder() -> TransferRun:
    """Loads the autoencoder of the package, once."""
    return load_transfer_run(BASE_AUTOENCODER)


def _write(folder: Path, clip: ClipUpload) -> Path:
    folder.mkdir()
    path = folder / f"{clip.name}{clip.suffix}"
    path.write_bytes(clip.data)
    return path


def _shown(text: str, folder: str) -> str:
    """Returns a text without the temporary folder of the clips that it names."""
    return re.sub(rf"{re.escape(folder)}[/\\](content|style)[/\\]", "", text)
