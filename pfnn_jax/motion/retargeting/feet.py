"""Puts feet where the source's feet are: where ankles must be, and toes that stay above the floor."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.motion.arrays import cross
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_axis_angle, quat_multiply, quat_rotate
from pfnn_jax.motion.retargeting.body import FORWARD, SIDES, UP, limb
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

SOLE_SHARE = 0.09
"""Height of an ankle above the ground in leg lengths, in a skeleton whose feet have neither toes nor ends."""

ON_HEEL, ON_TOE = 0.07, 0.015
"""Height of a toe above its place in a flat foot, against the ankle and in leg lengths, from which on a foot stands on
its heel and up to which it stands on its toe. Flat feet, whose pitch varies by some degrees, are below both."""

NEAR, CLEAR = 0.03, 0.1
"""Height of a toe above its place in a flat foot, in leg lengths, up to which it may stand and from which on it swings
freely."""

RIGHT = np.array([-1.0, 0.0, 0.0])
"""Axis in the reference pose about which a positive turn raises what points forward."""

STEEPEST = np.radians(75.0)
"""Steepest pitch below the horizontal that a foot is given; beyond it a short foot leaves the ground earlier."""

STEEP, HANGING = np.radians(65.0), np.radians(90.0)
"""Pitch below the horizontal at which a foot begins to keep the source's pitch, and from which on it keeps it."""


@dataclass(frozen=True)
class FlatFoot:
    """A foot of a skeleton that points to +Z.

    Attributes:
        toe: [3] metres from ankle to toe joint in the reference pose; None without a toe joint.
        drop: metres of the toe joint below the ankle while the foot stands flat, steeper or flatter than in the
            reference pose if the resting heights are known.
        height: metres of the ankle above the ground while the foot stands flat: above y = 0 if the resting heights are
            known, otherwise above the lowest of toe joint, foot's end and toe's end.
    """

    toe: np.ndarray | None
    drop: float
    height: float

    @property
    def standing(self) -> np.ndarray:
        """[3] metres from ankle to toe joint while the foot stands flat; zero without a toe joint."""
        if self.toe is None:
            return np.zeros(3)
        return np.array([self.toe[0], -self.drop, np.sqrt(max(self.toe[1:] @ self.toe[1:] - self.drop**2, 0.0))])


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
    return FlatFoot(bone, 0.0 if bone is None else -float(bone[1]), height)


def resting_foot(foot: FlatFoot, heights: np.ndarray) -> FlatFoot:
    """Returns the foot with ankle and toe at their resting heights [2] in metres (`Skeleton.resting_heights`)."""
    return replace(foot, drop=float(heights[0] - heights[1]), height=float(heights[0]))


def sole_heights(positions: np.ndarray, body: HumanoidMap, feet: list[FlatFoot]) -> np.ndarray:
    """Returns the height [T] in metres of the lower sole, as toe joints and ankles of positions [T, J, 3] show it."""
    heights = []
    for side, flat in zip(SIDES, feet, strict=True):
        foot, toe = limb(body, side, "foot", "toe")
        heights.append(positions[:, foot, 1] - flat.height)
        if toe is not None and flat.toe is not None:
            heights.append(positions[:, toe, 1] - flat.height + flat.drop)
    return np.min(heights, axis=0)


def _end(skeleton: Skeleton, joint: int, site: np.ndarray) -> np.ndarray:
    return rest_pose(skeleton)[joint] + site


def pitch_foot(turns: np.ndarray, scale: float, source: FlatFoot, target: FlatFoot) -> np.ndarray:
    """Returns the rotations [T, 4] with which the target's foot raises its heel or toe as high as the source's.

    A foot of another length has another pitch then. With the source's pitch a shorter foot would pull the body down
    to keep its toe on the ground, and a longer one would push its toe into the ground.

    Args:
        turns: [T, 4] world rotations of the source's foot from its reference pose.
        scale: leg length of the target over that of the source.
        source, target: both feet.
    """
    if source.toe is None or target.toe is None:
        return turns
    height = scale * (quat_rotate(turns, source.toe)[:, 1] + source.drop) - target.drop
    axis = quat_rotate(turns, RIGHT)
    now, wanted = _pitch_to_height(quat_rotate(turns, target.toe), axis, height)
    wanted = np.maximum(wanted, np.minimum(now, -STEEPEST))
    # a foot that hangs or points backwards has no pitch that raises it, and keeps that of the source; a foot whose toe
    # lies steeply below its ankle even when it stands hangs no sooner than the source's
    own, _ = _pitch_to_height(quat_rotate(turns, source.toe), axis, height)
    return quat_multiply(quat_from_axis_angle(axis, _forward_share(own) * (wanted - now)), turns)


def ankle_targets(
    ankles: np.ndarray,
    turns: np.ndarray,
    pitched: np.ndarray,
    scale: float,
    source: FlatFoot,
    target: FlatFoot,
    floor: np.ndarray,
    leg: float,
) -> np.ndarray:
    """Returns where the target's ankle must be for its foot to stand as the source's does.

    The sole stays at the source's height, scaled, so the ankle is as much higher as the target's foot is. A foot that
    is flat or has its heel raised stands on its toe, one whose toe is raised on its heel: that point stays in its
    place, although the target's foot has another length. Feet in the air move as the source's ankles do.

    Args:
        ankles: [T, 3] metres of the source's ankle.
        turns: [T, 4] world rotations of the source's foot from its reference pose.
        pitched: [T, 4] those of the target's foot.
        scale: leg length of the target over that of the source.
        source, target: both feet.
        floor: [T] metres below the target's foot.
        leg: leg length of the target in metres.

    Returns:
        [T, 3] metres.
    """
    places = scale * ankles + UP * (target.height - scale * source.height)
    if source.toe is None or target.toe is None:
        return places
    own, other = scale * quat_rotate(turns, source.toe), quat_rotate(pitched, target.toe)
    raised = own[:, 1] + scale * source.drop  # of the toe over its place in a flat foot, against the ankle
    on_toe = np.clip((ON_HEEL - raised / leg) / (ON_HEEL - ON_TOE), 0.0, 1.0)
    clearance = places[:, 1] - target.height + raised - floor
    near = np.clip((CLEAR - clearance / leg) / (CLEAR - NEAR), 0.0, 1.0)
    # a flat foot's toe is ahead of the source's by the excess; the ankle makes up for what the turned foot lacks
    excess, heading = target.standing - scale * source.standing, foot_headings(turns)
    lacking = excess[2] * heading + excess[0] * cross(UP, heading) - other + own
    return places + (near * on_toe)[:, None] * lacking * np.array([1.0, 0.0, 1.0])


def foot_headings(turns: np.ndarray) -> np.ndarray:
    """Returns the horizontal directions [T, 3] of feet with world rotations [T, 4] from the reference pose."""
    heading = cross(quat_rotate(turns, -RIGHT), UP)
    size = np.linalg.norm(heading, axis=-1, keepdims=True)
    return np.where(size > 0.1, heading / np.maximum(size, 0.1), quat_rotate(turns, FORWARD))


def keep_toes_above(
    turns: np.ndarray, foot: FlatFoot, ankles: np.ndarray, floor: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rotations [T, 4] and ankles [T, 3] of a foot whose toe joint is not below the floor.

    The foot is turned less steep, or its ankle raised where it hangs or points backwards.

    Args:
        turns: [T, 4] from the reference pose.
        foot: the foot.
        ankles: [T, 3] metres.
        floor: [T] metres.
    """
    if foot.toe is None:
        return turns, ankles
    lowest = floor + foot.height - foot.drop - ankles[:, 1]
    turns = quat_multiply(_lift(quat_rotate(turns, foot.toe), quat_rotate(turns, RIGHT), lowest), turns)
    below = np.maximum(lowest - quat_rotate(turns, foot.toe)[:, 1], 0.0)
    return turns, ankles + below[:, None] * UP


def lift_toes(
    body: HumanoidMap,
    skeleton: Skeleton,
    reference: np.ndarray,
    world: np.ndarray,
    ankles: np.ndarray,
    feet: list[FlatFoot],
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
        feet: the left and the right one.
        floor: [T] metres.
    """
    rest = rest_pose(skeleton)
    for number, side in enumerate(SIDES):
        foot, toe = limb(body, side, "foot", "toe")
        ends = [site for joint, site in skeleton.end_sites if joint == toe and np.linalg.norm(site) > 0]
        if toe is None or not ends:
            continue
        base = ankles[:, number] + quat_rotate(world[:, foot], rest[toe] - rest[foot])
        end = max(ends, key=lambda site: float(np.linalg.norm(site)))
        rise = min(float(quat_rotate(reference[toe], end)[1]), 0.0)  # some rigs have ends that point upwards
        lowest = floor + feet[number].height - feet[number].drop + rise - base[:, 1]
        axis = quat_rotate(world[:, foot], quat_rotate(quat_conjugate(reference[foot]), RIGHT))
        world[:, toe] = quat_multiply(_lift(quat_rotate(world[:, toe], end), axis, lowest), world[:, toe])


def _lift(bones: np.ndarray, axis: np.ndarray, lowest: np.ndarray) -> np.ndarray:
    """Returns the rotations [T, 4] about axes [T, 3] that raise the ends of bones [T, 3] to heights [T], if lower.

    A bone that hangs is turned less, and one that points backwards not at all.
    """
    now, wanted = _pitch_to_height(bones, axis, lowest)
    return quat_from_axis_angle(axis, np.where(bones[:, 1] < lowest, _forward_share(now) * (wanted - now), 0.0))


def _forward_share(pitch: np.ndarray) -> np.ndarray:
    """Returns 1 for bones that point forward, falling to 0 for those that hang: no turn in between is continuous."""
    return np.clip((HANGING - np.abs(pitch)) / (HANGING - STEEP), 0.0, 1.0)


def _pitch_to_height(bones: np.ndarray, axis: np.ndarray, height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the pitch of bones [T, 3] about unit axes [T, 3], and that at which they end at a height [T].

    Radians, 0 where the bone is level and positive where it rises; the second is at most a right angle.
    """
    across = np.sum(bones * axis, axis=-1)
    ahead = bones - across[:, None] * axis
    upwards = cross(axis, ahead)  # where a quarter turn takes it
    # at pitch p the end is at the height across * axis + radius sin p
    radius = np.hypot(ahead[:, 1], upwards[:, 1])
    now = np.arctan2(ahead[:, 1], upwards[:, 1])
    sine = (height - across * axis[:, 1]) / np.maximum(radius, 1e-9)
    return now, np.where(radius > 1e-9, np.arcsin(np.clip(sine, -1.0, 1.0)), now)
