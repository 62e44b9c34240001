"""Puts feet where the source's feet are: where ankles must be, and toes that stay above the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_axis_angle, quat_multiply, quat_rotate
from pfnn_jax.motion.retargeting.body import FORWARD, SIDES, UP, leg_length_of, limb
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

SOLE_SHARE = 0.09
"""Height of an ankle above the ground in leg lengths, in a skeleton whose feet have neither toes nor ends."""

ON_HEEL, ON_TOE = -25.0, -5.0
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


def sole_heights(positions: np.ndarray, body: HumanoidMap, feet: list[FlatFoot]) -> np.ndarray:
    """Returns the height [T] in metres of the lower sole, as toe joints and ankles of positions [T, J, 3] show it."""
    heights = []
    for side, flat in zip(SIDES, feet, strict=True):
        foot, toe = limb(body, side, "foot", "toe")
        heights.append(positions[:, foot, 1] - flat.height)
        if toe is not None and flat.toe is not None:
            heights.append(positions[:, toe, 1] - flat.height - flat.toe[1])
    return np.min(heights, axis=0)


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


def lift_toes(
    body: HumanoidMap,
    skeleton: Skeleton,
    reference: np.ndarray,
    world: np.ndarray,
    ankles: np.ndarray,
    floor: np.ndarray,
) -> None:
    """Bends toes up in place where their ends would be below the floor, which the source's toes do not show.

    A skeleton whose toes end in the toe joint turns them with the foot; the target's may be ten centimetres long.

    Args:
        body: map of the skeleton.
        skeleton: J joints.
        reference: [J, 4] its reference pose.
        world: [T, J, 4] world rotations, changed in place.
        ankles: [T, 2, 3] metres of the left and the right ankle.
        floor: [T] metres.
    """
    rest = rest_pose(skeleton)
    for number, side in enumerate(SIDES):
        foot, toe = limb(body, side, "foot", "toe")
        ends = [site for joint, site in skeleton.end_sites if joint == toe and np.linalg.norm(site) > 0]
        if toe is None or not ends:
            continue
        flat = flat_foot(skeleton, body, reference, side)
        assert flat.toe is not None
        base = ankles[:, number] + quat_rotate(world[:, foot], rest[toe] - rest[foot])
        end = max(ends, key=lambda site: float(np.linalg.norm(site)))
        rise = min(float(quat_rotate(reference[toe], end)[1]), 0.0)  # some rigs have ends that point upwards
        lowest = floor + flat.height + flat.toe[1] + rise - base[:, 1]
        # a turn about the axis to the right raises what points forward
        axis = quat_rotate(world[:, foot], quat_rotate(quat_conjugate(reference[foot]), np.array([-1.0, 0.0, 0.0])))
        angle = _angle_to_height(quat_rotate(world[:, toe], end), axis, lowest)
        world[:, toe] = quat_multiply(quat_from_axis_angle(axis, angle), world[:, toe])


def _angle_to_height(bones: np.ndarray, axis: np.ndarray, height: np.ndarray) -> np.ndarray:
    """Returns the angles [T] about unit axes [T, 3] that raise bones [T, 3] to a height [T], 0 where they reach it."""
    across = np.sum(bones * axis, axis=-1)
    ahead = bones - across[:, None] * axis
    upwards = np.cross(axis, ahead)  # where a quarter turn takes it
    # the height after a turn by a is across * axis + ahead cos a + upwards sin a
    radius = np.hypot(ahead[:, 1], upwards[:, 1])
    now = np.arctan2(ahead[:, 1], upwards[:, 1])
    wanted = (height - across * axis[:, 1]) / np.maximum(radius, 1e-9)
    turned = np.arcsin(np.clip(wanted, -1.0, 1.0)) - now
    return np.where((bones[:, 1] < height) & (radius > 1e-9), turned, 0.0)
