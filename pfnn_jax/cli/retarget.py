"""`pfnn-jax retarget`: a clip on another body."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import FLAT, Command, Reading, print_notes
from pfnn_jax.cli.motion_file import MotionFile
from pfnn_jax.motion.reading import ReadOptions


@dataclass(frozen=True, kw_only=True)
class Retarget(Command):
    """Put a clip onto another body: your own character, your rig, or the mannequin of a GLB file. No network is used.

    Attributes:
        clip: BVH, GLB, glTF or VRM file of the motion.
        out: the file to write: .bvh, .glb, .vrm for a VRM character, or .vrma for every VRM character.
        file: whose body moves.
        name: of the clip in the file; by default that of the clip's file.
        roles: JSON file that names the roles of the clip's joints.
        reading: what is known about the clip's file, where it is not found or wrong.
        overwrite: replace an existing file.
    """

    clip: Annotated[Positional[Path], tyro.conf.arg(metavar="CLIP")]
    out: Path
    file: Annotated[MotionFile, FLAT] = MotionFile()
    name: str | None = None
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False

    def run(self) -> Any:
        from dataclasses import asdict

        self.file.check(self.out, self.overwrite)
        from pfnn_jax.motion.clip_files import read_clip

        clip = read_clip(self.clip, **asdict(self.reading), roles_file=self.roles)
        print_notes(self.clip, clip.notes)
        clip = self.file.write(self.out, clip, self.overwrite, self.name or self.clip.stem)
        seconds = clip.num_frames / clip.fps
        print(f"{self.out}: {seconds:.1f} s")
        return {"out": self.out, "seconds": seconds, "frames": clip.num_frames}
