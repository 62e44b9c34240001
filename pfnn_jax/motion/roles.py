"""The roles of joints in locomotion: a view of the humanoid map."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.humanoid.find import find_humanoid
from pfnn_jax.motion.humanoid.lexicon import HIPS_WORDS, trunk_part
from pfnn_jax.motion.humanoid.map import ARM, LEG, SIDES, HumanoidMap
from pfnn_jax.motion.humanoid.names import read_names, words_of
from pfnn_jax.motion.humanoid.overrides import listed, read_overrides_file, rename_joints
from pfnn_jax.motion.humanoid.pairs import find_mirror
from pfnn_jax.motion.humanoid.tree import joint_tree
from pfnn_jax.motion.skeleton import Roles, Skeleton

ROLE_NAMES = tuple(field.name for field in fields(Roles))


def chain_up(parents: np.ndarray, joint: int) -> list[int]:
    """Returns the joint and all its ancestors, up to the root."""
    return list(joint_tree(tuple(parents.tolist())).above(joint))


def longest_chain(skeleton: Skeleton) -> float:
    """Returns the length of the longest chain of bones from the root, without End Sites, in the skeleton's unit."""
    lengths, reach = np.linalg.norm(skeleton.offsets, axis=1).tolist(), [0.0] * skeleton.num_joints
    for joint, parent in enumerate(skeleton.parents.tolist()[1:], start=1):
        reach[joint] = reach[parent] + lengths[joint]
    return max(reach)


def roles_of(humanoid: HumanoidMap, names: tuple[str, ...], source: str | Path = "skeleton") -> Roles:
    """Returns the roles of the joints in a map.

    Where a rig has no hand or no toe, the lower arm and the ankle take their roles.

    Args:
        humanoid: the map.
        names: of the joints, for messages.
        source: file to name in messages.

    Raises:
        InputError: if the body has no arms, feet or head.
    """
    if missing := missing_roles(humanoid):
        rule = f"must have a joint for {', '.join(missing)}; name it in a file of overrides (--roles)"
        raise InputError(source, "skeleton", f"joints {listed(names)}", rule)
    return Roles(**_joints_of_roles(humanoid))


def missing_roles(humanoid: HumanoidMap) -> list[str]:
    """Returns the roles that no joint of a map can take."""
    joints = _joints_of_roles(humanoid)
    return [role for role in ROLE_NAMES if joints[role] is None]


def _joints_of_roles(humanoid: HumanoidMap) -> dict[str, Any]:
    """Returns role -> joint, or (ankle, toe) for feet; None where the body has none."""
    roles: dict[str, Any] = {"hips": humanoid.hips, "head": humanoid.head}
    for side in SIDES:
        thigh, _, foot, toe = humanoid.limb(side, LEG)
        _, upper, lower, hand = humanoid.limb(side, ARM)
        roles[f"{side}_hip"], roles[f"{side}_shoulder"] = thigh, upper
        roles[f"{side}_hand"] = lower if hand is None else hand
        roles[f"{side}_foot"] = None if foot is None else (foot, foot if toe is None else toe)
    return roles


def find_roles(
    skeleton: Skeleton,
    overrides: Mapping[str, Any] | None = None,
    source: str | Path = "skeleton",
    *,
    poses: Callable[[], np.ndarray] | np.ndarray | None = None,
) -> Roles:
    """Finds the roles of a skeleton by its humanoid map; see `find_humanoid`.

    Raises:
        InputError: if there is no such map, or it has no arms, feet or head.
    """
    humanoid = find_humanoid(skeleton, poses=poses, overrides=overrides, source=source)
    return roles_of(humanoid, skeleton.names, source)


def assign_roles(
    skeleton: Skeleton,
    roles_file: Path | None = None,
    source: str | Path = "skeleton",
    *,
    poses: Callable[[], np.ndarray] | np.ndarray | None = None,
    merged: Collection[str] = (),
) -> Skeleton:
    """Returns the skeleton with humanoid map, roles and left-right partners filled in.

    Without a file of overrides, the map is None if it cannot be found; with one, this is an error. Roles are None
    without a map, and where the body has no arms, feet or head.

    Args:
        skeleton: the joints.
        roles_file: JSON object from bone or role to joint name, such as
            `{"hips": "Pelvis", "left_foot": ["Ankle_L", "Ball_L"]}`. Bones that it does not name are found as usual.
        source: file to name in messages.
        poses: as in `find_humanoid`.
        merged: names of joints that reading merged into joint 0; the file may call it by them.

    Raises:
        InputError: if the file is not such a JSON object, or names an unknown bone, or an unknown or impossible joint.
    """
    humanoid = None
    try:
        overrides = None
        if roles_file is not None:
            called = dict.fromkeys(merged, skeleton.names[0])
            overrides = rename_joints(read_overrides_file(Path(roles_file)), called)
        humanoid = find_humanoid(skeleton, poses=poses, overrides=overrides, source=roles_file or source)
    except InputError:
        if roles_file is not None:
            raise
    roles = None if humanoid is None or missing_roles(humanoid) else roles_of(humanoid, skeleton.names, source)
    return replace(skeleton, mirror=find_mirror(skeleton, humanoid), roles=roles, humanoid=humanoid)


def is_hips_name(name: str) -> bool:
    """Returns whether a joint's name means hips."""
    words = [word for word in words_of(name.rsplit(":", 1)[-1]) if not word.isdigit()]
    return bool(words) and words[-1] in HIPS_WORDS - {"hip"}


def is_upper_body_name(name: str) -> bool:
    """Returns whether a joint's name means head, neck or spine: such a joint above the hips is one of the body."""
    (label,) = read_names((name,))
    return trunk_part(label) in ("head", "neck", "spine") and label.part != "body"
