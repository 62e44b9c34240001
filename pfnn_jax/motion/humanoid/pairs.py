"""Pairs the joints of the left with those of the right."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from pfnn_jax.motion.humanoid.map import ARM, LEG, HumanoidMap
from pfnn_jax.motion.humanoid.names import OTHER_SIDE, plain_names, read_names
from pfnn_jax.motion.humanoid.tree import JointTree, joint_tree
from pfnn_jax.motion.skeleton import Skeleton

OTHER_WORD = {"left": "right", "l": "r", "lft": "rgt", "lt": "rt", "right": "left", "r": "l", "rgt": "lft", "rt": "lt"}
"""The word for the other side, by the words of `names.SIDE_WORDS`."""


def find_mirror(skeleton: Skeleton, humanoid: HumanoidMap | None = None) -> np.ndarray:
    """Returns the index [J] of each joint's left-right partner, its own index on the midline.

    Partners are found from the root outwards, so that the parents of partners are partners. Among the children of two
    partners, or of a joint on the midline, those are partners that lead to the same parts of the map, then those whose
    names differ only in the side, then those whose names mean the same part. Below partners whose names do not contain
    sides, children are paired by the lengths of their bones.

    Args:
        skeleton: J joints; its own mirror is ignored.
        humanoid: the map, if there is one.
    """
    lengths = np.linalg.norm(skeleton.offsets, axis=-1)
    return _pairs(skeleton.names, tuple(skeleton.parents.tolist()), lengths.tobytes(), humanoid).copy()


@functools.lru_cache(maxsize=16)
def _pairs(
    names: tuple[str, ...], parents: tuple[int, ...], lengths: bytes, humanoid: HumanoidMap | None
) -> np.ndarray:
    """Returns the partners of J joints; `lengths` are those of the bones [J], float64, as bytes."""
    return _Pairing(names, parents, np.frombuffer(lengths), humanoid).mirror


class _Pairing:
    """The search for partners, from the root outwards."""

    def __init__(
        self, names: tuple[str, ...], parents: tuple[int, ...], lengths: np.ndarray, humanoid: HumanoidMap | None
    ):
        self.tree: JointTree = joint_tree(parents)
        self.names = plain_names(names)
        self.labels = read_names(names)
        self.lengths = lengths
        self.leads = _leads(self.tree, humanoid)
        self.mirror = np.arange(len(names))
        waiting = [(0, 0)]
        while waiting:
            waiting += self._pair_children(*waiting.pop())

    def _pair_children(self, one: int, other: int) -> list[tuple[int, int]]:
        """Pairs the children of two partners, or of one joint; returns the pairs, and (joint, joint) on the midline."""
        if one == other:
            return self._pair_across(self.tree.children[one])
        rest = {*self.tree.children[one], *self.tree.children[other]}
        rules = (self._same_limb, self._opposite_names, self._same_part, self._like_bones)
        candidates = {joint: self.tree.children[other] for joint in self.tree.children[one]}
        return self._pair(candidates, rest, rules)

    def _pair_across(self, children: list[int]) -> list[tuple[int, int]]:
        """Pairs children of a joint on the midline with each other; those without partner stay on the midline."""
        rest = set(children)
        candidates = {joint: [other for other in children if other > joint] for joint in children}
        pairs = self._pair(candidates, rest, (self._same_limb, self._opposite_names, self._same_part))
        return pairs + [(joint, joint) for joint in children if joint in rest and not self.labels[joint].side]

    def _pair(
        self, candidates: Mapping[int, Sequence[int]], rest: set[int], rules: Iterable[Callable[[int, int], bool]]
    ) -> list[tuple[int, int]]:
        """Pairs joints with their candidates, by the first rule that fits and the most similar length.

        Args:
            candidates: joint -> joints that may be its partner.
            rest: joints without a partner; those that get one are removed.
            rules: in order of preference.
        """
        pairs: list[tuple[int, int]] = []
        for rule in rules:
            for joint, others in candidates.items():
                fitting = [other for other in others if joint in rest and other in rest and rule(joint, other)]
                if fitting:
                    partner = min(fitting, key=lambda p: abs(self.lengths[p] - self.lengths[joint]))
                    rest -= {joint, partner}
                    pairs.append((joint, partner))
                    self.mirror[joint], self.mirror[partner] = partner, joint
        return pairs

    def _same_limb(self, joint: int, partner: int) -> bool:
        """Whether two joints lead to the same limb of opposite sides."""
        return any((limb, OTHER_SIDE[side]) in self.leads[partner] for limb, side in self.leads[joint])

    def _opposite_names(self, joint: int, partner: int) -> bool:
        """Whether two names differ only in the side."""
        return self.labels[joint].side != "" and _swap_side(self.names[joint]) == self.names[partner].lower()

    def _same_part(self, joint: int, partner: int) -> bool:
        """Whether two names mean the same part of opposite sides."""
        a, b = self.labels[joint], self.labels[partner]
        same = (a.part, a.numbers, a.helper) == (b.part, b.numbers, b.helper)
        return a.side != "" and a.side == OTHER_SIDE[b.side] and same

    def _like_bones(self, joint: int, partner: int) -> bool:
        """Whether two joints below partners have names without a side, and as many joints below them."""
        below = len(self.tree.below(joint)) == len(self.tree.below(partner))
        return below and not (self.labels[joint].side and self.labels[partner].side)


def _leads(tree: JointTree, humanoid: HumanoidMap | None) -> list[set[tuple[str, str]]]:
    """Returns for each joint the limbs (part, side) of a map that begin at it or below it, or that it is part of."""
    leads: list[set[tuple[str, str]]] = [set() for _ in tree.parents]
    if humanoid is None:
        return leads
    for limb in (LEG, ARM):
        for side in ("left", "right"):
            for part, joint in zip(limb, humanoid.limb(side, limb), strict=True):
                for above in () if joint is None else tree.above(joint):
                    leads[above].add((part, side))
    # a joint above both sides leads to neither
    for lead in leads:
        both = {(part, side) for part, side in lead if (part, OTHER_SIDE[side]) in lead}
        lead -= both
    return leads


def _swap_side(name: str) -> str:
    """Returns a name in lower case with the other side, everything else unchanged."""
    words = re.split(r"([A-Z]+(?![a-z])|[A-Z]?[a-z]+|[0-9]+)", name)
    swapped = [OTHER_WORD.get(word.lower(), word) for word in words]
    if swapped != words:
        return "".join(swapped).lower()
    lower = name.lower()
    for mark, other in (("left", "right"), ("right", "left"), ("l", "r"), ("r", "l")):
        if lower.startswith(mark):
            return other + lower[len(mark) :]
    return lower[:-1] + {"l": "r", "r": "l"}.get(lower[-1:], lower[-1:])
