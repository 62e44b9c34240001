"""`pfnn-jax plot-phase`: local phases over time, as a picture."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import FLAT, Command, Reading, check_output, print_notes
from pfnn_jax.errors import InputError
from pfnn_jax.motion.labels.local_phase import LocalPhaseConfig
from pfnn_jax.motion.reading import ReadOptions


@dataclass(frozen=True, kw_only=True)
class PlotPhase(Command):
    """Plot the local phases of hands and toes over time.

    Attributes:
        clip: BVH, GLB, glTF or VRM file.
        out: the picture, a PNG file.
        start: time in the clip at which the picture begins, in seconds.
        seconds: length of the part that is shown. The phases are always computed from the whole clip.
        roles: JSON file that names the joints' roles.
        reading: what is known about the file, where it is not found or wrong.
        overwrite: replace an existing file.
        config: when a toe touches the ground.
    """

    clip: Annotated[Positional[Path], tyro.conf.arg(metavar="CLIP")]
    out: Path
    start: float = 0.0
    seconds: float = 6.0
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False
    config: Annotated[LocalPhaseConfig, FLAT] = field(default_factory=LocalPhaseConfig)

    def run(self) -> Any:
        from pfnn_jax.motion.clip import resample
        from pfnn_jax.motion.clip_files import read_clip
        from pfnn_jax.motion.trajectory import LAYOUT_FPS

        check_output(self.out, self.overwrite, ".png")
        clip = resample(read_clip(self.clip, **asdict(self.reading), roles_file=self.roles), LAYOUT_FPS)
        print_notes(self.clip, clip.notes)
        first, last = (round(second * clip.fps) for second in (self.start, self.start + self.seconds))
        if not 0 <= first < min(last, clip.num_frames - 1):
            shown = f"{self.seconds:g} seconds from {self.start:g}"
            rule = f"must lie within the clip's {clip.num_frames / clip.fps:.1f} seconds"
            raise InputError(self.clip, "start and seconds", shown, rule)
        last = min(last, clip.num_frames - 1)
        from pfnn_jax.evaluation.phase_plot import phase_plot
        from pfnn_jax.viewer.draw.drawing import save_figure

        save_figure(phase_plot(clip, config=self.config, span=(first, last), title=self.clip.stem), self.out)
        print(f"{self.out}: {(last - first) / clip.fps:.1f} seconds of {self.clip.name}")
        return {"first_frame": first, "last_frame": last, "fps": clip.fps}
