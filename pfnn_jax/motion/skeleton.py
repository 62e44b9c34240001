"""The skeleton: its joints, and the roles that some of them have in locomotion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.humanoid.map import HumanoidMap, map_from_json, map_to_json


@dataclass(frozen=True)
class Roles:
    """Indices of the joints that labels and features need.

    Attributes:
        hips: joint from which both legs and the spine descend.
        left_hip, right_hip: upper-leg joints.
        left_shoulder, right_shoulder: upper-arm joints.
        left_foot, right_foot: (heel, toe), where the heel is the ankle joint.
        left_hand, right_hand: wrist joints.
        head: head joint.
    """

    hips: int
    left_hip: int
    right_hip: int
    left_shoulder: int
    right_shoulder: int
    left_foot: tuple[int, int]
    right_foot: tuple[int, int]
    left_hand: int
    right_hand: int
    head: int


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of joints with rigid bones.

    Attributes:
        names: J joint names.
        parents: [J] parent index, -1 for the root; parents come before their children.
        offsets: [J, 3] metres, from the parent's origin in the parent's frame.
        end_sites: (joint index, offset [3] in metres) of every End Site.
        mirror: [J] index of each joint's left-right partner, its own index on the midline.
        roles: of the joints, or None if they were not found: a view of `humanoid`, except that `extend_hands` moves the
            hands to their tips.
        humanoid: the humanoid map, or None if it was not found.
        reference: [J, 4] world rotations of the joints in a T pose that faces +Z, where the zero pose does not show
            it (see `retargeting.reference`); else None.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    offsets: np.ndarray
    end_sites: tuple[tuple[int, np.ndarray], ...]
    mirror: np.ndarray
    roles: Roles | None = None
    humanoid: HumanoidMap | None = None
    reference: np.ndarray | None = None

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.names)


def rest_pose(skeleton: Skeleton) -> np.ndarray:
    """Returns joint positions [J, 3] with all rotations zero."""
    pose = np.zeros((skeleton.num_joints, 3))
    for joint in range(1, skeleton.num_joints):
        pose[joint] = pose[skeleton.parents[joint]] + skeleton.offsets[joint]
    return pose


def need_roles(skeleton: Skeleton, source: str | Path = "skeleton") -> Roles:
    """Returns the skeleton's roles.

    Raises:
        InputError: if the roles were not found when the skeleton was read.
    """
    if skeleton.roles is None:
        rule = "hips, shoulders and feet must be found, or named in a roles file"
        raise InputError(source, "skeleton", f"joints {', '.join(skeleton.names)}", rule)
    return skeleton.roles


def check_same_topology(skeleton: Skeleton, other: Skeleton, source: str | Path) -> None:
    """Refuses a skeleton with other joints. Bones may differ in length, because features hold joint positions.

    Args:
        skeleton: the expected one.
        other: the skeleton of the clip from `source`.
        source: file, for the message.

    Raises:
        InputError: naming the first joint that differs.
    """
    if other.num_joints != skeleton.num_joints:
        extra = sorted(set(other.names) ^ set(skeleton.names))
        found = f"{other.num_joints} joints, {extra[:1]} differs"
        raise InputError(source, "skeleton", found, f"all clips share one skeleton, of {skeleton.num_joints} joints")
    for joint, (name, wanted) in enumerate(zip(other.names, skeleton.names, strict=True)):
        if name != wanted or other.parents[joint] != skeleton.parents[joint]:
            found = f"{name} under joint {other.parents[joint]}"
            rule = f"all clips share one skeleton, here {wanted} under {skeleton.parents[joint]}"
            raise InputError(source, f"joint {joint}", found, rule)


def skeleton_to_json(skeleton: Skeleton) -> dict[str, Any]:
    """Returns the skeleton as JSON data, exact to the last bit."""
    return {
        "names": list(skeleton.names),
        "parents": [int(p) for p in skeleton.parents],
        "offsets": np.asarray(skeleton.offsets, np.float64).tolist(),
        "end_sites": [[int(joint), np.asarray(offset, np.float64).tolist()] for joint, offset in skeleton.end_sites],
        "mirror": [int(m) for m in skeleton.mirror],
        "roles": None if skeleton.roles is None else {k: _plain(v) for k, v in asdict(skeleton.roles).items()},
        "humanoid": None if skeleton.humanoid is None else map_to_json(skeleton.humanoid),
        "reference": None if skeleton.reference is None else np.asarray(skeleton.reference, np.float64).tolist(),
    }


def skeleton_from_json(data: Mapping[str, Any], source: str | Path = "skeleton") -> Skeleton:
    """Returns the skeleton that `skeleton_to_json` described; files of earlier versions have no humanoid map.

    Args:
        data: as `skeleton_to_json` returns it.
        source: file it was read from, for messages.

    Raises:
        InputError: if an entry is missing, or does not have one value for each joint.
    """
    missing = [k for k in ("names", "parents", "offsets", "end_sites", "mirror", "roles") if k not in data]
    if missing:
        raise InputError(source, "skeleton", f"no {', '.join(missing)}", "must have all entries of a skeleton")
    joints = len(data["names"])
    for key in ("parents", "offsets", "mirror"):
        if len(data[key]) != joints:
            rule = f"must have one for each of {joints} joints"
            raise InputError(source, f"skeleton.{key}", f"{len(data[key])} entries", rule)
    roles, humanoid, reference = data["roles"], data.get("humanoid"), data.get("reference")
    return Skeleton(
        names=tuple(data["names"]),
        parents=np.array(data["parents"], np.int64),
        offsets=np.array(data["offsets"], np.float64).reshape(joints, 3),
        end_sites=tuple((int(joint), np.array(offset, np.float64)) for joint, offset in data["end_sites"]),
        mirror=np.array(data["mirror"], np.int64),
        roles=None if roles is None else _roles(roles),
        humanoid=None if humanoid is None else map_from_json(humanoid),
        reference=None if reference is None else np.array(reference, np.float64).reshape(joints, 4),
    )


def _roles(data: Mapping[str, Any]) -> Roles:
    joints: dict[str, Any] = {name: tuple(role) if isinstance(role, list) else role for name, role in data.items()}
    return Roles(**joints)


def _plain(role: Any) -> Any:
    return [int(i) for i in role] if isinstance(role, tuple) else int(role)
