"""`pfnn-jax render`: clips as pages, films and pictures."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Reading, check_writable, print_notes
from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing
from pfnn_jax.motion.reading import ReadOptions

if TYPE_CHECKING:
    from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip


@dataclass(frozen=True, kw_only=True)
class Render(Command):
    """Draw clips side by side and in step, with foot contacts and phase, as a page, a film or a picture.

    A `.phase` file of the same name as a clip is used instead of labelling its phase.

    Attributes:
        clips: BVH, GLB, glTF or VRM files of any skeletons.
        out: `.html` for an interactive page that needs no server, `.gif` or `.mp4` for a film, or `.png` for poses
            along time.
        names: captions, one for each clip; by default the names of the files.
        start: time in the clips at which to begin, in seconds.
        seconds: length of the part that is drawn; by default all.
        fps: frames per second; by default 30 for a page or an MP4, 20 for a GIF.
        moments: number of poses in a picture.
        roles: JSON file that names the joints' roles.
        reading: what is known about the files, where it is not found or wrong.
        overwrite: replace an existing file.
    """

    clips: Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="CLIP [CLIP ...]")]]
    out: Path
    names: tuple[str, ...] = ()
    start: float = 0.0
    seconds: float | None = None
    fps: float | None = None
    moments: int = 8
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.cli.progress import progress
        from pfnn_jax.viewer.rendering import check_output, render

        check_output(self.out, self.fps, self.moments)
        check_writable(self.out)
        refuse_existing(self.out, self.overwrite)
        if not self.clips:
            raise InputError("command line", "clips", "none", "name at least one file")
        if self.names and len(self.names) != len(self.clips):
            value = f"{len(self.names)} for {len(self.clips)} clips"
            raise InputError("command line", "names", value, "give one for each clip")
        names = self.names or [clip.stem for clip in self.clips]
        clips = [self._annotated(path, name) for path, name in zip(self.clips, names, strict=True)]
        with progress("drawing") as report:
            settings: Any = {"fps": self.fps, "moments": self.moments, "overwrite": self.overwrite}
            size = render(clips, self.out, **settings, progress_callback=report)
        for clip in clips:
            if clip.note:
                print(f"{clip.name}: {clip.note}")
        seconds = max(clip.seconds for clip in clips)
        print(f"{self.out}: {seconds:.1f} s, {size / 1e3:,.0f} kB")
        notes = {clip.name: clip.note for clip in clips if clip.note}
        return {"out": self.out, "seconds": seconds, "bytes": size, "notes": notes}

    def _annotated(self, path: Path, name: str) -> AnnotatedClip:
        from pfnn_jax.motion.clip_files import read_clip
        from pfnn_jax.viewer.draw.annotated_clip import annotate

        clip = read_clip(path, **asdict(self.reading), roles_file=self.roles)
        print_notes(path, clip.notes)
        phase = path.with_suffix(".phase")
        annotated = annotate(clip, name, phase if phase.is_file() else None)
        return annotated.cut_seconds(self.start, self.seconds)
