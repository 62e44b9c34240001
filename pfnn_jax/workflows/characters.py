"""Puts a motion onto a user's own character: a glTF or VRM file with one more clip, or a BVH file on their rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import bvh_text
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.clip_files import CHARACTER_SUFFIXES, is_character_file, is_gltf_file, read_target
from pfnn_jax.motion.gltf.append import unused_name
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.write import character_bytes
from pfnn_jax.motion.length_unit import CENTIMETRE
from pfnn_jax.motion.reading import ReadOptions, check_options
from pfnn_jax.motion.retargeting.cycle import retarget_closed
from pfnn_jax.motion.retargeting.retarget import Retargeted
from pfnn_jax.motion.skeleton import Skeleton


def put_onto(
    clip: MotionClip,
    target: str | Path,
    *,
    root_motion: bool = False,
    name: str | None = None,
    unit: float | str | None = None,
    roles_file: str | Path | None = None,
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
        unit: of the target, metres or a name in `length_unit.UNITS`; by default it is found.
        roles_file: JSON from bone or role to joint name of the target, for joints that are found wrongly.
        note_callback: is called with each line on what was assumed.

    Raises:
        InputError: if the file cannot be read, or holds no humanoid.
    """
    target = Path(target)
    if target.suffix.lower() == ".bvh":
        moved, metres = put_onto_rig(clip, target, unit=unit, roles_file=roles_file, note_callback=note_callback)
        return bvh_text(moved, unit=metres).encode()
    if not is_character_file(target):
        rule = f"must be a character ({', '.join(CHARACTER_SUFFIXES)}) or a BVH file of a rig"
        raise InputError(target, "suffix", target.suffix or "none", rule)
    clips = {name or clip_name(clip): clip}
    options: dict[str, Any] = {"unit": unit, "roles_file": roles_file, "note_callback": note_callback}
    return put_clips_onto(clips, target, root_motion=root_motion, **options)


def put_clips_onto(
    clips: Mapping[str, MotionClip],
    target: str | Path,
    *,
    root_motion: bool = False,
    unit: float | str | None = None,
    roles_file: str | Path | None = None,
    note_callback: Callable[[str], None] | None = None,
) -> bytes:
    """Returns the file of a character with clips of one skeleton appended under their names; see `put_onto`."""
    say = note_callback or (lambda note: None)
    character = read_character(target, unit=_options(unit, target).metres, roles_file=roles_file)
    for note in character.notes:
        say(note)
    if character.document.path.suffix.lower() == ".gltf":
        say("its buffers and images are packed into one GLB file")
    moved = {name: _retarget(clip, character.skeleton, target) for name, clip in clips.items()}
    say(next(iter(moved.values())).summary)
    for name in moved:
        if (used := unused_name(name, character.document.items("animations"))) != name:
            say(f"it has a clip {name!r} already: the new one is called {used!r}")
    return character_bytes(character, {name: each.clip for name, each in moved.items()}, root_motion=root_motion)


def put_onto_rig(
    clip: MotionClip,
    target: str | Path,
    *,
    unit: float | str | None = None,
    roles_file: str | Path | None = None,
    note_callback: Callable[[str], None] | None = None,
) -> tuple[MotionClip, float]:
    """Returns a clip on the skeleton of a file, and metres per unit of a BVH file for it.

    The unit is that of a BVH file, and centimetres for other files; other arguments and errors as `put_onto`.
    """
    rig = read_target(target, _options(unit, target), roles_file)
    moved = _retarget(clip, rig.skeleton, target)
    for note in (*rig.notes, moved.summary):
        if note_callback is not None:
            note_callback(note)
    return moved.clip, CENTIMETRE if is_gltf_file(target) or rig.reading is None else rig.reading.unit


def _retarget(clip: MotionClip, skeleton: Skeleton, target: str | Path) -> Retargeted:
    """Returns the clip on the skeleton of a file, which a refusal of the skeleton names."""
    try:
        return retarget_closed(clip, skeleton)
    except InputError as error:
        if error.file != "skeleton":
            raise
        raise InputError(target, error.place, error.value, error.rule) from None


def _options(unit: float | str | None, target: str | Path) -> ReadOptions:
    """Returns how a target is read; raises `InputError` for a unit that is none."""
    options = ReadOptions(unit=unit)  # type: ignore[arg-type] # checked at once
    check_options(options, target)
    return options


def clip_name(clip: MotionClip) -> str:
    """Returns a name for a clip: its style, else the name of its file."""
    if clip.style not in ("", "unknown"):
        return clip.style
    return Path(clip.source).stem or "motion"
