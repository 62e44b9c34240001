"""`pfnn-jax skeleton`: what the joints of a clip's skeleton are taken for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import Positional

from pfnn_jax.cli.command import Command, Reading, print_notes
from pfnn_jax.motion.reading import ReadOptions


@dataclass(frozen=True, kw_only=True)
class Skeleton(Command):
    """Show which joint of a skeleton is taken for which part of the body, how the file is read, and what is doubtful.

    Attributes:
        clip: BVH, GLB, glTF or VRM file, with or without motion.
        roles: JSON file that names the joints of bones; the others are found.
        reading: what is known about the file, where it is not found or wrong.
    """

    clip: Annotated[Positional[Path], tyro.conf.arg(metavar="CLIP")]
    roles: Path | None = None
    reading: Reading = ReadOptions()

    def run(self) -> Any:
        from pfnn_jax.motion.clip_files import read_rig

        about = describe_skeleton(read_rig(self.clip, self.reading, self.roles))
        _print(about)
        return about


def describe_skeleton(clip: Any) -> dict[str, Any]:
    """Returns what is known of a clip's skeleton, as JSON data.

    Args:
        clip: a `MotionClip`.

    Raises:
        InputError: if the skeleton has no humanoid map.
    """
    import numpy as np

    from pfnn_jax.motion.humanoid.describe import left_out, leg_length_of, rest_axes, rest_pose_kind
    from pfnn_jax.motion.humanoid.find import need_humanoid

    skeleton = clip.skeleton
    humanoid = need_humanoid(skeleton, clip.source)
    kind = rest_pose_kind(skeleton, humanoid)
    up, facing = ("", "") if kind == "none" else rest_axes(skeleton, humanoid)
    own = np.arange(skeleton.num_joints)
    names = skeleton.names
    return {
        "file": clip.source,
        "joints": skeleton.num_joints,
        "map": humanoid.names(names),
        "left_out": left_out(skeleton, humanoid),
        "rest_pose": kind,
        "up": up,
        "facing": facing,
        "leg_metres": leg_length_of(skeleton, humanoid),
        "reading": None if clip.reading is None else clip.reading.to_json(),
        "notes": list(clip.notes),
        "pairs": [[names[j], names[k]] for j, k in enumerate(skeleton.mirror) if j < k],
        "midline": [names[j] for j in own[skeleton.mirror == own]],
        "confidence": round(humanoid.confidence, 3),
        "explanation": list(humanoid.explanation),
    }


def _print(about: dict[str, Any]) -> None:
    """Prints a description of a skeleton, one line for each bone of both sides."""
    found = about["map"]
    print(f"{about['file']}: {about['joints']} joints, {len(about['left_out'])} of them in no part of the body")
    for bone in ("hips", "spine", "neck", "head"):
        print(f"  {bone:<10} {_shown(found[bone])}")
    width = max(len(_shown(found[bone])) for bone in found if bone.startswith("left_"))
    print(f"  {'':<10} {'left':<{width}}  right")
    for part in ("clavicle", "upper_arm", "lower_arm", "hand", "thigh", "shin", "foot", "toe"):
        print(f"  {part:<10} {_shown(found[f'left_{part}']):<{width}}  {_shown(found[f'right_{part}'])}".rstrip())
    axes = f", {about['up']} up, faces {about['facing'] or 'no axis'}" if about["up"] else ""
    print(f"rest pose: {about['rest_pose']}{axes}")
    if about["reading"] is not None:
        from pfnn_jax.motion.length_unit import unit_name

        read = about["reading"]
        print(f"file: unit {unit_name(read['unit'])}, {read['up']} up, {read['fps']:.4g} frames per second")
    print(f"legs: {about['leg_metres']:.2f} m")
    print(f"pairs: {len(about['pairs'])} of left and right, {len(about['midline'])} joints on the midline")
    print(f"confidence: {about['confidence']:.2f}")
    for line in about["explanation"]:
        print(f"  {line}")
    print_notes(about["file"], about["notes"])


def _shown(joint: str | list[str] | None) -> str:
    """Returns the name of a bone's joint, or of its joints, as text; a dash where there is none."""
    if isinstance(joint, list):
        return ", ".join(joint) or "-"
    return joint or "-"
