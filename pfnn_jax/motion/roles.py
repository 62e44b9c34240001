"""Finds the joints of hips, legs, arms and head: by name, else by geometry, else from a file of the user.

The geometry of limbs and the names of joints both give roles; `find_roles` combines them. Names cover the CMU,
Bandai-Namco, 100STYLE (Xsens), Mixamo, Biped, Unreal, Blender and SMPL conventions.
"""

from __future__ import annotations

import functools
import json
import re
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.skeleton import Roles, Skeleton

LONG_BONE = 0.6
"""Share of a limb's longest bone above which bones are long: forearms and calves are, clavicles and feet are not."""

ROLE_NAMES = tuple(field.name for field in fields(Roles))
FOOT_ROLES = ("left_foot", "right_foot")

# words in order of preference; a clavicle is often called Shoulder, so Arm comes first
PART_WORDS = {
    "hip": ("upleg", "upperleg", "thigh", "femur", "legupper", "hip"),
    "heel": ("ankle", "foot", "feet"),
    "toe": ("toebase", "toe", "toes", "ball", "foot"),
    "shoulder": ("upperarm", "uparm", "armupper", "humerus", "arm", "shldr", "shoulder"),
    "hand": ("wrist", "hand"),
}
HIPS_WORDS = ("hips", "pelvis", "hip")
HEAD_WORDS = ("head", "neck1", "neck")
SIDE_WORDS = {"left": "left", "l": "left", "right": "right", "r": "right"}


def chain_up(parents: np.ndarray, joint: int) -> list[int]:
    """Returns the joint and all its ancestors, up to the root."""
    chain = [int(joint)]
    while parents[chain[-1]] >= 0:
        chain.append(int(parents[chain[-1]]))
    return chain


def rest_pose(skeleton: Skeleton) -> np.ndarray:
    """Returns joint positions [J, 3] with all rotations zero."""
    pose = np.zeros((skeleton.num_joints, 3))
    for joint in range(1, skeleton.num_joints):
        pose[joint] = pose[skeleton.parents[joint]] + skeleton.offsets[joint]
    return pose


def longest_chain(skeleton: Skeleton) -> float:
    """Returns the length of the longest chain of bones from the root, without End Sites, in the skeleton's unit."""
    reach = np.zeros(skeleton.num_joints)
    for joint in range(1, skeleton.num_joints):
        reach[joint] = reach[skeleton.parents[joint]] + np.linalg.norm(skeleton.offsets[joint])
    return float(reach.max())


def roles_from_geometry(skeleton: Skeleton, poses: np.ndarray) -> dict:
    """Finds roles from the geometry of poses; none if there are no two legs.

    Args:
        skeleton: J joints; only the parents are used.
        poses: [N, J, 3] joint positions, Y up, in any unit.

    Returns:
        Role -> joint index, or (heel, toe) for feet; only the roles that were found.
    """
    parents, pose, height = skeleton.parents, poses[0], poses[..., 1].mean(axis=0)
    inner = set(parents.tolist())
    ends = sorted((joint for joint in range(skeleton.num_joints) if joint not in inner), key=lambda j: height[j])
    fork = _two_limbs(parents, pose, ends)
    if fork is None:
        return {}
    hips, legs = fork
    # mean distance of each joint to the left of the hips
    leftness = np.einsum("njc,nc->j", poses - poses[:, hips, None], _left(poses, legs))
    right, left = sorted(legs, key=lambda leg: leftness[leg[0]])
    roles: dict = {"hips": hips, "left_hip": left[0], "right_hip": right[0]}
    roles["left_foot"], roles["right_foot"] = left[2:], right[2:]
    ends = [joint for joint in ends if not {left[0], right[0]} & set(chain_up(parents, joint))]
    if ends:
        roles["head"] = max(ends, key=lambda joint: height[joint])
    fork = _two_limbs(parents, pose, sorted(ends, key=lambda joint: -abs(leftness[joint])))
    if fork is not None:
        right, left = sorted(fork[1], key=lambda arm: leftness[arm[2]])
        roles.update(left_shoulder=left[0], right_shoulder=right[0], left_hand=left[2], right_hand=right[2])
    return roles


def _left(poses: np.ndarray, legs: list[tuple]) -> np.ndarray:
    """Returns horizontal vectors [N, 3] to the left of the direction in which the toes point; +X without toes.

    Their length is that of the feet on the ground.
    """
    (_, _, *one), (_, _, *other) = legs
    forward = poses[:, one[1]] - poses[:, one[0]] + poses[:, other[1]] - poses[:, other[0]]
    left = np.stack((forward[:, 2], np.zeros(len(poses)), -forward[:, 0]), axis=-1)  # up × forward
    return left if np.abs(left).max() > 1e-6 else np.tile([1.0, 0.0, 0.0], (len(poses), 1))


def _two_limbs(parents: np.ndarray, pose: np.ndarray, ends: list[int]) -> tuple[int, list[tuple]] | None:
    """Returns the joint where two chains of ends fork and both limbs: the first end's, and the first that fits it."""
    for other in ends[1:]:
        first, second = chain_up(parents, ends[0]), chain_up(parents, other)
        fork = next(joint for joint in first if joint in second)
        limbs = [_limb(pose, chain[: chain.index(fork)][::-1]) for chain in (first, second)]
        if limbs[0] is not None and limbs[1] is not None:
            return fork, [limb for limb in limbs if limb is not None]
    return None


def _limb(pose: np.ndarray, chain: list[int]) -> tuple[int, int, int, int] | None:
    """Returns (upper, middle, lower, tip) of a chain from the body outwards, by the last two successive long bones."""
    kept = [j for i, j in enumerate(chain) if i == 0 or np.linalg.norm(pose[j] - pose[chain[i - 1]]) > 1e-6]
    if len(kept) < 3:
        return None
    bones = np.linalg.norm(np.diff(pose[kept], axis=0), axis=-1)
    shorter = np.minimum(bones[:-1], bones[1:])
    long = np.flatnonzero(shorter >= LONG_BONE * bones.max())
    start = int(long[-1]) if len(long) else int(np.argmax(shorter))
    lower = start + 2
    return kept[start], kept[start + 1], kept[lower], kept[min(lower + 1, len(kept) - 1)]


def find_roles(
    skeleton: Skeleton,
    overrides: dict | None = None,
    source: str | Path = "skeleton",
    *,
    poses: Callable[[], np.ndarray] | None = None,
) -> Roles:
    """Finds the roles of a skeleton by the names of joints and, where names do not suffice, by geometry.

    Geometry: the legs are the two chains that reach lowest, the arms those that reach farthest to the sides, the head
    is the highest end. A leg or arm is the last three joints joined by two long bones, which skips duplicates of zero
    length. Left is +X if the toes point to +Z. A foot without a toe joint is (ankle, ankle): both contacts are then the
    ankle's.

    Args:
        skeleton: the joints; its own roles and mirror are ignored.
        overrides: role -> joint name, or [heel, toe] for feet (a single name is used for both).
        source: file to name in messages.
        poses: returns joint positions [N, J, 3] of some poses in any unit; called only if names do not suffice. None
            uses the pose of zero rotations. Without toe joints left is +X.

    Returns:
        Joint indices.

    Raises:
        InputError: if an override names an unknown role or joint, or a role cannot be found.
    """
    chosen = _read_overrides(skeleton, overrides or {}, source)
    named = _roles_from_names(skeleton.names, tuple(int(parent) for parent in skeleton.parents))
    found = dict(_deepest_hips(skeleton, {**named, **chosen}), **chosen)
    if any(role not in found for role in ROLE_NAMES):
        # geometry and names may disagree about sides, so both joints of a pair come from one of them
        measured = roles_from_geometry(skeleton, rest_pose(skeleton)[None] if poses is None else poses())
        for part in ("hip", "foot", "shoulder", "hand"):
            pair = (f"left_{part}", f"right_{part}")
            if any(role not in found for role in pair) and all(role in measured for role in pair):
                found.update({role: measured[role] for role in pair if role not in chosen})
        found = {**measured, **found}
    missing = [role for role in ROLE_NAMES if role not in found]
    if missing:
        rule = f"must have a joint for {', '.join(missing)}; name it in a roles file"
        raise InputError(source, "skeleton", f"joints {_listed(skeleton.names)}", rule)
    return _consistent(skeleton, Roles(**found), source)


def assign_roles(
    skeleton: Skeleton,
    roles_file: Path | None = None,
    source: str | Path = "skeleton",
    *,
    poses: Callable[[], np.ndarray] | None = None,
) -> Skeleton:
    """Returns the skeleton with left-right partners and roles filled in.

    Without a roles file, roles are None if any cannot be found; with one, this is an error.

    Args:
        skeleton: the joints.
        roles_file: JSON object from role to joint name, feet as [heel, toe], such as
            `{"hips": "Pelvis", "left_foot": ["Ankle_L", "Ball_L"]}`. Roles that it does not name are found as usual.
        source: file to name in messages.
        poses: as in `find_roles`.

    Raises:
        InputError: if the roles file is not such a JSON object, or names an unknown role, or an unknown or impossible
            joint.
    """
    roles = None
    if roles_file is not None:
        roles = find_roles(skeleton, _read_json(Path(roles_file)), roles_file, poses=poses)
    else:
        try:
            roles = find_roles(skeleton, None, source, poses=poses)
        except InputError:
            roles = None
    return replace(skeleton, mirror=find_mirror(skeleton.names, skeleton.parents, roles), roles=roles)


def find_mirror(names: tuple[str, ...], parents: np.ndarray | None = None, roles: Roles | None = None) -> np.ndarray:
    """Returns the index [J] of each joint's left-right partner, its own index on the midline.

    Partners have names that differ only in the side. If names do not contain sides, the limbs of `roles` are paired,
    and below them children in order.
    """
    sides = _sides(tuple(names))
    index = {key: joint for joint, key in reversed(list(enumerate(sides)))}
    mirror = np.arange(len(names))
    for joint, (side, part) in enumerate(sides):
        if side and index[(side, part)] == joint:
            mirror[joint] = index.get((_other(side), part), joint)
    if roles is not None and parents is not None and np.all(mirror == np.arange(len(names))):
        for left, right in ((roles.left_hip, roles.right_hip), (roles.left_shoulder, roles.right_shoulder)):
            _pair_upwards(mirror, parents, left, right)
            _pair_downwards(mirror, parents, left, right)
    for joint in range(1, len(names)) if parents is not None else ():
        partner = mirror[joint]
        if parents is not None and parents[partner] != mirror[parents[joint]] and partner != joint:
            mirror[joint], mirror[partner] = joint, partner  # partners must have partners as parents
    return mirror


def is_hips_name(name: str) -> bool:
    """Returns whether a joint's name means hips."""
    words = [word for word in _words(name) if not word.isdigit()]
    return bool(words) and words[-1] in ("hips", "pelvis")


def leg_length(skeleton: Skeleton, roles: Roles) -> float:
    """Returns the length of the bones from hip to ankle, averaged over both legs, in the skeleton's unit.

    Raises:
        ValueError: if an ankle is not a descendant of its hip.
    """
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    total = 0.0
    for hip, (ankle, _) in ((roles.left_hip, roles.left_foot), (roles.right_hip, roles.right_foot)):
        chain = chain_up(skeleton.parents, ankle)
        if hip not in chain:
            raise ValueError(f"{skeleton.names[ankle]} is not a descendant of {skeleton.names[hip]}.")
        total += float(lengths[chain[: chain.index(hip)]].sum())
    return total / 2


def _words(name: str) -> list[str]:
    """Splits a joint name, without its namespace, into lower-case words: `mixamorig:LeftUpLeg` -> left, up, leg."""
    name = name.rsplit(":", 1)[-1]
    return [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+", name)]


@functools.lru_cache(maxsize=64)
def _sides(names: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Returns (side, part) of each joint: side is left, right or empty, part is the remaining words joined."""
    words = [_words(name) for name in names]
    while len(names) > 2 and words[-1] and sum(w[:1] == words[-1][:1] for w in words) >= 0.8 * len(names):
        prefix = words[-1][:1]
        words = [w[1:] if w[:1] == prefix else w for w in words]  # Bip01, mixamorig_, CC_Base
    whole = {"".join(w) for w in words}
    sides = []
    for w in words:
        marks = [i for i, word in enumerate(w) if word in SIDE_WORDS]
        joined = "".join(w)
        glued = re.match(r"(left|right)(.+)", joined)
        if marks:
            sides.append((SIDE_WORDS[w[marks[0]]], "".join(w[: marks[0]] + w[marks[0] + 1 :])))
        elif glued:
            sides.append((glued[1], glued[2]))
        elif joined[:1] in ("l", "r") and {"l" + joined[1:], "r" + joined[1:]} <= whole:
            sides.append((SIDE_WORDS[joined[0]], joined[1:]))  # lfemur, where there is also rfemur
        else:
            sides.append(("", joined))
    return tuple(sides)


def _other(side: str) -> str:
    return "right" if side == "left" else "left"


@functools.lru_cache(maxsize=64)
def _roles_from_names(names: tuple[str, ...], parents: tuple[int, ...]) -> dict:
    """Finds roles by names; left and right of a pair are found together or not at all."""
    first: dict[tuple[str, str], int] = {}
    for joint, (side, part) in enumerate(_sides(names)):
        first.setdefault((side, re.sub(r"\d+$", "", part) if part not in HEAD_WORDS else part), joint)

    def pair(part: str, other_than: tuple[int, int] | None = None) -> tuple[int, int] | None:
        for word in PART_WORDS[part]:
            found = first.get(("left", word)), first.get(("right", word))
            if found[0] is not None and found[1] is not None and found != other_than:
                return found[0], found[1]
        return None

    roles: dict = {}
    for role, part in (("hip", "hip"), ("shoulder", "shoulder"), ("hand", "hand")):
        if found := pair(part):
            roles[f"left_{role}"], roles[f"right_{role}"] = found
    if heels := pair("heel"):
        toes = pair("toe", heels) or heels
        below = all(heel in chain_up(np.array(parents), toe) for heel, toe in zip(heels, toes, strict=True))
        toes = toes if below else heels
        roles["left_foot"], roles["right_foot"] = (heels[0], toes[0]), (heels[1], toes[1])
    for role, words in (("hips", HIPS_WORDS), ("head", HEAD_WORDS)):
        if found := [first[("", word)] for word in words if ("", word) in first]:
            roles[role] = found[0]
    return roles


def _deepest_hips(skeleton: Skeleton, roles: dict) -> dict:
    """Sets the hips to the lowest common ancestor of both legs, unless the named joint is an ancestor of both."""
    if "left_hip" not in roles or "right_hip" not in roles:
        return roles
    left, right = (chain_up(skeleton.parents, roles[f"{side}_hip"]) for side in ("left", "right"))
    common = [joint for joint in left if joint in right]
    if roles.get("hips") not in common and common:
        roles = {**roles, "hips": common[0]}
    return roles


def _pair_upwards(mirror: np.ndarray, parents: np.ndarray, left: int, right: int) -> None:
    while left != right and left >= 0 and right >= 0:
        mirror[left], mirror[right] = right, left
        left, right = int(parents[left]), int(parents[right])


def _pair_downwards(mirror: np.ndarray, parents: np.ndarray, left: int, right: int) -> None:
    pairs = [(left, right)]
    while pairs:
        left, right = pairs.pop()
        mirror[left], mirror[right] = right, left
        children = np.flatnonzero(parents == left), np.flatnonzero(parents == right)
        if len(children[0]) == len(children[1]):
            pairs += [(int(a), int(b)) for a, b in zip(*children, strict=True)]


def _consistent(skeleton: Skeleton, roles: Roles, source: str | Path) -> Roles:
    """Returns the roles after checking that hips, upper leg, ankle and toe descend from each other in this order."""
    limbs = (("left_hip", roles.left_hip, roles.left_foot), ("right_hip", roles.right_hip, roles.right_foot))
    for role, hip, (heel, toe) in limbs:
        above = chain_up(skeleton.parents, toe)
        if not (heel in above and hip in above and hip != heel and roles.hips in above):
            found = f"{role} {skeleton.names[hip]}, foot {skeleton.names[heel]} {skeleton.names[toe]}"
            raise InputError(source, "skeleton", found, "hips, upper leg, ankle and toe must lie on one chain")
    if roles.left_hip == roles.right_hip or roles.left_shoulder == roles.right_shoulder:
        found = f"left {skeleton.names[roles.left_hip]}, {skeleton.names[roles.left_shoulder]}"
        raise InputError(source, "skeleton", found, "left and right must be different joints")
    return roles


def _listed(names: tuple[str, ...]) -> str:
    shown = ", ".join(name if name.isprintable() else ascii(name) for name in names[:12])
    return shown if len(names) <= 12 else f"{shown} and {len(names) - 12} more"


def _read_json(path: Path) -> dict:
    try:
        loaded = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(path, "file", error.strerror or error, "must be a readable JSON file") from None
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", error, "must be a JSON object from role to joint name") from None
    if not isinstance(loaded, dict):
        raise InputError(path, "file", type(loaded).__name__, "must be a JSON object from role to joint name")
    return loaded


def _read_overrides(skeleton: Skeleton, overrides: dict, source: str | Path) -> dict:
    """Returns role -> joint index or (heel, toe), after checking the names."""
    chosen: dict = {}
    for role, value in overrides.items():
        if role not in ROLE_NAMES:
            raise InputError(source, "role", ascii(role), f"must be one of {', '.join(ROLE_NAMES)}")
        names = [value] if isinstance(value, str) else value
        if not isinstance(names, list) or len(names) not in ((1, 2) if role in FOOT_ROLES else (1,)):
            rule = "must name one joint, or for a foot one joint or [heel, toe]"
            raise InputError(source, f"role {role}", ascii(value), rule)
        for name in names:
            if name not in skeleton.names:
                raise InputError(
                    source, f"role {role}", ascii(name), f"must be one of the joints {_listed(skeleton.names)}"
                )
        joints = [skeleton.names.index(name) for name in names]
        chosen[role] = (joints[0], joints[-1]) if role in FOOT_ROLES else joints[0]
    return chosen
