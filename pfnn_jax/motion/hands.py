"""Makes joints of the ends of hands, which `mason2022` layouts use as end effectors."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.skeleton import Roles, Skeleton, need_roles


def extend_hands(clip: MotionClip) -> MotionClip:
    """Adds the hands' End Sites to a clip as joints, as Mason et al. 2022 count joints (section 4.2).

    If both hands end in an End Site away from the wrist, each becomes a joint `<wrist>Site` right after its wrist,
    without rotation, and takes the role of the hand: the 23 joints of a 100STYLE file become 25. Otherwise (a wrist
    without an End Site, or with one at the wrist itself, as in the Bandai-Namco files) the clip is returned unchanged.
    If the joints exist already, only the roles are moved to them.

    Args:
        clip: of J joints, on a skeleton with roles.

    Returns:
        A clip of J + 2 or J joints.

    Raises:
        InputError: if the skeleton has no roles.
    """
    skeleton = clip.skeleton
    roles = need_roles(skeleton, clip.source)
    hands = (roles.left_hand, roles.right_hand)
    present = [_site_joint(skeleton, hand) for hand in hands]
    if tuple(present) == hands:
        return clip
    if None not in present:
        roles = replace(roles, left_hand=present[0], right_hand=present[1])
        return replace(clip, skeleton=replace(skeleton, roles=roles))
    sites = {hand: tip for hand in hands if (tip := _tip(skeleton, hand)) is not None}
    if len(sites) < 2:
        return clip
    order = np.insert(np.arange(skeleton.num_joints), np.sort(hands) + 1, -1)
    rotations = _with_tips(clip.rotations, order)
    return replace(clip, skeleton=_insert(skeleton, roles, sites, order), rotations=rotations)


def _insert(skeleton: Skeleton, roles: Roles, sites: dict[int, int], order: np.ndarray) -> Skeleton:
    """Inserts joints into a skeleton where `order` (old joints at their new indices) is -1.

    Args:
        skeleton: J joints.
        roles: of the skeleton.
        sites: hand joint -> index in `end_sites` of the site that becomes a joint.
        order: [J + 2].
    """
    place = np.flatnonzero(order >= 0)  # new index of every old joint
    names, offsets = list(skeleton.names), list(skeleton.offsets)
    parents = [int(place[parent]) if parent >= 0 else -1 for parent in skeleton.parents]
    mirror = place[skeleton.mirror].tolist()
    for hand in sorted(sites):
        at = int(place[hand]) + 1
        names.insert(at, f"{skeleton.names[hand]}Site")
        offsets.insert(at, skeleton.end_sites[sites[hand]][1])
        parents.insert(at, at - 1)
        mirror.insert(at, int(place[skeleton.mirror[hand]]) + 1)
    ends = tuple(
        (int(place[joint]), site) for i, (joint, site) in enumerate(skeleton.end_sites) if i not in sites.values()
    )
    moved = move_roles(roles, place)
    moved = replace(moved, left_hand=moved.left_hand + 1, right_hand=moved.right_hand + 1)
    with_hand = np.where(order >= 0, order, np.roll(order, 1))  # a tip turns with the wrist before it
    return Skeleton(
        names=tuple(names),
        parents=np.array(parents),
        offsets=np.array(offsets),
        end_sites=ends,
        mirror=np.array(mirror),
        roles=moved,
        humanoid=None if skeleton.humanoid is None else skeleton.humanoid.move(lambda joint: int(place[joint])),
        poses=None if skeleton.poses is None else _with_tips(skeleton.poses, order),
        reference=None if skeleton.reference is None else skeleton.reference[with_hand],
        resting_heights=skeleton.resting_heights,
    )


def _with_tips(rotations: np.ndarray, order: np.ndarray) -> np.ndarray:
    """Returns local rotations [T, J + 2, 4] with new joints, where `order` is -1, at rest."""
    extended = np.zeros((len(rotations), len(order), 4))
    extended[..., 0] = 1.0
    extended[:, order >= 0] = rotations
    return extended


def move_roles(roles: Roles, place: np.ndarray) -> Roles:
    """Returns the roles with each old joint index replaced by its new one, `place[joint]`."""
    moved: dict[str, Any] = {
        role: tuple(int(place[joint]) for joint in joints) if isinstance(joints, tuple) else int(place[joints])
        for role, joints in asdict(roles).items()
    }
    return Roles(**moved)


def _site_joint(skeleton: Skeleton, hand: int) -> int | None:
    """Returns the joint at the hand's tip that an earlier extension made: the hand itself or its child."""
    if skeleton.names[hand].endswith("Site"):
        return hand
    name = f"{skeleton.names[hand]}Site"
    found = [joint for joint in np.flatnonzero(skeleton.parents == hand) if skeleton.names[joint] == name]
    return int(found[0]) if found else None


def _tip(skeleton: Skeleton, hand: int) -> int | None:
    """Returns the index in `end_sites` of the hand's End Site, if it is away from the wrist."""
    for index, (joint, offset) in enumerate(skeleton.end_sites):
        if joint == hand and np.linalg.norm(offset) > 0:
            return index
    return None
