"""The skeleton: its joints, and the roles that some of them have in locomotion."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import failure
from pfnn_jax.motion.humanoid.map import HumanoidMap, map_from_json, map_to_json

ALIKE = 10.0
"""Degrees by which bones of two people on one rig may differ in direction at rest; others are retargeted."""

SAME_DIRECTION = 35.0
"""Degrees by which bones of people of other build may differ in the rest pose."""

MAX_JOINTS = 4_000
"""Most joints of a stored skeleton and of a layout: readers of clips allow 2,000, and the ends of hands are added."""

LONG_BONE = 0.3
"""Share of the longest bone from which on a bone's direction is compared: clavicles and fingers vary more."""


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
        poses: [N, J, 4] local rotations of some poses of a motion, or None. They show how the body stands where the
            zero pose does not.
        reference: [J, 4] world rotations of the joints in the reference pose (`retargeting.reference`), or None where
            the zero pose or `poses` show it.
        resting_heights: [2, 2] metres above y = 0 of the ankle and the toe joint (columns) of the left and the right
            foot (rows) while it stands flat in motion on this skeleton (`retargeting.resting`), or None if unknown.
            Without a toe joint the second is the first.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    offsets: np.ndarray
    end_sites: tuple[tuple[int, np.ndarray], ...]
    mirror: np.ndarray
    roles: Roles | None = None
    humanoid: HumanoidMap | None = None
    poses: np.ndarray | None = None
    reference: np.ndarray | None = None
    resting_heights: np.ndarray | None = None

    @property
    def num_joints(self) -> int:
        """J."""
        return len(self.names)


def rest_pose(skeleton: Skeleton) -> np.ndarray:
    """Returns joint positions [J, 3] with all rotations zero."""
    return _rest_pose(skeleton).copy()


@functools.lru_cache(maxsize=64)  # retargeting asks for it several times a frame
def _rest_pose(skeleton: Skeleton) -> np.ndarray:
    pose = np.zeros((skeleton.num_joints, 3))
    for joint in range(1, skeleton.num_joints):
        pose[joint] = pose[skeleton.parents[joint]] + skeleton.offsets[joint]
    return pose


def need_roles(skeleton: Skeleton, source: str | Path = "skeleton") -> Roles:
    """Returns the skeleton's roles.

    Raises:
        InputError: if the roles were not found when the skeleton was read, with the reason where the pose of zero
            rotations shows it.
    """
    if skeleton.roles is None:
        from pfnn_jax.motion.roles import find_roles  # which imports this module

        find_roles(skeleton, source=source)
        rule = "hips, shoulders and feet must be found, or named in a roles file"
        raise InputError(source, "skeleton", f"joints {', '.join(skeleton.names)}", rule)
    return skeleton.roles


def plain_names(names: tuple[str, ...]) -> tuple[str, ...]:
    """Returns joint names without what exporters add to all of them: a namespace, a common prefix, a number at the end.

    `mixamorig:Hips`, `Character1_Hips` and `Hips_01` all become `Hips`.
    """
    plain = [name.rsplit(":", 1)[-1] for name in names]
    if all(re.search(r"._\d+$", name) for name in plain):
        plain = [re.sub(r"_\d+$", "", name) for name in plain]
    prefix = re.match(r"(?:.*[_| ])?", os.path.commonprefix(plain))
    if len(plain) > 1 and prefix is not None:
        plain = [name[prefix.end() :] or name for name in plain]
    return tuple(plain)


def rest_directions_differ(
    skeleton: Skeleton, other: Skeleton, limit: float = SAME_DIRECTION
) -> tuple[int, float] | None:
    """Returns the joint whose bones differ most in direction between two skeletons with the same joints.

    Rotations mean the same on both only if their bones point the same way where all rotations are zero. People of other
    build differ by some degrees, other rest poses and other axes by far more.

    Args:
        skeleton, other: with the same parents.
        limit: degrees.

    Returns:
        The index of the joint at the end of the bone and the angle in degrees, or None if no long bone differs by more
        than the limit.
    """
    lengths = [np.linalg.norm(each.offsets, axis=-1) for each in (skeleton, other)]
    long = np.all([length > LONG_BONE * length.max() for length in lengths], axis=0)
    long[0] = False
    if not long.any():
        return None
    cosine = np.sum(skeleton.offsets * other.offsets, axis=-1)[long] / (lengths[0][long] * lengths[1][long])
    worst = int(np.argmin(cosine))
    degrees = float(np.degrees(np.arccos(np.clip(cosine[worst], -1.0, 1.0))))
    return (int(np.flatnonzero(long)[worst]), degrees) if degrees > limit else None


def same_joints(skeleton: Skeleton, other: Skeleton) -> bool:
    """Returns whether rotations of one skeleton mean the same on the other.

    They have the same joints in the same order, and no long bone differs by more than `ALIKE` degrees in direction.
    """
    if plain_names(skeleton.names) != plain_names(other.names):
        return False
    same = np.array_equal(skeleton.parents, other.parents)
    return same and rest_directions_differ(skeleton, other, ALIKE) is None


def check_same_topology(skeleton: Skeleton, other: Skeleton, source: str | Path) -> None:
    """Refuses a skeleton with other joints, or with another rest pose.

    Names are compared as `plain_names`. Bones may differ in length, because features hold joint positions.

    Args:
        skeleton: the expected one.
        other: the skeleton of the clip from `source`.
        source: file, for the message.

    Raises:
        InputError: naming the first joint that differs, or the joint whose bone points elsewhere in the rest pose.
    """
    if other.num_joints != skeleton.num_joints:
        extra = sorted(set(other.names) ^ set(skeleton.names))
        found = f"{other.num_joints} joints, {extra[:1]} differs"
        raise InputError(source, "skeleton", found, f"all clips share one skeleton, of {skeleton.num_joints} joints")
    pairs = zip(plain_names(other.names), plain_names(skeleton.names), strict=True)
    for joint, (name, wanted) in enumerate(pairs):
        if name != wanted or other.parents[joint] != skeleton.parents[joint]:
            found = f"{name} under joint {other.parents[joint]}"
            rule = f"all clips share one skeleton, here {wanted} under {skeleton.parents[joint]}"
            raise InputError(source, f"joint {joint}", found, rule)
    if differs := rest_directions_differ(skeleton, other):
        joint, degrees = differs
        rule = f"all clips share one rest pose: export them with the same one; limits are {SAME_DIRECTION:g} degrees"
        raise InputError(source, f"joint {other.names[joint]}", f"its bone points {degrees:.0f} degrees away", rule)


def skeleton_to_json(skeleton: Skeleton) -> dict[str, Any]:
    """Returns the skeleton as JSON data, exact to the last bit, with its reference pose in place of `poses`."""
    return {
        "names": list(skeleton.names),
        "parents": [int(p) for p in skeleton.parents],
        "offsets": np.asarray(skeleton.offsets, np.float64).tolist(),
        "end_sites": [[int(joint), np.asarray(offset, np.float64).tolist()] for joint, offset in skeleton.end_sites],
        "mirror": [int(m) for m in skeleton.mirror],
        "roles": None if skeleton.roles is None else {k: _plain(v) for k, v in asdict(skeleton.roles).items()},
        "humanoid": None if skeleton.humanoid is None else map_to_json(skeleton.humanoid),
        "reference": None if (reference := _reference(skeleton)) is None else np.asarray(reference).tolist(),
        "resting_heights": None if (heights := skeleton.resting_heights) is None else np.asarray(heights).tolist(),
    }


def skeleton_from_json(data: Mapping[str, Any], source: str | Path = "skeleton") -> Skeleton:
    """Returns the skeleton that `skeleton_to_json` described.

    Files of earlier versions have no humanoid map, reference pose or resting heights.

    Args:
        data: as `skeleton_to_json` returns it.
        source: file it was read from, for messages.

    Raises:
        InputError: if an entry is missing, of another kind, or does not have one value for each joint.
    """
    try:
        skeleton = _from_json(data, source)
        _check_indices(skeleton, source)
        return skeleton
    except InputError:
        raise
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError, IndexError) as error:
        raise InputError(source, "skeleton", failure(error)[:80], "must be as `skeleton_to_json` writes it") from error


def _from_json(data: Mapping[str, Any], source: str | Path) -> Skeleton:
    """Returns the skeleton as it is described, whatever its values.

    Raises:
        InputError: if an entry is missing, or does not have one value for each joint.
        TypeError, ValueError and others: if one is of another kind.
    """
    missing = [k for k in ("names", "parents", "offsets", "end_sites", "mirror", "roles") if k not in data]
    if missing:
        raise InputError(source, "skeleton", f"no {', '.join(missing)}", "must have all entries of a skeleton")
    joints = len(data["names"])
    if joints > MAX_JOINTS:
        raise InputError(source, "skeleton.names", f"{joints} joints", f"must be at most {MAX_JOINTS}")
    for key in ("parents", "offsets", "mirror"):
        if len(data[key]) != joints:
            rule = f"must have one for each of {joints} joints"
            raise InputError(source, f"skeleton.{key}", f"{len(data[key])} entries", rule)
    roles, humanoid, reference = data["roles"], data.get("humanoid"), data.get("reference")
    heights = data.get("resting_heights")
    return Skeleton(
        names=tuple(data["names"]),
        parents=np.array(data["parents"], np.int64),
        offsets=np.array(data["offsets"], np.float64).reshape(joints, 3),
        end_sites=tuple((int(joint), np.array(offset, np.float64)) for joint, offset in data["end_sites"]),
        mirror=np.array(data["mirror"], np.int64),
        roles=None if roles is None else _roles(roles),
        humanoid=None if humanoid is None else map_from_json(humanoid, source),
        reference=None if reference is None else np.array(reference, np.float64).reshape(joints, 4),
        resting_heights=None if heights is None else np.array(heights, np.float64).reshape(2, 2),
    )


def _check_indices(skeleton: Skeleton, source: str | Path) -> None:
    """Refuses a skeleton whose joints are not a tree with parents first, or that names joints it does not have.

    Raises:
        InputError: naming the entry.
    """
    joints, parents, mirror = skeleton.num_joints, skeleton.parents, skeleton.mirror
    own, body = np.arange(joints), skeleton.humanoid
    roles = {} if skeleton.roles is None else asdict(skeleton.roles)
    wrong = {
        "names": not joints or not all(isinstance(name, str) for name in skeleton.names),
        "parents": parents.shape != own.shape or parents[0] != -1 or ((parents < 0) | (parents >= own))[1:].any(),
        "mirror": mirror.shape != own.shape or ((mirror < 0) | (mirror >= joints)).any(),
        "end_sites": not all(0 <= joint < joints and offset.shape == (3,) for joint, offset in skeleton.end_sites),
        "offsets": not np.isfinite(skeleton.offsets).all(),
        "roles": not _are_joints(roles, joints),
        "humanoid": body is not None and not _are_joints(body.joints(), joints),
    }
    if found := [entry for entry, is_wrong in wrong.items() if is_wrong]:
        rule = "must be finite, and name joints of the skeleton, parents before their children"
        raise InputError(source, f"skeleton.{found[0]}", "out of range", rule)


def _are_joints(named: Mapping[str, Any], joints: int) -> bool:
    """Returns whether all values are joints, tuples of joints, or None."""
    values = [joint for value in named.values() for joint in (value if isinstance(value, tuple) else (value,))]
    return all(isinstance(joint, int) and 0 <= joint < joints for joint in values if joint is not None)


def _reference(skeleton: Skeleton) -> np.ndarray | None:
    """Returns the reference pose [J, 4] that is stored with a skeleton: its own, or that which its poses show."""
    body = skeleton.humanoid
    if skeleton.reference is not None or skeleton.poses is None or body is None or body.left_foot is None:
        return skeleton.reference
    from pfnn_jax.motion.retargeting.reference import reference_pose, stands  # which imports this module

    return None if stands(skeleton, body) else reference_pose(skeleton, body)


def _roles(data: Mapping[str, Any]) -> Roles:
    joints: dict[str, Any] = {name: tuple(role) if isinstance(role, list) else role for name, role in data.items()}
    return Roles(**joints)


def _plain(role: Any) -> Any:
    return [int(i) for i in role] if isinstance(role, tuple) else int(role)
