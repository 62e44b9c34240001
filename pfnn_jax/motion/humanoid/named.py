"""Finds the parts of limbs, and the head, by the names of joints."""

from __future__ import annotations

import functools

import numpy as np

from pfnn_jax.motion.humanoid.lexicon import limb_points, trunk_part
from pfnn_jax.motion.humanoid.map import ARM, LEG, SIDES
from pfnn_jax.motion.humanoid.names import natural_order, read_names
from pfnn_jax.motion.humanoid.tree import JointTree, joint_tree

REQUIRED = {LEG: ("thigh", "shin"), ARM: ("upper_arm", "lower_arm")}
MISSING = 20.0  # points that a limb without thigh, shin, upper or lower arm loses
NEARER = 0.01  # points by which the joint nearer to the body is preferred: upperleg01 before upperleg02


@functools.lru_cache(maxsize=64)
def named_limbs(names: tuple[str, ...], parents: tuple[int, ...]) -> dict[str, int]:
    """Returns bone -> joint of the legs and arms whose joints are called so.

    Left and right of a limb are found together or not at all. A leg ends with the shin where its foot hangs elsewhere;
    such a foot is found by `detached_feet`.
    """
    labels, tree = read_names(names), joint_tree(parents)
    found: dict[str, int] = {}
    for limb in (LEG, ARM):
        points = [
            {part: score for part, score in limb_points(label).items() if part in limb} if label.side else {}
            for label in labels
        ]
        sides = {side: [j for j, label in enumerate(labels) if label.side == side and points[j]] for side in SIDES}
        if not all(sides.values()):
            continue
        body = tree.fork([sides["left"][0], sides["right"][0]])
        limbs = {side: _best_limb(limb, joints, points, tree, body, names) for side, joints in sides.items()}
        if all(all(part in joints for part in REQUIRED[limb]) for joints in limbs.values()):
            found.update({f"{side}_{part}": joint for side in SIDES for part, joint in limbs[side].items()})
    return found


def _best_limb(
    limb: tuple[str, ...],
    joints: list[int],
    points: list[dict[str, float]],
    tree: JointTree,
    body: int,
    names: tuple[str, ...],
) -> dict[str, int]:
    """Returns part -> joint of the chain of one side whose names fit a limb best.

    Args:
        limb: parts, from the body outwards.
        joints: of one side whose names are those of parts.
        points: of each joint: part -> points.
        tree: of the joints.
        body: joint above both sides.
        names: of the joints, to decide between equals.
    """
    inner = {joint for end in joints for joint in tree.above(end)[1:]}
    tips = sorted((joint for joint in joints if joint not in inner), key=lambda joint: natural_order(names[joint]))
    best: tuple[float, dict[str, int]] = (-np.inf, {})
    for tip in tips:
        chain = [joint for joint in tree.above(tip)[::-1] if joint in joints]
        chain = [joint for joint in chain if tree.is_above(body, joint)] or chain
        score, parts = _assign(limb, chain, points)
        score += NEARER / 2 * any("middle" in names[joint].lower() for joint in tree.below(tip))  # of several palms
        if score > best[0] + 1e-9:
            best = (score, parts)
    return best[1]


def _assign(limb: tuple[str, ...], chain: list[int], points: list[dict[str, float]]) -> tuple[float, dict[str, int]]:
    """Returns the most points for parts in their order along a chain, and part -> joint.

    A limb without one of the parts that every limb has costs more than any part gives.
    """
    skipped = [MISSING * (part in REQUIRED[limb]) for part in limb]
    # by number of parts that are assigned or skipped
    best: list[tuple[float, dict[str, int]]] = [(-sum(skipped[:passed]), {}) for passed in range(len(limb) + 1)]
    for place, joint in enumerate(chain):
        for at in range(len(limb) - 1, -1, -1):
            if limb[at] in points[joint]:
                score = best[at][0] + points[joint][limb[at]] - NEARER * place
                for passed in range(at + 1, len(limb) + 1):
                    whole = score - sum(skipped[at + 1 : passed])
                    if whole > best[passed][0] + 1e-9:
                        best[passed] = (whole, {**best[at][1], limb[at]: joint})
    return best[-1]


def detached_foot(names: tuple[str, ...], side: str, limb: set[int]) -> int | None:
    """Returns the joint called the foot of a side that hangs elsewhere than under the leg.

    Args:
        names: of the joints.
        side: `left` or `right`.
        limb: joints of the leg.
    """
    for joint, label in enumerate(read_names(names)):
        if label.side == side and joint not in limb and limb_points(label).get("foot", 0.0) > 2.0:
            return joint
    return None


@functools.lru_cache(maxsize=64)
def named_trunk(names: tuple[str, ...]) -> tuple[str, ...]:
    """Returns `hips`, `spine`, `neck` or `head` for each joint that is called so, else an empty text."""
    return tuple(trunk_part(label) for label in read_names(names))
