"""Records that describe a skeleton: its joints, and the part each plays in walking."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError


@dataclass(frozen=True)
class Roles:
    """Joint indices of the parts that the features need.

    Attributes:
        hips: root of the body.
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
        roles: the joints' parts in walking, or None where they were not found.
    """

    names: tuple[str, ...]
    parents: np.ndarray
    offsets: np.ndarray
    end_sites: tuple[tuple[int, np.ndarray], ...]
    mirror: np.ndarray
    roles: Roles | None = None

    @property
    def num_joints(self) -> int:
        return len(self.names)


def need_roles(skeleton: Skeleton, source: str | Path = "skeleton") -> Roles:
    """The skeleton's roles.

    Raises:
        InputError: if the roles were not found when the skeleton was read.
    """
    if skeleton.roles is None:
        raise InputError(
            source, "skeleton", f"joints {', '.join(skeleton.names)}", "hips, shoulders and feet must be found or named"
        )
    return skeleton.roles
