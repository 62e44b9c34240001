"""Files that commands write motion to: BVH, GLB, and a user's own character."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from pfnn_jax.cli.command import check_output, print_notes
from pfnn_jax.errors import InputError
from pfnn_jax.motion.length_unit import UnitName
from pfnn_jax.motion.reading import ReadOptions

if TYPE_CHECKING:
    from pfnn_jax.motion.clip import MotionClip

SUFFIXES = (".bvh", ".glb", ".vrm", ".vrma")
SET_SUFFIXES = (".glb", ".vrm")
"""Ends of the names of files that hold several clips."""


@dataclass(frozen=True, kw_only=True)
class MotionFile:
    """Where motion is written to.

    Attributes:
        onto: your own character (.glb, .gltf, .vrm), which is written to --out with the motion as one more clip, or a
            BVH file of your rig. Without it a BVH has the motion's own skeleton, and a GLB a mannequin.
        onto_roles: JSON file that names the joints of bones of the character or rig; the others are found.
        onto_unit: the unit of the character or rig, if it is found wrongly.
        root_motion: let the character in a GLB travel, by its root joint or its hips. By default it stays in place, as
            engines want it. A BVH file always travels.
        loop: write one cycle that closes, such as two steps.
    """

    onto: Annotated[Path | None, tyro.conf.arg(metavar="CHARACTER|RIG.bvh")] = None
    onto_roles: Path | None = None
    onto_unit: float | UnitName | None = None
    root_motion: bool = False
    loop: bool = False

    def check(self, out: Path, overwrite: bool) -> None:
        """Checks output and options before long work; raises `InputError` as `check_output`."""
        check_output(out, overwrite, *SUFFIXES)
        kind = out.suffix.lower()
        if kind == ".bvh" and self.root_motion:
            raise InputError("command line", "root-motion", out, "a BVH file always travels: leave it out")
        if self.onto is not None:
            self._check_onto(self.onto, out)
        elif kind == ".vrm":
            raise InputError(out, "suffix", kind, "must be .glb or .vrma without --onto CHARACTER.vrm")
        for option, value in (("onto-roles", self.onto_roles), ("onto-unit", self.onto_unit)):
            if value is not None and self.onto is None:
                raise InputError("command line", option, value, "is about the file of --onto: leave it out")

    def check_set(self, out: Path, overwrite: bool) -> None:
        """Checks output and options for several clips, as `check`."""
        from pfnn_jax.io.files import require_suffix
        from pfnn_jax.motion.clip_files import CHARACTER_SUFFIXES

        require_suffix(out, SET_SUFFIXES)
        if self.onto is not None:
            require_suffix(self.onto, CHARACTER_SUFFIXES)
        self.check(out, overwrite)

    def write(self, out: Path, clip: MotionClip, overwrite: bool, name: str | None = None) -> MotionClip:
        """Writes a clip, prints what was assumed, and returns the clip as it was cut."""
        from pfnn_jax.motion.cycles import cut_cycle
        from pfnn_jax.workflows.characters import clip_name

        clip = cut_cycle(clip) if self.loop else clip
        self.write_set(out, {name or clip_name(clip): clip}, overwrite)
        return clip

    def write_set(self, out: Path, clips: Mapping[str, MotionClip], overwrite: bool) -> None:
        """Writes clips of one skeleton by name, one if the file is BVH or VRMA, and prints what was assumed."""
        from pfnn_jax.io.files import refuse_existing, write_whole

        with self._naming_options():
            content = self._content(out, clips)
        refuse_existing(out, overwrite)
        write_whole(out, content)

    def _check_onto(self, onto: Path, out: Path) -> None:
        from pfnn_jax.io.files import require_suffix
        from pfnn_jax.motion.clip_files import CHARACTER_SUFFIXES, read_any_skeleton

        require_suffix(onto, (*CHARACTER_SUFFIXES, ".bvh"))
        kind = out.suffix.lower()
        if kind == ".vrma":
            raise InputError("command line", "onto", onto, "a .vrma file fits every VRM character: leave it out")
        if kind == ".vrm" and onto.suffix.lower() != ".vrm":
            raise InputError(out, "suffix", kind, "must be .glb: only a VRM character becomes a VRM file")
        with self._naming_options():  # a character that is not a humanoid is refused before anything slow begins
            read_any_skeleton(onto, ReadOptions(unit=self.onto_unit), self.onto_roles)

    def _content(self, out: Path, clips: Mapping[str, MotionClip]) -> bytes:
        from pfnn_jax.motion.clip_files import is_character_file
        from pfnn_jax.workflows.characters import put_clips_onto, put_onto_rig

        kind, (name, clip), unit = out.suffix.lower(), next(iter(clips.items())), {}
        if kind == ".vrma":
            from pfnn_jax.motion.gltf.vrma import vrma_bytes

            return vrma_bytes(clip, name, root_motion=self.root_motion)
        if self.onto is not None:
            notes: list[str] = []
            options: Any = {"unit": self.onto_unit, "roles_file": self.onto_roles, "note_callback": notes.append}
            if kind != ".bvh" and is_character_file(self.onto):
                content = put_clips_onto(clips, self.onto, root_motion=self.root_motion, **options)
                print_notes(self.onto, map(_about_target, notes))
                return content
            clip, metres = put_onto_rig(clip, self.onto, **options)
            print_notes(self.onto, map(_about_target, notes))
            clips, unit = {name: clip}, {"unit": metres}
        if kind == ".bvh":
            from pfnn_jax.motion.bvh import bvh_text

            return bvh_text(clip, path=out, **unit).encode()
        from pfnn_jax.motion.gltf.write import glb_bytes
        from pfnn_jax.viewer.body import grow_body

        return glb_bytes(clip.skeleton, grow_body(clip.skeleton), clips, root_motion=self.root_motion)

    @contextmanager
    def _naming_options(self) -> Iterator[None]:
        """Lets refusals of the character or rig name the options that are about it, not those about the clip."""
        try:
            yield
        except InputError as error:
            if self.onto is None or error.file not in (str(self.onto), str(self.onto_roles)):
                raise
            raise InputError(error.file, error.place, error.value, _about_target(error.rule)) from error


def _about_target(text: str) -> str:
    """Returns a note or a rule with the options of the character or rig in place of those of the clip."""
    return text.replace("--unit", "--onto-unit").replace("--roles", "--onto-roles")
