"""Files that commands write motion to: BVH, GLB, and a user's own character."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from pfnn_jax.cli.command import check_output, print_notes
from pfnn_jax.errors import InputError

SUFFIXES = (".bvh", ".glb", ".vrm", ".vrma")
ONTO = (".glb", ".gltf", ".vrm", ".bvh")


@dataclass(frozen=True, kw_only=True)
class MotionFile:
    """Where motion is written to.

    Attributes:
        onto: your own character (.glb, .gltf, .vrm), which is written to --out with the motion as one more clip, or a
            BVH file of your rig. Without it a BVH has the motion's own skeleton, and a GLB a mannequin.
        root_motion: let the character in a GLB travel, by its root joint or its hips. By default it stays in place, as
            engines want it.
        loop: write one cycle that closes, such as two steps.
    """

    onto: Annotated[Path | None, tyro.conf.arg(metavar="CHARACTER|RIG.bvh")] = None
    root_motion: bool = False
    loop: bool = False

    def check(self, out: Path, overwrite: bool) -> None:
        """Checks output and options before long work; raises `InputError` as `check_output`."""
        check_output(out, overwrite, *SUFFIXES)
        kind, target = out.suffix.lower(), "" if self.onto is None else self.onto.suffix.lower()
        if self.onto is not None:
            from pfnn_jax.io.files import require_suffix
            from pfnn_jax.motion.clip_files import read_any_skeleton

            require_suffix(self.onto, ONTO)
            if kind == ".vrma":
                raise InputError(
                    "command line", "onto", self.onto, "a .vrma file fits every VRM character: leave it out"
                )
            if kind == ".vrm" and target != ".vrm":
                raise InputError(out, "suffix", kind, "must be .glb: only a VRM character becomes a VRM file")
            read_any_skeleton(self.onto)  # refuses what is no humanoid before anything long begins
        elif kind == ".vrm":
            raise InputError(out, "suffix", kind, "must be .glb or .vrma without --onto CHARACTER.vrm")

    def write(self, out: Path, clip: Any, overwrite: bool, name: str | None = None) -> Any:
        """Writes a clip, prints what was assumed, and returns the clip as it was cut."""
        from pfnn_jax.io.files import refuse_existing, write_whole
        from pfnn_jax.motion.cycles import cut_cycle

        clip = cut_cycle(clip) if self.loop else clip
        content = self._content(out, clip, name)
        refuse_existing(out, overwrite)
        write_whole(out, content)
        return clip

    def _content(self, out: Path, clip: Any, name: str | None) -> bytes:
        from pfnn_jax.motion.bvh import bvh_text
        from pfnn_jax.workflows.characters import clip_name, is_character_file, put_onto, put_onto_rig

        kind, name = out.suffix.lower(), name or clip_name(clip)
        if kind == ".vrma":
            from pfnn_jax.motion.gltf.vrma import vrma_bytes

            return vrma_bytes(clip, name, root_motion=self.root_motion)
        notes: list[str] = []
        if self.onto is not None and kind != ".bvh" and is_character_file(self.onto):
            content = put_onto(clip, self.onto, root_motion=self.root_motion, name=name, note_callback=notes.append)
            print_notes(self.onto, notes)
            return content
        unit = None
        if self.onto is not None:
            clip, unit = put_onto_rig(clip, self.onto, note_callback=notes.append)
            print_notes(self.onto, notes)
        if kind == ".bvh":
            return bvh_text(clip, path=out, **({} if unit is None else {"unit": unit})).encode()
        from pfnn_jax.motion.gltf.write import glb_bytes
        from pfnn_jax.viewer.body import grow_body

        return glb_bytes(clip.skeleton, grow_body(clip.skeleton), {name: clip}, root_motion=self.root_motion)
