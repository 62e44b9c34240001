"""Where a skeleton's joints are in the reference pose, and how large its body is in comparison with a person."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import quat_rotate
from pfnn_jax.motion.retargeting.body import SIDES, limb, neck_chain, torso_chain
from pfnn_jax.motion.retargeting.reference import reference_pose
from pfnn_jax.motion.retargeting.retarget import place_joints
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

LEG, TORSO, ARM, HIP, SHOULDER = 0.83, 0.5, 0.54, 0.09, 0.18
"""Metres in a person of 1.75 m: hip to ankle, hips to shoulders, shoulder to wrist; half the distance between the hip
joints and between the shoulder joints. All profiles of the body are those of this person."""

SHORTEST = 0.015
"""Share of a person's size up to which a bone has no length."""

ANKLE_HEIGHT, BALL_HEIGHT = 0.085, 0.025
"""Metres above the floor of a person's ankle and of the joint of the toes."""


@dataclass(frozen=True, eq=False)
class Anatomy:
    """A skeleton in its reference pose: upright, arms to the sides, facing +Z.

    Attributes:
        skeleton: J joints.
        body: its humanoid map.
        positions: [J, 3] metres, hips at the origin.
        rotations: [J, 4] world rotations.
        size: relative to a person.
    """

    skeleton: Skeleton
    body: HumanoidMap
    positions: np.ndarray
    rotations: np.ndarray
    size: float

    def at(self, joint: int) -> np.ndarray:
        """Returns the position [3] of a joint."""
        return self.positions[joint]

    def limb(self, side: str, *names: str) -> tuple[Any, ...]:
        """Returns the joints of parts of one side; None where the skeleton has none."""
        return limb(self.body, side, *names)

    def tips(self, joint: int) -> np.ndarray:
        """Returns the positions [N, 3] of a joint's children and End Sites."""
        ends = [self.positions[child] for child in np.flatnonzero(self.skeleton.parents == joint)]
        for end, offset in self.skeleton.end_sites:
            if end == joint:
                ends.append(self.positions[joint] + quat_rotate(self.rotations[joint], offset))
        return np.array(ends).reshape(-1, 3)

    @property
    def hip_middle(self) -> np.ndarray:
        """The point [3] between the hip joints."""
        return (self.at(self.body.left_thigh) + self.at(self.body.right_thigh)) / 2

    @property
    def shoulder_middle(self) -> np.ndarray:
        """The point [3] between the shoulder joints; without arms it is below the neck."""
        if self.body.left_upper_arm is not None and self.body.right_upper_arm is not None:
            return (self.at(self.body.left_upper_arm) + self.at(self.body.right_upper_arm)) / 2
        top = self.at((*neck_chain(self.body), *torso_chain(self.body)[::-1])[0])
        return self.hip_middle + 0.92 * (top - self.hip_middle)

    @property
    def torso(self) -> float:
        """Metres from the hips to the shoulders."""
        return max(float(np.linalg.norm(self.shoulder_middle - self.hip_middle)), 0.3 * TORSO * self.size)

    @property
    def hip_half(self) -> float:
        """Half the distance between the hip joints, metres."""
        return float(np.linalg.norm(self.at(self.body.left_thigh) - self.at(self.body.right_thigh))) / 2

    @property
    def shoulder_half(self) -> float:
        """Half the distance between the shoulder joints, metres; a person's without arms."""
        if self.body.left_upper_arm is None or self.body.right_upper_arm is None:
            return SHOULDER * self.size
        apart = self.at(self.body.left_upper_arm) - self.at(self.body.right_upper_arm)
        return float(np.linalg.norm(apart)) / 2

    def leg(self, side: str) -> np.ndarray:
        """Returns hip, knee and ankle [3, 3] of one side; a leg without an ankle ends at its tip or as a person's."""
        thigh, shin, foot = self.limb(side, "thigh", "shin", "foot")
        end = self.at(foot) if foot is not None else self._end(thigh, shin, LEG * 0.49 * self.size)
        return np.stack([self.at(thigh), self.at(shin), end])

    def arm(self, side: str) -> np.ndarray | None:
        """Returns shoulder, elbow and wrist [3, 3] of one side; None without an arm."""
        upper, lower, hand = self.limb(side, "upper_arm", "lower_arm", "hand")
        if upper is None or lower is None:
            return None
        end = self.at(hand) if hand is not None else self._end(upper, lower, ARM * 0.49 * self.size)
        return np.stack([self.at(upper), self.at(lower), end])

    def foot_heights(self, side: str) -> tuple[float, float]:
        """Returns the heights in metres of ankle and toe joint above the sole of one side's foot."""
        foot, toe = self.limb(side, "foot", "toe")
        known = self.skeleton.resting_heights
        if known is not None and foot is not None:
            ankle, ball = known[list(SIDES).index(side)]
            if toe is None:
                return max(float(ankle), 0.03 * self.size), BALL_HEIGHT * self.size
            return max(float(ankle), 0.03 * self.size), max(float(ball), 0.006 * self.size)
        if foot is None or toe is None:
            return ANKLE_HEIGHT * self.size, BALL_HEIGHT * self.size
        drop = float(self.at(foot)[1] - self.at(toe)[1])
        return max(drop + BALL_HEIGHT * self.size, 0.03 * self.size), BALL_HEIGHT * self.size

    def _end(self, upper: int, lower: int, usual: float) -> np.ndarray:
        """Returns the end [3] of a limb's second bone, which no joint marks."""
        along = unit(self.at(lower) - self.at(upper))
        tips = self.tips(lower)
        if len(tips):
            reach = float(np.max((tips - self.at(lower)) @ along))
            if reach > 0.3 * usual:
                return self.at(lower) + reach * along
        return self.at(lower) + usual * along


def anatomy_of(skeleton: Skeleton, body: HumanoidMap) -> Anatomy:
    """Returns a skeleton with a humanoid map in its reference pose."""
    rotations = _reference(skeleton, body)
    positions = place_joints(skeleton, np.zeros(3), rotations)
    positions -= positions[body.hips].copy()
    found = Anatomy(skeleton, body, positions, rotations, 1.0)
    return replace(found, size=_size(found))


def _size(found: Anatomy) -> float:
    """Returns the size relative to a person: the middle one of leg, torso and arm."""
    legs = np.linalg.norm(np.diff([found.leg(side) for side in SIDES], axis=1), axis=-1).sum(axis=1).mean() / LEG
    torso = float(np.linalg.norm(found.shoulder_middle - found.hip_middle)) / TORSO
    arm = found.arm("left")
    arms = legs if arm is None else float(np.linalg.norm(np.diff(arm, axis=0), axis=-1).sum()) / ARM
    return max(float(np.median([legs, torso, arms])), 1e-6)


def _reference(skeleton: Skeleton, body: HumanoidMap) -> np.ndarray:
    """Returns the reference pose [J, 4]; a leg that ends with the shin gets a foot for the moment, which it needs."""
    if body.left_foot is not None and body.right_foot is not None:
        return reference_pose(skeleton, body)
    rest = rest_pose(skeleton)
    shins, thighs = [body.left_shin, body.right_shin], [body.left_thigh, body.right_thigh]
    count, offsets = skeleton.num_joints, rest[shins] - rest[thighs]
    longer = replace(
        skeleton,
        names=(*skeleton.names, "left foot", "right foot"),
        parents=np.concatenate([skeleton.parents, shins]),
        offsets=np.concatenate([skeleton.offsets, offsets]),
        mirror=np.concatenate([skeleton.mirror, [count + 1, count]]),
        poses=None,
        reference=None,
    )
    return reference_pose(longer, replace(body, left_foot=count, right_foot=count + 1))[:count]
