"""Clips as files to look at: a page that plays, a GIF, an MP4, or a picture."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from PIL import Image

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing, require_suffix, write_whole
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip
from pfnn_jax.viewer.draw.drawing import png_bytes
from pfnn_jax.viewer.draw.filmstrip import filmstrip
from pfnn_jax.viewer.draw.palette import PANEL
from pfnn_jax.viewer.draw.video import Video
from pfnn_jax.viewer.player.player import FPS, player_page

GIF_FPS, GIF_DPI, GIF_COLOURS, GIF_SAMPLES = 20.0, 80, 128, 8
MP4_FPS, MP4_DPI, MP4_QUALITY = 30.0, 150, 6
MOMENTS, MOST_MOMENTS, MOST_FPS = 8, 40, 240
MOST_GIF = 1200  # frames; they are kept in memory, and a minute takes 18 MB
OFF = 8  # of 255: how far a colour of a GIF lies from those of the areas behind at least
CENTISECOND = 0.01  # times in a GIF are whole ones

Progress = Callable[[int, int], None]
"""Told how many frames are done, and of how many."""


def render(
    clips: Sequence[AnnotatedClip],
    out: str | Path,
    *,
    fps: float | None = None,
    moments: int = MOMENTS,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> int:
    """Draw clips side by side and in step; the file's suffix decides how.

    Args:
        clips: the clips, with their contacts and phases.
        out: `.html` for a page that plays without a server, `.gif` or `.mp4` for a video, `.png` for poses along time.
        fps: frames per second of a page (30) or video (20 in a GIF, 30 in an MP4); a GIF takes the nearest it can tell.
        moments: poses in a picture.
        overwrite: replace an existing file.
        progress: called after every frame of a video.

    Returns:
        Bytes written.

    Raises:
        InputError: for another suffix, an existing file, a setting out of range, or a page or video that fails.
    """
    out = Path(out)
    check_output(out, fps, moments)
    refuse_existing(out, overwrite)
    content = FORMATS[out.suffix.lower()](clips, out, fps, moments, progress)
    write_whole(out, content)
    return len(content)


def check_output(out: Path, fps: float | None, moments: int) -> None:
    """Before clips are read.

    Raises:
        InputError: for a suffix that names no format, a folder that is absent, or a setting out of range.
    """
    require_suffix(out, FORMATS)
    if not out.parent.is_dir():
        raise InputError(out, "output", "no such folder", "its folder must exist")
    if fps is not None and not 0 < fps <= MOST_FPS:
        raise InputError(out, "fps", fps, f"must be positive and at most {MOST_FPS}")
    if not 1 <= moments <= MOST_MOMENTS:
        raise InputError(out, "moments", moments, f"must be 1 to {MOST_MOMENTS}")


def _html(
    clips: Sequence[AnnotatedClip], out: Path, fps: float | None, moments: int, progress: Progress | None
) -> bytes:
    return player_page(clips, title=", ".join(annotated.name for annotated in clips), fps=fps or FPS).encode()


def _png(
    clips: Sequence[AnnotatedClip], out: Path, fps: float | None, moments: int, progress: Progress | None
) -> bytes:
    return png_bytes(filmstrip(*clips, moments=moments))


def _gif(
    clips: Sequence[AnnotatedClip], out: Path, fps: float | None, moments: int, progress: Progress | None
) -> bytes:
    hundredths = max(2, round(1 / ((fps or GIF_FPS) * CENTISECOND)))  # browsers take shorter ones for ten
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
    """The colours of some frames: one palette for all, or flat colours would flicker."""
    some = [video.frame_at(second) for second in np.linspace(0, video.seconds, GIF_SAMPLES)]
    colours, counts = np.unique(np.concatenate(some).reshape(-1, 3), axis=0, return_counts=True)
    weighted = np.repeat(colours, np.ceil(np.sqrt(counts)).astype(int), axis=0)  # thin lines count, not only areas
    cut = Image.fromarray(weighted[None]).quantize(GIF_COLOURS, method=Image.Quantize.MEDIANCUT).getpalette() or []
    exact = (np.array([to_rgb("white"), to_rgb(PANEL)]) * 255).round().astype(int)
    chosen = np.array(cut[: 3 * GIF_COLOURS]).reshape(-1, 3)
    # Pillow's search is a few levels off: beside the areas' own colours there may be none that it takes for them
    apart = np.abs(chosen[:, None] - exact).max(axis=-1).min(axis=1) > OFF
    palette = Image.new("P", (1, 1))
    palette.putpalette(np.concatenate([exact, chosen[apart]]).ravel().tolist())
    return palette


def _mp4(
    clips: Sequence[AnnotatedClip], out: Path, fps: float | None, moments: int, progress: Progress | None
) -> bytes:
    try:
        import imageio_ffmpeg
    except ImportError:
        rule = "MP4 needs imageio-ffmpeg: pip install pfnn-jax[viewer]"
        raise InputError(out, "suffix", ".mp4", rule) from None
    # Its way to keep Ctrl-C from ffmpeg forks a process in which threads, such as JAX's, may hold locks for ever.
    os.environ.setdefault("IMAGEIO_FFMPEG_NO_PREVENT_SIGINT", "1")
    video = Video(clips, fps or MP4_FPS, MP4_DPI)
    start: Any = imageio_ffmpeg.write_frames  # says that rates are whole numbers, and takes any
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
        except (OSError, RuntimeError) as error:  # ffmpeg absent or stopped
            raise InputError(out, "video", str(error).splitlines()[0], "ffmpeg must be able to write it") from None
        return path.read_bytes()


FORMATS = {".html": _html, ".gif": _gif, ".mp4": _mp4, ".png": _png}
