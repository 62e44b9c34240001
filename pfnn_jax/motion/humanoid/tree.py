"""The tree of a skeleton's joints: ancestors, children, forks and paths."""

from __future__ import annotations

import functools
from collections.abc import Iterable


class JointTree:
    """Parents and children of J joints; parents come before their children."""

    def __init__(self, parents: tuple[int, ...]):
        self.parents = parents
        self.children: list[list[int]] = [[] for _ in parents]
        self._above: list[tuple[int, ...]] = []
        self._ancestors: list[frozenset[int]] = []
        for joint, parent in enumerate(parents):
            self._above.append((joint, *self._above[parent]) if parent >= 0 else (joint,))
            self._ancestors.append(frozenset(self._above[joint]))
            if parent >= 0:
                self.children[parent].append(joint)

    def above(self, joint: int) -> tuple[int, ...]:
        """Returns the joint and all its ancestors, up to the root."""
        return self._above[joint]

    def depth(self, joint: int) -> int:
        """Returns the number of a joint's ancestors."""
        return len(self._above[joint]) - 1

    def is_above(self, joint: int, other: int) -> bool:
        """Returns whether `joint` is `other` or one of its ancestors."""
        return joint in self._ancestors[other]

    def fork(self, joints: Iterable[int]) -> int:
        """Returns the lowest joint that is an ancestor of all the joints, or is one of them."""
        first, *others = joints
        common = self._ancestors[first].intersection(*(self._ancestors[other] for other in others))
        return next(joint for joint in self._above[first] if joint in common)

    def down(self, start: int, end: int) -> list[int]:
        """Returns the joints from below `start`, an ancestor of `end`, down to `end`."""
        above = self._above[end]
        return list(above[: above.index(start)][::-1])

    def path(self, start: int, end: int) -> list[int]:
        """Returns the joints from `start` to `end`, both included, up and then down the tree."""
        fork = self.fork((start, end))
        up = self._above[start]
        return [*up[: up.index(fork) + 1], *self.down(fork, end)]

    def below(self, joint: int) -> list[int]:
        """Returns the joint and all its descendants."""
        found = [joint]
        for one in found:
            found += self.children[one]
        return found


@functools.lru_cache(maxsize=64)
def joint_tree(parents: tuple[int, ...]) -> JointTree:
    """Returns the tree of some parents; -1 is the root's."""
    return JointTree(parents)
