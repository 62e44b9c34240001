"""Finds the skeleton that clips of several skeletons are put onto, or says that they need one."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.clip_files import read_joints
from pfnn_jax.motion.datasets.labelled import read_cut_clip
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.hands import extend_hands
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.reading import ReadOptions
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.roles import roles_of
from pfnn_jax.motion.skeleton import Skeleton, need_roles, plain_names, skeleton_from_json, skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton

SYNTHETIC = "synthetic"
"""Name of the procedural walkers' skeleton."""

ADVICE = "or put all clips onto one skeleton (--skeleton)"
"""What to do about clips of different skeletons."""


def named_skeleton(name: str, clips: Sequence[ClipFile], reading: ReadOptions | None = None) -> Skeleton | ClipFile:
    """Returns the skeleton of a name, or the clip that has it.

    Args:
        name: a file, `synthetic`, or the name or path of a folder of the clips, whose first clip is taken.
        clips: as `list_data_sets` returns them.
        reading: what is known about the file, if it is not among the clips.

    Raises:
        InputError: for any other name.
    """
    path = Path(name)
    if path.is_file():
        return list_clips(path, reading=reading)[0]
    if name == SYNTHETIC:
        return synthetic_skeleton()
    for clip in clips:
        if name == clip.data_set or (path.is_dir() and path.resolve() in clip.path.resolve().parents):
            return clip
    names = ", ".join(dict.fromkeys(clip.data_set for clip in clips))
    raise InputError(
        "--skeleton", "name", name, f"must be a BVH or glTF file, {SYNTHETIC}, or one of the folders: {names}"
    )


def find_target(
    skeleton: Skeleton | ClipFile | str | Path,
    clips: Sequence[ClipFile],
    layout: FrameLayout,
    roles_file: Path | None = None,
) -> Skeleton:
    """Returns the skeleton that clips are put onto, with what retargeting needs, as `dataset.json` stores it.

    Args:
        skeleton: it, or a BVH or glTF file that has it.
        clips: all clips; if the file is among them, it is read as they are.
        layout: if it has the ends of hands as joints, the skeleton gets them.
        roles_file: JSON file that names the joints' roles, for a file.

    Raises:
        InputError: if the file cannot be read or is not a file, or if the skeleton is not a humanoid with all roles.
    """
    source = "skeleton"
    if not isinstance(skeleton, Skeleton):
        clip_file = _clip_file(skeleton, clips)
        source, skeleton = str(clip_file.path), read_cut_clip(clip_file, roles_file).clip.skeleton
    need_roles(skeleton, source)
    skeleton = replace(skeleton, humanoid=humanoid_of(skeleton, source))
    if layout.next_frame:
        skeleton = extend_hands(_at_rest(skeleton)).skeleton
    return skeleton_from_json(skeleton_to_json(skeleton), source)


def ends_in_hand_sites(skeleton: Skeleton) -> bool:
    """Returns whether the ends of a skeleton's hands are joints, as `extend_hands` makes them.

    Then the roles of the hands are not those of the map.
    """
    moved = extend_hands(_at_rest(replace(skeleton, end_sites=()))).skeleton  # no joints are added, only roles moved
    return need_roles(moved).left_hand != roles_of(need_humanoid(moved), moved.names).left_hand


def check_one_skeleton(clips: Sequence[ClipFile]) -> None:
    """Refuses data sets of different joints, by the first readable clip of each.

    Raises:
        InputError: naming the first clip that has other joints, and what to do.
    """
    first: dict[str, tuple[ClipFile, tuple[str, ...]]] = {}
    for clip in clips:
        if clip.data_set not in first:
            with suppress(InputError):
                first[clip.data_set] = clip, plain_names(read_joints(clip.path).names)
    known: tuple[ClipFile, tuple[str, ...]] | None = None
    for clip, names in first.values():
        known = known or (clip, names)
        if sorted(names) != sorted(known[1]):
            rule = f"must be that of {known[0].data_set}, of {len(known[1])} joints, {ADVICE}"
            raise InputError(clip.path, "skeleton", f"{len(names)} joints", rule)


def _clip_file(path: ClipFile | str | Path, clips: Sequence[ClipFile]) -> ClipFile:
    if isinstance(path, ClipFile):
        given = path
    else:
        if Path(path).is_dir():
            raise InputError(path, "skeleton", "a folder", "must be a BVH or glTF file")
        given = list_clips(path)[0]
    same = given.path.resolve()
    return next((clip for clip in clips if clip.path.resolve() == same), given)


def _at_rest(skeleton: Skeleton) -> MotionClip:
    """Returns a clip of one frame without rotations."""
    rotations = np.zeros((1, skeleton.num_joints, 4))
    rotations[..., 0] = 1.0
    return MotionClip(skeleton, 60.0, np.zeros((1, 3)), rotations)
