"""Brings ankles to their targets: hips as high as legs as straight as the source's need, then two-bone legs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pfnn_jax.motion.arrays import cross
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import quat_from_axis_angle, quat_multiply, quat_rotate
from pfnn_jax.motion.retargeting.body import SIDES, UP, limb
from pfnn_jax.motion.skeleton import Skeleton, rest_pose
from pfnn_jax.motion.two_bone import SOFT, bend

STRAIGHTNESS = 0.02
"""Difference in relative length by which the straighter leg decides the hips' height e times as much as the other."""

MOST_RAISED = 0.05
"""Share of the leg length by which matching the straightness of legs may move the hips up or down."""

KICK = 0.5
"""Share of the squared reach: legs less steep than that, as in a kick, lower the hips less, and level ones not."""

MOST_BACKWARD = np.radians(5.0)
"""Angle by which a knee may be bent backwards, as knees in captured motion are."""

Legs = Sequence[tuple[np.ndarray, ...]]
"""Positions [T, 3] in metres of hip joint, knee and ankle of the left and the right leg."""


def leg_extension(positions: np.ndarray, body: HumanoidMap) -> np.ndarray:
    """Returns the distance from hip to ankle over the length of the leg [T, 2], left and right.

    Args:
        positions: [T, J, 3] metres.
        body: humanoid map of the J joints.
    """
    return np.stack([_extension(*(positions[:, joint] for joint in _joints(body, side))) for side in SIDES], axis=-1)


def place_legs(
    body: HumanoidMap,
    skeleton: Skeleton,
    hips: np.ndarray,
    world: np.ndarray,
    left: np.ndarray,
    targets: np.ndarray,
    extension: np.ndarray,
) -> np.ndarray:
    """Brings both ankles to their targets by thighs, shins and the height of the hips; feet keep their rotations.

    Args:
        body: map of the skeleton.
        skeleton: J joints.
        hips: [T, 3] metres.
        world: [T, J, 4] world rotations; those of thighs and shins are changed in place.
        left: [T, 3] unit vector to the left of the hips, about which knees bend.
        targets: [T, 2, 3] metres of the left and the right ankle.
        extension: [T, 2] of the source's legs, as `leg_extension` returns it.

    Returns:
        Positions [T, 3] of the hips.
    """
    legs = _legs(body, skeleton, hips, world)
    rise = match_extension(legs, targets, extension)[:, None] * UP
    legs = [tuple(joint + rise for joint in leg) for leg in legs]
    sink = excess_height(legs, targets)[:, None] * UP
    for number, side in enumerate(SIDES):
        thigh, shin, _ = _joints(body, side)
        top, knee, ankle = (joint - sink for joint in legs[number])
        back = _backward_bend(top, knee, ankle, left)
        world[:, shin] = quat_multiply(back, world[:, shin])
        ankle = knee + quat_rotate(back, ankle - knee)
        over, under, _ = bend(top, knee, ankle, targets[:, number], cross(knee - top, left))
        world[:, thigh] = quat_multiply(over, world[:, thigh])
        world[:, shin] = quat_multiply(over, quat_multiply(under, world[:, shin]))
    return hips + rise - sink


def _backward_bend(top: np.ndarray, knee: np.ndarray, ankle: np.ndarray, left: np.ndarray) -> np.ndarray:
    """Returns the rotations [T, 4] of shins whose knee is bent backwards by more than `MOST_BACKWARD` to that angle.

    The two-bone leg would bend them on that way.
    """
    upper, lower = knee - top, ankle - knee
    across = np.sum(left * upper, axis=-1, keepdims=True) / np.maximum(np.sum(upper**2, axis=-1, keepdims=True), 1e-12)
    hinge = left - across * upper
    hinge = hinge / np.maximum(np.linalg.norm(hinge, axis=-1, keepdims=True), 1e-6)
    bent = np.arctan2(np.sum(cross(upper, lower) * hinge, axis=-1), np.sum(upper * lower, axis=-1))
    back = np.where((bent < -MOST_BACKWARD) & (bent > -np.pi / 2), -MOST_BACKWARD - bent, 0.0)
    return quat_from_axis_angle(hinge, back)


def match_extension(legs: Legs, targets: np.ndarray, extension: np.ndarray) -> np.ndarray:
    """Returns how far the hips must rise [T] in metres for the straighter leg to be as straight as the source's.

    Without this a straight leg would bend by ten degrees where both legs of one skeleton differ by a centimetre.

    Args:
        legs: left and right.
        targets: [T, 2, 3] metres of the left and the right ankle.
        extension: [T, 2] of the source's legs, as `leg_extension` returns it.
    """
    rises = []
    for number, (top, knee, ankle) in enumerate(legs):
        longest = np.linalg.norm(knee - top, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)
        above = top - targets[:, number]
        across = above[:, 0] ** 2 + above[:, 2] ** 2
        squared = (extension[:, number] * longest) ** 2
        # a leg that lies says nothing about the height of the hips
        steep = np.clip(1.0 - across / np.maximum(squared, 1e-12), 0.0, 1.0)
        rise = np.sqrt(np.maximum(squared - across, 0.0)) - above[:, 1]
        rises.append(steep * np.clip(rise, -MOST_RAISED * longest, MOST_RAISED * longest))
    left = 1.0 / (1.0 + np.exp(np.clip((extension[:, 1] - extension[:, 0]) / STRAIGHTNESS, -50.0, 50.0)))
    return left * rises[0] + (1.0 - left) * rises[1]


def excess_height(legs: Legs, targets: np.ndarray) -> np.ndarray:
    """Returns how far the hips must sink [T] in metres for both ankles to reach their targets.

    A leg may be as straight as its rotations make it, or as `two_bone.SOFT` allows.

    Args:
        legs: left and right.
        targets: [T, 2, 3] metres of the left and the right ankle.
    """
    sink = np.zeros(len(targets))
    for number, (top, knee, ankle) in enumerate(legs):
        longest = np.linalg.norm(knee - top, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)
        reach = np.maximum(SOFT * longest, np.linalg.norm(ankle - top, axis=-1))
        above = top - targets[:, number]
        across = above[:, 0] ** 2 + above[:, 2] ** 2
        steep = np.clip((reach**2 - across) / (KICK * reach**2), 0.0, 1.0)
        sink = np.maximum(sink, steep * (above[:, 1] - np.sqrt(np.maximum(reach**2 - across, 0.0))))
    return sink


def _joints(body: HumanoidMap, side: str) -> tuple[int, int, int]:
    thigh, shin, foot = limb(body, side, "thigh", "shin", "foot")
    return thigh, shin, foot


def _extension(top: np.ndarray, knee: np.ndarray, ankle: np.ndarray) -> np.ndarray:
    longest = np.linalg.norm(knee - top, axis=-1) + np.linalg.norm(ankle - knee, axis=-1)
    return np.linalg.norm(ankle - top, axis=-1) / np.maximum(longest, 1e-12)


def _legs(body: HumanoidMap, skeleton: Skeleton, hips: np.ndarray, world: np.ndarray) -> Legs:
    return [_leg(body, skeleton, hips, world, side) for side in SIDES]


def _leg(
    body: HumanoidMap, skeleton: Skeleton, hips: np.ndarray, world: np.ndarray, side: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns the positions [T, 3] of hip joint, knee and ankle."""
    rest = rest_pose(skeleton)
    thigh, shin, foot = _joints(body, side)
    top = hips + quat_rotate(world[:, body.hips], rest[thigh] - rest[body.hips])
    knee = top + quat_rotate(world[:, thigh], rest[shin] - rest[thigh])
    return top, knee, knee + quat_rotate(world[:, shin], rest[foot] - rest[shin])
