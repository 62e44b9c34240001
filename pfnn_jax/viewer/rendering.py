"""Clips as files to look at: an HTML player, a GIF, an MP4, or a PNG picture."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing, require_suffix, write_whole
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, Showable, annotate_clips
from pfnn_jax.viewer.draw.drawing import png_bytes
from pfnn_jax.viewer.draw.filmstrip import filmstrip
from pfnn_jax.viewer.draw.palette import PANEL, rgb
from pfnn_jax.viewer.draw.video import Video
from pfnn_jax.viewer.player.player import FPS, player_page

if TYPE_CHECKING:
    from PIL import Image

GIF_FPS, GIF_DPI, GIF_COLOURS, GIF_SAMPLES = 20.0, 80, 128, 8
MP4_FPS, MP4_DPI, MP4_QUALITY = 30.0, 150, 6
MOMENTS, MOST_MOMENTS, MOST_FPS = 8, 40, 240
MOST_GIF = 1200  # frames; they are kept in memory, and a minute takes 18 MB
APART = 8  # of 255: least distance of a colour of a GIF's palette from the background colours
CENTISECOND = 0.01  # the unit of durations in a GIF

Clips = Sequence[AnnotatedClip]
Progress = Callable[[int, int], None]
"""Called with the number of frames done and the number of all frames."""


def render(
    clips: Showable | Sequence[Showable],
    out: str | Path,
    *,
    fps: float | None = None,
    moments: int = MOMENTS,
    overwrite: bool = False,
    progress_callback: Progress | None = None,
) -> int:
    """Draws clips next to each other and in step; the file's suffix decides how.

    Args:
        clips: what to show: clips, records with a clip, or paths of files. Contacts and phases are found from the
            motion of those that are not annotated.
        out: `.html` for a page that plays without a server, `.gif` or `.mp4` for a video, `.png` for poses along time.
        fps: frames per second of a page (30) or video (20 in a GIF, 30 in an MP4); a GIF takes the nearest rate that
            is a whole number of hundredths of a second for each frame.
        moments: number of poses in a picture.
        overwrite: replace an existing file.
        progress_callback: called after every frame of a video.

    Returns:
        Number of bytes written.

    Raises:
        InputError: for another suffix, an existing file, a setting out of range, anything that is not a clip, or a
            page or video that cannot be made.
    """
    out = Path(out)
    check_output(out, fps, moments)
    refuse_existing(out, overwrite)
    one = isinstance(clips, MotionClip | str | Path) or hasattr(clips, "clip")
    annotated = annotate_clips([clips] if one else clips)  # type: ignore[list-item, arg-type]
    content = FORMATS[out.suffix.lower()](annotated, out, fps, moments, progress_callback)
    write_whole(out, content)
    return len(content)


def check_output(out: Path, fps: float | None, moments: int) -> None:
    """Checks the arguments of `render` before any clip is read.

    Raises:
        InputError: for a suffix that names no format, a missing folder, or a setting out of range.
    """
    require_suffix(out, FORMATS)
    if not out.parent.is_dir():
        raise InputError(out, "output", "no such folder", "its folder must exist")
    if fps is not None and not 0 < fps <= MOST_FPS:
        raise InputError(out, "fps", fps, f"must be positive and at most {MOST_FPS}")
    if not 1 <= moments <= MOST_MOMENTS:
        raise InputError(out, "moments", moments, f"must be 1 to {MOST_MOMENTS}")


def _html(clips: Clips, out: Path, fps: float | None, moments: int, progress: Progress | None) -> bytes:
    return player_page(clips, title=", ".join(annotated.name for annotated in clips), fps=fps or FPS).encode()


def _png(clips: Clips, out: Path, fps: float | None, moments: int, progress: Progress | None) -> bytes:
    return png_bytes(filmstrip(*clips, moments=moments))


def _gif(clips: Clips, out: Path, fps: float | None, moments: int, progress: Progress | None) -> bytes:
    from PIL import Image

    hundredths = max(2, round(1 / ((fps or GIF_FPS) * CENTISECOND)))  # browsers play shorter frames at 10 hundredths
    video = Video(clips, 1 / (hundredths * CENTISECOND), GIF_DPI)
    if video.num_frames > MOST_GIF:
        shown = f"{video.seconds:.0f} s at {video.fps:g} frames per second"
        raise InputError(out, "video", shown, f"a GIF holds {MOST_GIF} frames: show fewer seconds, or make an MP4")
    palette = _palette(video)
    frames = []
    for number, frame in enumerate(video.frames()):
        frames.append(Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE))
        if progress:
            progress(number + 1, video.num_frames)
    buffer = io.BytesIO()
    frames[0].save(
        buffer, "GIF", save_all=True, append_images=frames[1:], duration=10 * hundredths, loop=0, optimize=False
    )
    return buffer.getvalue()


def _palette(video: Video) -> Image.Image:
    """Returns one palette for all frames, taken from a few of them: with one for each, flat colours would flicker."""
    from PIL import Image

    some = [video.frame_at(second) for second in np.linspace(0, video.seconds, GIF_SAMPLES)]
    colours, counts = np.unique(np.concatenate(some).reshape(-1, 3), axis=0, return_counts=True)
    weighted = np.repeat(colours, np.ceil(np.sqrt(counts)).astype(int), axis=0)  # thin lines count, not only areas
    cut = Image.fromarray(weighted[None]).quantize(GIF_COLOURS, method=Image.Quantize.MEDIANCUT).getpalette() or []
    exact = np.array([rgb("#ffffff"), rgb(PANEL)])
    chosen = np.array(cut[: 3 * GIF_COLOURS]).reshape(-1, 3)
    # Pillow's search for the nearest colour is a few levels off: it could prefer a neighbour of a background colour
    far = np.abs(chosen[:, None] - exact).max(axis=-1).min(axis=1) > APART
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.concatenate([exact, chosen[far]]).ravel().tolist())
    return palette


def _mp4(clips: Clips, out: Path, fps: float | None, moments: int, progress: Progress | None) -> bytes:
    try:
        import imageio_ffmpeg
    except ImportError:
        rule = "MP4 needs imageio-ffmpeg: pip install 'pfnn-jax[viewer]'"
        raise InputError(out, "suffix", ".mp4", rule) from None
    # By default it shields ffmpeg from Ctrl-C by forking, which can deadlock on locks held by JAX's threads.
    os.environ.setdefault("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")
    video = Video(clips, fps or MP4_FPS, MP4_DPI)
    start: Any = imageio_ffmpeg.write_frames  # annotated as taking whole rates only, but takes any
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        try:
            writer = start(
                str(path), (video.width, video.height), fps=video.fps, quality=MP4_QUALITY, macro_block_size=2,
                ffmpeg_log_level="error", output_params=["-movflags", "+faststart"],
            )  # fmt: skip
            writer.send(None)
            for number, frame in enumerate(video.frames()):
                writer.send(np.ascontiguousarray(frame))
                if progress:
                    progress(number + 1, video.num_frames)
            writer.close()
        except (OSError, RuntimeError) as error:  # ffmpeg is missing or has stopped
            raise InputError(out, "video", str(error).splitlines()[0], "ffmpeg must be able to write it") from None
        return path.read_bytes()


FORMATS = {".html": _html, ".gif": _gif, ".mp4": _mp4, ".png": _png}
