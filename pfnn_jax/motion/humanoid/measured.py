"""Finds legs, arms and head by the lengths and places of joints, whatever they are called."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from pfnn_jax.motion.humanoid.map import ARM, LEG, SIDES
from pfnn_jax.motion.humanoid.tree import JointTree

LONG_BONE = 0.6
"""Share of a limb's longest bone above which bones are long: forearms and calves are, clavicles and feet are not."""

LEAST_REACH = 0.15
"""Share of the body's size that the long bones of a limb have at least: fingers are shorter."""

ALIKE = 0.25
"""Relative difference up to which the bones of a left and a right limb are alike."""

BENDS = 1e-3
"""Share of a limb's length by which the distance between its ends varies where it moves."""

LOW = 0.25
"""Share of the height of the joints up to which legs reach down."""

COINCIDENT = 1e-3
"""Share of the body's size below which two joints are at one place."""


def measured_limbs(tree: JointTree, poses: np.ndarray, helpers: Sequence[bool]) -> dict[str, int]:
    """Finds legs, arms and head from the geometry of poses.

    The legs are the two like chains that reach lowest, the arms those that reach farthest to the sides. A limb is the
    last three joints joined by two long bones, which skips duplicates of zero length. Left is to the left of the
    direction in which the toes point, or +X without toes.

    Args:
        tree: of J joints.
        poses: [N, J, 3] joint positions, Y up, in any unit.
        helpers: [J] whether a joint is known to be no part of the body.

    Returns:
        Bone -> joint index of what was found; nothing if there are no two legs.
    """
    height = poses[..., 1].mean(axis=0)
    inner = {parent for joint, parent in enumerate(tree.parents) if not helpers[joint]}
    tips = [joint for joint in range(len(tree.parents)) if joint not in inner and not helpers[joint]]
    low = height.min() + LOW * np.ptp(height)
    pair = _two_limbs(tree, poses, sorted(tips, key=lambda joint: height[joint]), LEG)
    if pair is None or any(height[max(leg.values(), key=tree.depth)] > low for leg in pair[1]):
        return {}
    body, legs = pair
    # mean distance of each joint to the left of the hips
    left = left_direction(poses, [(leg.get("foot"), leg.get("toe")) for leg in legs])
    leftness = np.einsum("njc,nc->j", poses - poses[:, body, None], left)
    found = _sided(legs, leftness, "thigh")
    tips = [joint for joint in tips if not {leg["thigh"] for leg in legs} & set(tree.above(joint))]
    pair = _two_limbs(tree, poses, sorted(tips, key=lambda joint: -abs(leftness[joint])), ARM)
    if pair is not None:
        found |= _sided(pair[1], leftness, "hand")
    return found


def _sided(limbs: list[dict[str, int]], leftness: np.ndarray, part: str) -> dict[str, int]:
    """Returns bone -> joint of two limbs, of which the one with `part` farther to the left is the left one."""
    ordered = sorted(limbs, key=lambda limb: -leftness[limb[part]])
    return {f"{side}_{name}": joint for side, limb in zip(SIDES, ordered, strict=True) for name, joint in limb.items()}


def left_direction(poses: np.ndarray, feet: Sequence[tuple[int | None, int | None]]) -> np.ndarray:
    """Returns horizontal vectors [N, 3] to the left of the direction in which the toes point; +X without toes.

    Their length is that of the feet on the ground.

    Args:
        poses: [N, J, 3].
        feet: ankle and toe of both legs.
    """
    forward = np.zeros((len(poses), 3))
    for foot, toe in feet:
        if foot is not None and toe is not None:
            forward += poses[:, toe] - poses[:, foot]
    left = np.stack((forward[:, 2], np.zeros(len(poses)), -forward[:, 0]), axis=-1)  # up × forward
    return left if np.abs(left).max() > 1e-6 else np.tile([1.0, 0.0, 0.0], (len(poses), 1))


def body_size(pose: np.ndarray) -> float:
    """Returns the largest extent of a pose [J, 3] along an axis."""
    return float(np.ptp(pose, axis=0).max())


def _two_limbs(
    tree: JointTree, poses: np.ndarray, tips: list[int], parts: tuple[str, ...]
) -> tuple[int, list[dict[str, int]]] | None:
    """Returns the joint where two chains fork, and both limbs: of the first tip that has a like one after it.

    Chains that bend in some poses come first: controls of a rig may have the shape of a limb, but do not move.
    """
    stiff: tuple[int, list[dict[str, int]]] | None = None
    for fork, limbs in _limb_pairs(tree, poses[0], tips, parts):
        if all(_bends(poses, limb) for limb in limbs):
            return fork, limbs
        stiff = stiff or (fork, limbs)
    return stiff


def _limb_pairs(
    tree: JointTree, pose: np.ndarray, tips: list[int], parts: tuple[str, ...]
) -> Iterator[tuple[int, list[dict[str, int]]]]:
    """Yields the joint where two chains fork, and both limbs, for all pairs of tips with like limbs, in their order."""
    least = LEAST_REACH * body_size(pose)
    for at, tip in enumerate(tips):
        for other in tips[at + 1 :]:
            fork = tree.fork((tip, other))
            limbs = [limb for end in (tip, other) if (limb := _limb(pose, tree.down(fork, end), parts, least))]
            if len(limbs) == 2 and _alike(pose, fork, limbs):
                yield fork, limbs


def _bends(poses: np.ndarray, limb: dict[str, int]) -> bool:
    """Returns whether the distance between the ends of a limb's long bones varies, or only one pose is known."""
    upper, end = ("upper_arm", "hand") if "hand" in limb else ("thigh", "foot")
    distance = np.linalg.norm(poses[:, limb[end]] - poses[:, limb[upper]], axis=1)
    return len(poses) < 2 or float(np.ptp(distance)) > BENDS * float(distance.max())


def _limb(pose: np.ndarray, chain: list[int], parts: tuple[str, ...], least: float) -> dict[str, int] | None:
    """Returns part -> joint of a chain from the body outwards, by the last two successive long bones.

    Args:
        pose: [J, 3].
        chain: joints.
        parts: of the limb: thigh, shin, foot, toe; or clavicle, upper arm, lower arm, hand.
        least: length of the two long bones.
    """
    gap = 1e-6 + COINCIDENT * body_size(pose) * 0.1
    kept = [j for i, j in enumerate(chain) if i == 0 or np.linalg.norm(pose[j] - pose[chain[i - 1]]) > gap]
    if len(kept) < 3:
        return None
    bones = np.linalg.norm(np.diff(pose[kept], axis=0), axis=-1)
    shorter = np.minimum(bones[:-1], bones[1:])
    long = np.flatnonzero(shorter >= LONG_BONE * bones.max())
    start = int(long[-1]) if len(long) else int(np.argmax(shorter))
    if bones[start] + bones[start + 1] < least:
        return None
    first = start - parts.index("upper_arm") if "upper_arm" in parts else start
    return {part: kept[at] for part, at in zip(parts, range(first, first + 4), strict=True) if 0 <= at < len(kept)}


def _alike(pose: np.ndarray, fork: int, limbs: list[dict[str, int]]) -> bool:
    """Returns whether two limbs have like bones, and begin at like distances from the joint where they fork."""
    upper, lower, end = ("upper_arm", "lower_arm", "hand") if "hand" in limbs[0] else ("thigh", "shin", "foot")
    one, other = (
        np.linalg.norm(pose[[limb[upper], limb[lower], limb[end]]] - pose[[fork, limb[upper], limb[lower]]], axis=1)
        for limb in limbs
    )
    return bool((np.abs(one - other)[1:] <= ALIKE * np.maximum(one, other)[1:]).all()) and bool(
        abs(one[0] - other[0]) <= ALIKE * one[1:].sum()
    )
