"""Puts a motion onto a user's own character: a glTF or VRM file with one more clip, or a BVH file on their rig."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import bvh_text
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.clip_files import is_gltf_file, read_rig
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.write import character_bytes
from pfnn_jax.motion.length_unit import CENTIMETRE
from pfnn_jax.motion.reading import ReadOptions
from pfnn_jax.motion.retargeting.cycle import retarget_closed

CHARACTER_SUFFIXES = (".glb", ".gltf", ".vrm")
"""Ends of the names of files that hold a character."""


def put_onto(
    clip: MotionClip,
    target: str | Path,
    *,
    root_motion: bool = False,
    name: str | None = None,
    note_callback: Callable[[str], None] | None = None,
) -> bytes:
    """Returns the file of a character or of a rig with a clip on it.

    A `.glb`, `.gltf` or `.vrm` file is returned with the clip appended, as GLB; all else in it stays as it is, see
    `gltf.append`. The clip is in place by default, as engines want it: without its travel and turns. For a BVH file,
    which holds one clip, a new BVH file of its skeleton in its unit is returned, with its travel.

    Args:
        clip: motion on any humanoid skeleton; a cycle (`cut_cycle`) stays one.
        target: file of the character or rig.
        root_motion: let the root joint of a glTF character travel, or the hips if it has none above them.
        name: of the clip in a glTF file; by default its style.
        note_callback: is called with each line on what was assumed.

    Raises:
        InputError: if the file cannot be read, or holds no humanoid.
    """
    target, say = Path(target), note_callback or (lambda note: None)
    if target.suffix.lower() == ".bvh":
        moved, unit = put_onto_rig(clip, target, note_callback=note_callback)
        return bvh_text(moved, unit=unit).encode()
    if not is_character_file(target):
        rule = f"must be a character ({', '.join(CHARACTER_SUFFIXES)}) or a BVH file of a rig"
        raise InputError(target, "suffix", target.suffix or "none", rule)
    character = read_character(target)
    for note in character.notes:
        say(note)
    moved = retarget_closed(clip, character.skeleton)
    say(moved.summary)
    return character_bytes(character, {name or clip_name(clip): moved.clip}, root_motion=root_motion)


def put_onto_rig(
    clip: MotionClip, target: str | Path, *, note_callback: Callable[[str], None] | None = None
) -> tuple[MotionClip, float]:
    """Returns a clip on the skeleton of a file, and metres per unit of a BVH file for it.

    The unit is that of a BVH file, and centimetres for other files; other arguments and errors as `put_onto`.
    """
    rig = read_rig(target, ReadOptions(travel="keep"))
    moved = retarget_closed(clip, rig.skeleton)
    if note_callback is not None:
        note_callback(moved.summary)
    known = rig.reading is not None and not is_gltf_file(target)
    return moved.clip, rig.reading.unit if known and rig.reading is not None else CENTIMETRE


def is_character_file(path: Path) -> bool:
    """Returns whether a file's name ends as those of characters do."""
    return is_gltf_file(path) and path.suffix.lower() in CHARACTER_SUFFIXES


def clip_name(clip: MotionClip) -> str:
    """Returns a name for a clip: its style, else the name of its file."""
    if clip.style not in ("", "unknown"):
        return clip.style
    return Path(clip.source).stem or "motion"
