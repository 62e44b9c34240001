"""Finds hips, spine, neck and head once the limbs are known."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.humanoid.map import SIDES
from pfnn_jax.motion.humanoid.measured import COINCIDENT, body_size
from pfnn_jax.motion.humanoid.names import JointName
from pfnn_jax.motion.humanoid.tree import JointTree


@dataclass(frozen=True)
class Trunk:
    """What is known of a skeleton when its trunk is searched.

    Attributes:
        tree: of J joints.
        labels: [J] what the joints' names say.
        named: [J] `hips`, `spine`, `neck`, `head` or an empty text, by names.
        pose: [J, 3] positions.
        limbs: bone -> joint of the limbs.
        dead_ends: leaves that only end a bone.
    """

    tree: JointTree
    labels: Sequence[JointName]
    named: Sequence[str]
    pose: np.ndarray
    limbs: dict[str, int]
    dead_ends: frozenset[int] = frozenset()

    @functools.cached_property
    def gap(self) -> float:
        """The distance up to which two joints are at one place."""
        return COINCIDENT * body_size(self.pose)

    @property
    def thighs(self) -> tuple[int, int]:
        """Both upper legs."""
        return self.limbs["left_thigh"], self.limbs["right_thigh"]

    @property
    def up(self) -> np.ndarray:
        """The direction [3] from the feet, or the shins without feet, to the thighs."""
        ends = [self.limbs.get(f"{side}_foot", self.limbs[f"{side}_shin"]) for side in SIDES]
        return self.pose[list(self.thighs)].mean(axis=0) - self.pose[ends].mean(axis=0)

    @property
    def chest(self) -> int | None:
        """The lowest joint above both arms, or None without arms."""
        if "left_upper_arm" not in self.limbs:
            return None
        return self.tree.fork((self.limbs["left_upper_arm"], self.limbs["right_upper_arm"]))


def find_head(trunk: Trunk) -> int | None:
    """Returns the head: the joint called so that is nearest to the arms, else the end of the highest chain."""
    tree, chest = trunk.tree, trunk.chest
    named = [joint for joint, part in enumerate(trunk.named) if part == "head"]
    anchor = chest if chest is not None else tree.fork(trunk.thighs)
    if named:  # a control elsewhere may have the same name, and duplicates below the head too
        return min(named, key=lambda joint: (-len(tree.above(tree.fork((joint, anchor)))), len(tree.above(joint))))
    tip = _highest_tip(trunk)
    if tip is None or chest is None:
        return tip
    return _end_of_chain(trunk, chest, tip) if tree.is_above(chest, tip) and tip != chest else tip


def _highest_tip(trunk: Trunk) -> int | None:
    """Returns the highest joint without children outside the limbs, or None if nothing is above the legs."""
    tree, uppers = trunk.tree, {trunk.limbs[bone] for bone in trunk.limbs if bone.endswith(("thigh", "upper_arm"))}
    uppers |= {trunk.limbs[bone] for bone in trunk.limbs if bone.endswith("clavicle")}
    inner = set(tree.parents)
    tips = [j for j in range(len(tree.parents)) if j not in inner and not uppers & set(tree.above(j))]
    chest = trunk.chest
    under = [j for j in tips if chest is not None and tree.is_above(chest, j)]
    tips = [j for j in under or tips if j not in tree.above(trunk.thighs[0])]
    return max(tips, key=lambda joint: float(trunk.pose[joint] @ trunk.up)) if tips else None


def _end_of_chain(trunk: Trunk, start: int, tip: int) -> int:
    """Returns where the chain from `start` to a tip ends or divides, without helpers and dead ends."""
    chain = trunk.tree.down(start, tip)
    for joint in chain[:-1]:
        children = [child for child in trunk.tree.children[joint] if not trunk.labels[child].helper]
        if len(children) > 1:
            return joint
    kept = [joint for joint in chain if not trunk.labels[joint].helper and joint not in trunk.dead_ends] or chain[:1]
    gap = trunk.gap
    while len(kept) > 1 and np.linalg.norm(trunk.pose[kept[-1]] - trunk.pose[kept[-2]]) <= gap:
        kept.pop()
    return kept[-1]


def find_hips(trunk: Trunk, head: int | None) -> int:
    """Returns the joint from which both legs and the spine descend.

    A joint called hips above both legs is preferred: the lowest above the head too, else the lowest. Without one, it is
    the joint where the legs and the way to the head part.
    """
    tree = trunk.tree
    fork = tree.fork(trunk.thighs)
    target = head if head is not None else trunk.chest
    named = [joint for joint in tree.above(fork) if trunk.named[joint] == "hips"]
    whole = [joint for joint in named if target is not None and tree.is_above(joint, target)]
    if named:
        return (whole or named)[0]
    if target is None or tree.is_above(target, fork):
        return fork
    return tree.fork((fork, target))


def find_spine(trunk: Trunk, hips: int, head: int | None) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Returns the joints of spine and neck, from the hips upwards, without helpers and joints at one place."""
    end = head if head is not None else trunk.chest
    if end is None:
        end = next((j for j in reversed(range(len(trunk.named))) if trunk.named[j] in ("spine", "neck")), hips)
    path = _way(trunk.tree, hips, end)
    if head is not None:
        path = path[:-1]
    neck = next((i for i, joint in enumerate(path) if trunk.named[joint] == "neck"), None)
    if neck is None:
        neck = path.index(trunk.chest) + 1 if trunk.chest in path and head is not None else len(path)
    kept = _apart(trunk, path, hips, head)
    return tuple(j for j in path[:neck] if j in kept), tuple(j for j in path[neck:] if j in kept)


def _way(tree: JointTree, hips: int, end: int) -> list[int]:
    """Returns the joints from behind the hips to an end above them.

    Where the hips hang below a joint that carries the spine too, that joint is not part of the way. Where the end is an
    ancestor of the hips, as in skeletons rooted at the head, all joints between them are.
    """
    fork = tree.fork((hips, end))
    return tree.path(hips, end)[1:] if fork in (hips, end) else tree.down(fork, end)


def _apart(trunk: Trunk, path: list[int], hips: int, head: int | None) -> set[int]:
    """Returns the joints of a path that are neither helpers nor duplicates at the place of another joint."""
    gap = trunk.gap
    kept: list[int] = []
    for joint in path:
        at_head = head is not None and np.linalg.norm(trunk.pose[joint] - trunk.pose[head]) <= gap
        before = kept[-1] if kept else hips
        at_before = np.linalg.norm(trunk.pose[joint] - trunk.pose[before]) <= gap
        if trunk.labels[joint].helper or ((at_head or at_before) and not _distinct(trunk, joint, before)):
            continue
        kept.append(joint)
    return set(kept)


def _distinct(trunk: Trunk, joint: int, before: int) -> bool:
    """Returns whether a joint is called by a part of the trunk that the one before it is not."""
    one, other = trunk.labels[joint], trunk.labels[before]
    return trunk.named[joint] in ("spine", "neck") and (one.part, one.numbers) != (other.part, other.numbers)
