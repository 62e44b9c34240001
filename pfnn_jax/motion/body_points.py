"""The 21 points of a body that positional representations of motion hold, on any humanoid skeleton.

They are the 21 of CMU's 31 joints that Holden et al. 2016 use. A point that a skeleton has no joint for lies at an End
Site or between joints, and turns with the joint that carries it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pfnn_jax.motion.humanoid.map import ARM, LEG, SIDES, HumanoidMap
from pfnn_jax.motion.kinematics import quat_rotate
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.roles import chain_up
from pfnn_jax.motion.skeleton import Skeleton, need_roles, rest_pose

ARM_PARTS = ("upper_arm", "lower_arm", "hand", "hand_end")
"""Points of an arm, from the body outwards."""

TRUNK = ("spine", "chest", "neck", "head")
"""Points of the trunk above the hips."""


def _limbs(parts: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{side}_{part}" for side in SIDES for part in parts)


POINT_NAMES = ("hips", *_limbs(LEG), *TRUNK, *_limbs(ARM_PARTS))
"""Names of the points, in the order of the layouts of Holden et al."""

POINT_PARENTS = (-1, 0, 1, 2, 3, 0, 5, 6, 7, 0, 9, 10, 11, 10, 13, 14, 15, 10, 17, 18, 19)
"""Index of the point that each point hangs from; -1 for the hips."""


@dataclass(frozen=True, eq=False)
class BodyPoints:
    """Where the 21 points of a body lie on a skeleton.

    Attributes:
        joints: [21] index of the joint that carries each point.
        offsets: [21, 3] metres from that joint, in its frame; zero where the point is the joint.
    """

    joints: np.ndarray
    offsets: np.ndarray

    def positions(self, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
        """Returns the points [T, 21, 3] of a body in metres.

        Args:
            positions: [T, J, 3] metres, joints in the world.
            rotations: [T, J, 4] their world rotations.
        """
        points = positions[:, self.joints]
        apart = np.flatnonzero(self.offsets.any(axis=-1))
        points[:, apart] += quat_rotate(rotations[:, self.joints[apart]], self.offsets[apart])
        return points


def find_body_points(skeleton: Skeleton, source: str | Path = "skeleton") -> BodyPoints:
    """Finds the points of a body on a skeleton.

    - Spine and chest are the last two joints of the spine, or lie evenly between hips and neck.
    - The neck is the last joint of the neck, or lies between chest and head.
    - A hand ends at the farthest joint below it, or at its End Site.
    - A toe or hand that has no joint lies at the end of the foot or of the lower arm.

    Args:
        skeleton: J joints.
        source: file to name in messages.

    Raises:
        InputError: if the skeleton has no humanoid map, arms, feet or head.
    """
    need_roles(skeleton, source)
    body, rest = humanoid_of(skeleton, source), rest_pose(skeleton)
    found: dict[str, tuple[int, np.ndarray]] = {"hips": (body.hips, np.zeros(3)), **_trunk(body, rest)}
    for side in SIDES:
        for part, joint in zip(LEG, body.limb(side, LEG), strict=True):
            above = found["hips" if part == "thigh" else f"{side}_{LEG[LEG.index(part) - 1]}"][0]
            found[f"{side}_{part}"] = _end(skeleton, rest, above) if joint is None else (joint, np.zeros(3))
        _, upper, lower, hand = body.limb(side, ARM)
        assert upper is not None and lower is not None  # the roles need them
        found[f"{side}_upper_arm"], found[f"{side}_lower_arm"] = (upper, np.zeros(3)), (lower, np.zeros(3))
        end = _end(skeleton, rest, lower if hand is None else hand)
        found[f"{side}_hand"] = end if hand is None else (hand, np.zeros(3))
        found[f"{side}_hand_end"] = end
    joints, offsets = zip(*(found[name] for name in POINT_NAMES), strict=True)
    return BodyPoints(np.array(joints), np.stack(offsets))


def _trunk(body: HumanoidMap, rest: np.ndarray) -> dict[str, tuple[int, np.ndarray]]:
    """Returns joint and offset of spine, chest, neck and head."""
    assert body.head is not None  # the roles need it
    top = body.neck[-1] if body.neck else body.head
    chain = (body.hips, *body.spine)[-3:]
    places: dict[str, tuple[int, np.ndarray]] = {"head": (body.head, np.zeros(3))}
    if len(body.spine) >= 2:
        places["spine"], places["chest"] = (chain[-2], np.zeros(3)), (chain[-1], np.zeros(3))
    elif body.spine:
        spine = body.spine[0]
        places["spine"] = (body.hips, (rest[spine] - rest[body.hips]) / 2)
        places["chest"] = (spine, np.zeros(3))
    else:
        up = rest[top] - rest[body.hips]
        places["spine"], places["chest"] = (body.hips, up / 3), (body.hips, 2 * up / 3)
    if body.neck:
        places["neck"] = (top, np.zeros(3))
    else:
        carrier, offset = places["chest"]
        places["neck"] = (carrier, (offset + rest[body.head] - rest[carrier]) / 2)
    return places


def _end(skeleton: Skeleton, rest: np.ndarray, joint: int) -> tuple[int, np.ndarray]:
    """Returns the farthest joint below a joint, or the joint and the offset of its End Site where that is farther."""
    below = [j for j in range(joint + 1, skeleton.num_joints) if joint in chain_up(skeleton.parents, j)]
    length = {j: float(np.linalg.norm(rest[j] - rest[joint])) for j in below}
    if below and max(length.values()) > 0:
        return max(length, key=lambda j: length[j]), np.zeros(3)
    sites = [site for at, site in skeleton.end_sites if at == joint]
    return joint, np.array(max(sites, key=lambda site: float(np.linalg.norm(site)), default=np.zeros(3)), dtype=float)
