"""`pfnn-jax label-phase`: the phase of a clip, as a file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, check_output


@dataclass(frozen=True, kw_only=True)
class LabelPhase(Command):
    """Label the phase of a clip and write it to a `.phase` file, which can be corrected by hand.

    Attributes:
        clip: BVH file.
        out: the `.phase` file: one value in cycles for each frame of the BVH file; 0 is the right foot's contact.
        roles: JSON file that names the joints' roles.
        overwrite: replace an existing file.
    """

    clip: Annotated[Positional[Path], tyro.conf.arg(metavar="CLIP.bvh")]
    out: Path
    roles: Path | None = None
    overwrite: bool = False

    def run(self) -> Any:
        from pfnn_jax.motion.bvh import read_bvh
        from pfnn_jax.motion.labels.phase import label_phase, write_phase

        check_output(self.out, self.overwrite, ".phase")
        labels = label_phase(read_bvh(self.clip, roles_file=self.roles))
        write_phase(self.out, labels, overwrite=self.overwrite)
        steps = len(labels.contacts_right) + len(labels.contacts_left)
        print(f"{self.out}: {steps} steps, {int(labels.labelled.sum())} of {labels.num_frames} frames labelled")
        return {"steps": steps, "labelled": int(labels.labelled.sum()), "frames": labels.num_frames}
