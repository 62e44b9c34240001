"""`pfnn-jax label-phase`: the phase of a clip, as a file."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Reading, check_output, print_notes
from pfnn_jax.motion.reading import ReadOptions


@dataclass(frozen=True, kw_only=True)
class LabelPhase(Command):
    """Label the phase of a clip and write it to a `.phase` file, which can be corrected by hand.

    Attributes:
        clip: BVH, GLB, glTF or VRM file.
        out: the `.phase` file: one value in cycles for each frame of the clip; 0 is the right foot's contact.
        roles: JSON file that names the joints' roles.
        reading: what is known about the file, where it is not found or wrong.
        overwrite: replace an existing file.
    """

    clip: Annotated[Positional[Path], tyro.conf.arg(metavar="CLIP")]
    out: Path
    roles: Path | None = None
    reading: Reading = ReadOptions()
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.motion.clip_files import read_clip
        from pfnn_jax.motion.labels.phase import label_phase, pad_phase, write_phase

        check_output(self.out, self.overwrite, ".phase")
        clip = read_clip(self.clip, **asdict(self.reading), roles_file=self.roles)
        print_notes(self.clip, clip.notes)
        labels = label_phase(clip)
        if clip.reading is not None:
            labels = pad_phase(labels, clip.reading.first_frame, clip.reading.frames_in_file)
        write_phase(self.out, labels, overwrite=self.overwrite)
        steps = len(labels.contacts_right) + len(labels.contacts_left)
        print(f"{self.out}: {steps} steps, {int(labels.labelled.sum())} of {labels.num_frames} frames labelled")
        return {
            "steps": steps,
            "labelled": int(labels.labelled.sum()),
            "frames": labels.num_frames,
            "notes": clip.notes,
        }
