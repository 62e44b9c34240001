"""The command that makes motion visible without a server: pages, films and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional as Argument

from pfnn_jax.cli.base import Command
from pfnn_jax.cli.progress import frame_progress
from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, annotate, cut_seconds
from pfnn_jax.viewer.draw.body import Up, upright
from pfnn_jax.viewer.rendering import MOMENTS, check_output, render


@dataclass(frozen=True, kw_only=True)
class Render(Command):
    """Draw clips side by side and in step, with foot contacts and phase: a page that plays, a film or a picture.

    A `.phase` file beside a clip wins over the phase found from its motion.

    Attributes:
        clips: BVH files of any skeleton.
        out: `.html` for a page that plays without a server, `.gif`, `.mp4`, or `.png` for poses along time.
        names: captions, one for each clip; the files' names by default.
        start: seconds into the clips at which the showing begins.
        seconds: how much of the clips is shown; by default all.
        fps: frames per second of a page, 30 by default, or of a film, 20 in a GIF and 30 in an MP4.
        moments: poses in a picture.
        up: the files' axis that points up; auto finds it from how the body stands.
        roles: JSON that names the joints' roles.
        overwrite: replace an existing file.
    """

    clips: Argument[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="CLIP.bvh [CLIP.bvh ...]")]]
    out: Path
    names: tuple[str, ...] = ()
    start: float = 0.0
    seconds: float | None = None
    fps: float | None = None
    moments: int = MOMENTS
    up: Up = "auto"
    roles: Path | None = None
    overwrite: bool = False

    def run(self) -> Any:
        check_output(self.out, self.fps, self.moments)
        refuse_existing(self.out, self.overwrite)
        if not self.clips:
            raise InputError("command line", "clips", "none", "name at least one BVH file")
        if self.names and len(self.names) != len(self.clips):
            raise InputError("command line", "names", f"{len(self.names)} for {len(self.clips)} clips", "one a clip")
        names = self.names or [clip.stem for clip in self.clips]
        clips = [self._annotate(path, name) for path, name in zip(self.clips, names, strict=True)]
        with frame_progress() as progress:
            settings = {"fps": self.fps, "moments": self.moments, "overwrite": self.overwrite}
            size = render(clips, self.out, **settings, progress=progress)
        for annotated in clips:
            if annotated.note:
                print(f"{annotated.name}: {annotated.note}")
        seconds = max(annotated.seconds for annotated in clips)
        print(f"{self.out}: {seconds:.1f} s, {size / 1e3:,.0f} kB")
        notes = {annotated.name: annotated.note for annotated in clips if annotated.note}
        return {"out": self.out, "seconds": seconds, "bytes": size, "notes": notes}

    def _annotate(self, path: Path, name: str) -> AnnotatedClip:
        clip = upright(read_bvh(path, roles_file=self.roles), self.up)
        phase = path.with_suffix(".phase")
        annotated = annotate(clip, name, phase if phase.is_file() else None)
        return cut_seconds(annotated, self.start, self.seconds)
