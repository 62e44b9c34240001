"""Reads motion clips and skeletons from files of every format: BVH, and glTF as `.glb`, `.gltf`, `.vrm` and `.vrma`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.motion.assumptions import repair
from pfnn_jax.motion.bvh import read_skeleton, read_whole
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.animations import clip_names
from pfnn_jax.motion.gltf.clips import read_gltf_clip, read_gltf_rig
from pfnn_jax.motion.gltf.container import read_document
from pfnn_jax.motion.reading import ReadOptions, Travel, Up, check_options
from pfnn_jax.motion.skeleton import Skeleton

CHARACTER_SUFFIXES = (".glb", ".gltf", ".vrm")
"""Ends of the names of files that hold a character, in small letters."""

GLTF_SUFFIXES = (*CHARACTER_SUFFIXES, ".vrma")
CLIP_SUFFIXES = (".bvh", *GLTF_SUFFIXES)
"""Ends of the names of files that hold motion, in small letters."""


def is_clip_file(path: str | Path) -> bool:
    """Returns whether a file's name ends as those of clips do."""
    return Path(path).suffix.lower() in CLIP_SUFFIXES


def is_character_file(path: str | Path) -> bool:
    """Returns whether a file's name ends as those of characters do."""
    return Path(path).suffix.lower() in CHARACTER_SUFFIXES


def is_gltf_file(path: str | Path) -> bool:
    """Returns whether a file's name ends as those of glTF files do, whose lengths are in metres."""
    return Path(path).suffix.lower() in GLTF_SUFFIXES


def read_clip(
    path: str | Path,
    *,
    unit: float | str | None = None,
    up: Up = "auto",
    source_fps: float | None = None,
    travel: Travel = "auto",
    clip_name: str | None = None,
    roles_file: str | Path | None = None,
) -> MotionClip:
    """Reads a clip of a file whose suffix is one of `CLIP_SUFFIXES`; other files are read as BVH.

    What a file does not state, or states wrongly, is found from its motion (`reading.ReadOptions`,
    `MotionClip.reading`), and walks on the spot are made to travel, whatever the format. See `bvh.read_bvh` and
    `gltf.clips.read_gltf_clip`.

    Args:
        path: file to read.
        unit: metres per unit of the file, or a name in `length_unit.UNITS`.
        up: the axis that points up.
        source_fps: frames per second, in place of the file's own.
        travel: whether to rebuild the travel of walks on the spot.
        clip_name: which clip of a glTF file.
        roles_file: JSON from role to joint name, see `assign_roles`.

    Returns:
        The clip, with style `unknown` and empty content.

    Raises:
        InputError: if the file is malformed or holds no such clip; for legs or speeds that no person has.
    """
    options = ReadOptions(unit, up, source_fps, travel, clip_name)  # type: ignore[arg-type] # checked by read_whole_clip
    return repair(read_whole_clip(path, options, roles_file), options)


def read_whole_clip(path: str | Path, options: ReadOptions, roles_file: str | Path | None = None) -> MotionClip:
    """Reads all frames of a clip, as `read_clip` without `assumptions.repair`.

    Args:
        path: file to read.
        options: what is known about the file.
        roles_file: as in `read_clip`.

    Raises:
        InputError: as `read_clip`.
    """
    check_options(options, path)
    if is_gltf_file(path):
        return read_gltf_clip(path, options, roles_file)
    if options.clip_name is not None:
        raise InputError(path, "clip name", ascii(options.clip_name), "a BVH file has one clip without a name")
    return read_whole(path, options, roles_file)


def read_rig(path: str | Path, options: ReadOptions, roles_file: str | Path | None = None) -> MotionClip:
    """Reads what a file says about its skeleton, as a clip.

    Args:
        path: a BVH file, whose frames are read, or a glTF file, whose character stands in its bind pose for one frame
            unless `options.clip_name` names a clip of it, or it holds motion only.
        options: what is known about the file.
        roles_file: as in `read_clip`.

    Raises:
        InputError: as `read_clip`.
    """
    if is_gltf_file(path) and options.clip_name is None and read_document(path).items("skins"):
        return read_gltf_rig(path, options, roles_file)
    return read_whole_clip(path, options, roles_file)


def read_target(path: str | Path, options: ReadOptions, roles_file: str | Path | None = None) -> MotionClip:
    """Reads a rig that motion is put onto: as `read_rig`, with the resting heights of its feet if it moves.

    Args:
        path: file to read, with or without motion.
        options: what is known about the file; its travel is kept.
        roles_file: as in `read_clip`.

    Raises:
        InputError: as `read_clip`.
    """
    options = replace(options, travel="keep")
    clip = read_rig(path, options, roles_file)
    return repair(clip, options) if clip.num_frames > 1 else clip


def list_clip_names(path: str | Path) -> list[str]:
    """Returns the names of the clips of a glTF file, which may be none; empty for a BVH file.

    Raises:
        InputError: if the file cannot be read.
    """
    return clip_names(read_document(path)) if is_gltf_file(path) else []


def read_any_skeleton(
    path: str | Path, options: ReadOptions | None = None, roles_file: str | Path | None = None
) -> Skeleton:
    """Reads the skeleton of a file with its humanoid map, in metres, from the hips downwards.

    Args:
        path: file to read, with or without motion.
        options: what is known about the file.
        roles_file: as in `read_clip`.

    Raises:
        InputError: as `read_clip`.
    """
    return read_target(path, options or ReadOptions(), roles_file).skeleton


def read_joints(path: str | Path) -> Skeleton:
    """Reads the joints of a file without motion or map: of a BVH file as its hierarchy, in its unit.

    Raises:
        InputError: if the file cannot be read.
    """
    if is_gltf_file(path):
        return read_any_skeleton(path)
    return read_skeleton(path)
