"""Reads a user's choice of joints for bones: a small JSON file, or a dictionary."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError
from pfnn_jax.motion.humanoid.map import BONES, CHAINS, SIDES

ROLES = {"hip": "thigh", "shoulder": "upper_arm"}
"""Names of roles, after the side, that differ from the bone's."""

ALWAYS = ("hips", *(f"{side}_{part}" for side in SIDES for part in ("thigh", "shin")))
"""Bones that every map has."""

_VRM_PARTS = {
    "UpperLeg": "thigh",
    "LowerLeg": "shin",
    "Foot": "foot",
    "Toes": "toe",
    "Shoulder": "clavicle",
    "UpperArm": "upper_arm",
    "LowerArm": "lower_arm",
    "Hand": "hand",
}
VRM_BONES = {f"{side}{part}": f"{side}_{bone}" for side in SIDES for part, bone in _VRM_PARTS.items()}
"""Bones of a VRM humanoid -> bones of the map, apart from hips, neck and head, which are called alike."""

VRM_SPINE = ("spine", "chest", "upperChest")
VRM_LEFT_OUT = ("Thumb", "Index", "Middle", "Ring", "Little", "Eye", "jaw")

Chosen = dict[str, int | tuple[int, ...] | None]
"""Bone -> joint, joints for spine and neck, or None for a bone that the skeleton does not have."""


def read_overrides_file(path: Path) -> dict[str, Any]:
    """Returns the JSON object of a file of overrides.

    Raises:
        InputError: if it cannot be read, or is not a JSON object.
    """
    rule = "must be a JSON object from bone to joint name"
    try:
        loaded = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, "file", error.strerror or error, "must be a readable JSON file") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", error, rule) from None
    if not isinstance(loaded, dict):
        raise InputError(path, "file", type(loaded).__name__, rule)
    return loaded


def rename_joints(overrides: Mapping[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Returns overrides with joints called by other names.

    Args:
        overrides: as in `choose_joints`.
        names: old name -> new name; other names are kept.
    """

    def renamed(value: Any) -> Any:
        if isinstance(value, list):
            return [renamed(each) for each in value]
        return names.get(value, value) if isinstance(value, str) else value

    return {bone: renamed(value) for bone, value in overrides.items()}


def choose_joints(overrides: Mapping[str, Any], names: Sequence[str], source: str | Path) -> Chosen:
    """Returns the joints that overrides name.

    Args:
        overrides: bone of the map (`left_thigh`), role (`left_hip`, `left_shoulder`) or VRM bone (`leftUpperLeg`) ->
            joint name; a list of names for spine and neck; `[ankle, toe]` or one name for a foot without a toe; null
            for a bone that the skeleton does not have.
        names: of the joints.
        source: file, for messages.

    Raises:
        InputError: for an unknown bone or joint, or two entries that contradict each other.
    """
    chosen: Chosen = {}
    for key, value in _without_vrm_spine(overrides).items():
        for bone, joints in _bones_of(key, value, names, source).items():
            if bone in chosen and chosen[bone] != joints:
                raise InputError(source, f"bone {key}", ascii(value), f"contradicts another entry for {bone}")
            chosen[bone] = joints
    for side in SIDES:  # a foot that is named alone has no toe; VRM bones name both
        if isinstance(overrides.get(f"{side}_foot"), str | list):
            chosen.setdefault(f"{side}_toe", None)
    _refuse_shared(chosen, names, source)
    return chosen


def _without_vrm_spine(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Returns overrides in which chest and upper chest of a VRM humanoid are joints of the spine."""
    if "chest" not in overrides and "upperChest" not in overrides:
        return dict(overrides)
    spine = [overrides[bone] for bone in VRM_SPINE if overrides.get(bone)]
    return {**{k: v for k, v in overrides.items() if k not in VRM_SPINE}, "spine": spine}


def _bones_of(key: str, value: Any, names: Sequence[str], source: str | Path) -> Chosen:
    """Returns the bones that one entry sets: one, or foot and toe; none for VRM bones of face and fingers."""
    bone = _bone_called(key)
    if bone is None:
        if any(word in key for word in VRM_LEFT_OUT):
            return {}
        raise InputError(source, "bone", ascii(key), f"must be one of {', '.join(BONES)}, or a role such as left_hip")
    if value is None and bone not in ALWAYS:
        return {bone: () if bone in CHAINS else None}
    foot = bone.endswith("_foot")
    listed = [value] if isinstance(value, str) else value
    if not isinstance(listed, list) or (bone not in CHAINS and len(listed) not in ((1, 2) if foot else (1,))):
        rule = "must name one joint, a list of joints for spine and neck, or [ankle, toe] for a foot"
        raise InputError(source, f"bone {key}", ascii(value), rule)
    joints = tuple(_joint_called(name, key, names, source) for name in listed)
    if bone in CHAINS:
        return {bone: joints}
    if len(joints) == 2:
        toe = joints[1] if joints[1] != joints[0] else None
        return {bone: joints[0], bone.replace("_foot", "_toe"): toe}
    return {bone: joints[0]}


def _bone_called(key: str) -> str | None:
    """Returns the bone that a key of overrides means, or None."""
    if key in BONES:
        return key
    side, _, part = key.partition("_")
    if side in SIDES and part in ROLES:
        return f"{side}_{ROLES[part]}"
    return VRM_BONES.get(key)


def _joint_called(name: Any, key: str, names: Sequence[str], source: str | Path) -> int:
    """Returns the index of a joint name."""
    if name not in names:
        raise InputError(source, f"bone {key}", ascii(name), f"must be one of the joints {listed(names)}")
    return names.index(name)


def _refuse_shared(chosen: Chosen, names: Sequence[str], source: str | Path) -> None:
    """Refuses a joint that is chosen for two bones, unless a toe is its own foot."""
    owners: dict[int, str] = {}
    for bone, joints in chosen.items():
        for joint in joints if isinstance(joints, tuple) else () if joints is None else (joints,):
            owner = owners.setdefault(joint, bone)
            if owner != bone:
                raise InputError(source, f"bone {bone}", ascii(names[joint]), f"is also {owner}; must be another joint")


def listed(names: Sequence[str]) -> str:
    """Returns the first joint names as one printable line."""
    shown = ", ".join(name if name.isprintable() else ascii(name) for name in names[:12])
    return shown if len(names) <= 12 else f"{shown} and {len(names) - 12} more"
