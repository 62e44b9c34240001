"""Puts feet where the source's feet are: ankle targets, and legs of two bones that reach them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import quat_multiply, quat_rotate
from pfnn_jax.motion.retargeting.body import FORWARD, SIDES, UP, leg_length_of, limb
from pfnn_jax.motion.roles import rest_pose
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.two_bone import SOFT, bend

SOLE_SHARE = 0.09
"""Height of an ankle above the ground in leg lengths, in a skeleton whose feet have neither toes nor ends."""

ON_HEEL, ON_TOE = -12.0, -4.0
"""Pitch in degrees, positive with a raised heel, below which a foot turns about its ankle and above which about its
toe. Flat feet, whose pitch varies by some degrees, lie on one side of both."""


@dataclass(frozen=True)
class FlatFoot:
    """A foot of a skeleton in the reference pose, flat on the ground and pointing to +Z.

    Attributes:
        toe: [3] metres from ankle to toe joint; None without a toe joint.
        height: metres of the ankle above the lowest of toe joint, foot's end and toe's end.
    """

    toe: np.ndarray | None
    height: float


def flat_foot(skeleton: Skeleton, body: HumanoidMap, reference: np.ndarray, side: str) -> FlatFoot:
    """Returns the left or right foot of a skeleton in its reference pose [J, 4]."""
    rest = rest_pose(skeleton)
    foot, toe = limb(body, side, "foot", "toe")
    points = [_end(skeleton, joint, site) - rest[foot] for joint, site in skeleton.end_sites if joint == foot]
    bone = None
    if toe is not None:
        bone = quat_rotate(reference[foot], rest[toe] - rest[foot])
        ends = [quat_rotate(reference[toe], site) for joint, site in skeleton.end_sites if joint == toe]
        points = [quat_rotate(reference[foot], point) for point in points] + [bone, *(bone + end for end in ends)]
    else:
        points = [quat_rotate(reference[foot], point) for point in points]
    points = [point for point in points if np.linalg.norm(point) > 0]
    height = -min((float(point[1]) for point in points), default=-SOLE_SHARE * leg_length_of(skeleton, body))
    return FlatFoot(bone, height)


def _end(skeleton: Skeleton, joint: int, site: np.ndarray) -> np.ndarray:
    return rest_pose(skeleton)[joint] + site


def ankle_targets(
    ankles: np.ndarray, turns: np.ndarray, scale: float, source: FlatFoot, target: FlatFoot
) -> np.ndarray:
    """Returns where the target's ankle must be for its foot to stand as the source's does.

    The sole stays at the source's height, scaled, so the ankle is as much higher as the target's foot is. A foot that
    is flat or has its heel raised turns about its toe, one that stands on its heel about its ankle: that point stays
    where it stands, although the target's foot has another length. Both agree in a flat foot.

    Args:
        ankles: [T, 3] metres of the source's ankle.
        turns: [T, 4] world rotations of the foot from the reference pose.
        scale: leg length of the target over that of the source.
        source, target: both feet.

    Returns:
        [T, 3] metres.
    """
    raised = UP * (target.height - scale * source.height)
    places = scale * ankles + raised
    if source.toe is None or target.toe is None:
        return places
    excess = target.toe - scale * source.toe
    left, pointing = quat_rotate(turns, np.array([1.0, 0.0, 0.0])), quat_rotate(turns, FORWARD)
    # the excess of a flat foot with the same heading, less that of the foot as it is turned
    heading = np.cross(left, UP)
    size = np.linalg.norm(heading, axis=-1, keepdims=True)
    heading = np.where(size > 0.1, heading / np.maximum(size, 0.1), pointing)
    flat = excess[2] * heading + excess[1] * UP + excess[0] * np.cross(UP, heading)
    lifted = quat_rotate(turns, UP)
    pitch = np.degrees(np.arctan2(np.sum(lifted * heading, axis=-1, keepdims=True), lifted[:, 1:2]))
    on_toe = np.clip((pitch - ON_HEEL) / (ON_TOE - ON_HEEL), 0.0, 1.0)
    return places + on_toe * (flat - quat_rotate(turns, excess))


def lower_to_reach(
    body: HumanoidMap, skeleton: Skeleton, hips: np.ndarray, world: np.ndarray, targets: np.ndarray
) -> np.ndarray:
    """Returns how far the hips must sink [T] in metres for both ankles to reach their targets.

    A leg may be as straight as its rotations make it, or as `two_bone.SOFT` allows.

    Args:
        body: map of the skeleton.
        skeleton: J joints.
        hips: [T, 3] metres.
        world: [T, J, 4] world rotations.
        targets: [T, 2, 3] metres of the left and the right ankle.
    """
    sink = np.zeros(len(hips))
    for number, side in enumerate(SIDES):
        top, knee, ankle = _leg(body, skeleton, hips, world, side)
        longest = np.linalg.norm(knee - top, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)
        reach = np.maximum(SOFT * longest, np.linalg.norm(ankle - top, axis=-1))
        above = top - targets[:, number]
        allowed = np.sqrt(np.maximum(reach**2 - above[:, 0] ** 2 - above[:, 2] ** 2, 0.0))
        sink = np.maximum(sink, np.where(allowed > 0, above[:, 1] - allowed, 0.0))
    return sink


def _leg(
    body: HumanoidMap, skeleton: Skeleton, hips: np.ndarray, world: np.ndarray, side: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the positions [T, 3] of hip joint, knee and ankle."""
    rest = rest_pose(skeleton)
    thigh, shin, foot = limb(body, side, "thigh", "shin", "foot")
    top = hips + quat_rotate(world[:, body.hips], rest[thigh] - rest[body.hips])
    knee = top + quat_rotate(world[:, thigh], rest[shin] - rest[thigh])
    return top, knee, knee + quat_rotate(world[:, shin], rest[foot] - rest[shin])


def reach_with_legs(
    body: HumanoidMap, skeleton: Skeleton, hips: np.ndarray, world: np.ndarray, forward: np.ndarray, targets: np.ndarray
) -> None:
    """Turns thighs and shins in place so that the ankles reach their targets; the feet keep their rotations.

    Args:
        body: map of the skeleton.
        skeleton: J joints.
        hips: [T, 3] metres.
        world: [T, J, 4] world rotations, changed in place.
        forward: [T, 3] direction in which straight knees bend.
        targets: [T, 2, 3] metres of the left and the right ankle.
    """
    for number, side in enumerate(SIDES):
        thigh, shin = limb(body, side, "thigh", "shin")
        over, under, _ = bend(*_leg(body, skeleton, hips, world, side), targets[:, number], forward)
        world[:, thigh] = quat_multiply(over, world[:, thigh])
        world[:, shin] = quat_multiply(over, quat_multiply(under, world[:, shin]))
