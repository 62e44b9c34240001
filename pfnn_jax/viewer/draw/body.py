"""A skeleton as a body of capsules, so that pictures show a person and not a bundle of lines."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_multiply, quat_rotate
from pfnn_jax.motion.skeleton import Skeleton

Up = Literal["auto", "y", "z"]

LEG = 0.83  # metres of thigh and shin at which the radii below hold
SHORTEST = 0.015  # metres; shorter bones only carry a rotation
_RADII = {  # metres at both ends, by part and by how many bones away from the part's first joint
    "leg": ((0.078, 0.056), (0.056, 0.038), (0.042, 0.034), (0.034, 0.026)),
    "arm": ((0.048, 0.04), (0.04, 0.03), (0.034, 0.022), (0.016, 0.012)),
    "head": ((0.08, 0.092),),
}
_HEAD_SPAN = (0.3, 0.56)
_CROWN = 0.1  # metres; a shorter bone above the head joint says nothing about where the head is
STANDING = 0.9  # share of its length by which a body that stands in a Z-up world reaches along Z
Z_TO_Y = np.array([np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0])  # a quarter turn about X
_REACH = 1.1  # metres from the hips to the farthest fingertip or toe of a person, along the bones
_DOT = 0.06  # metres; a joint without bones
_TRUNK = 0.105
_GIRDLE = 0.06
_NECK = 0.05


@dataclass(frozen=True)
class Capsule:
    """One limb segment: a tapered capsule on the line between two points of `body_points`.

    Attributes:
        start, end: indices of the points.
        start_radius, end_radius: metres.
        side: `left`, `right` or `middle`.
        span: where on the line the capsule's centres lie; a head is rounder than the bone that carries it.
    """

    start: int
    end: int
    start_radius: float
    end_radius: float
    side: str
    span: tuple[float, float] = (0.0, 1.0)


def body_points(clip: MotionClip) -> np.ndarray:
    """World positions [T, J + E, 3] in metres of the joints, then of the End Sites."""
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    ends = [positions]
    for joint, offset in clip.skeleton.end_sites:
        ends.append((positions[:, joint] + quat_rotate(rotations[:, joint], offset))[:, None])
    return np.concatenate(ends, axis=1)


def upright(clip: MotionClip, up: Up = "auto") -> MotionClip:
    """The clip with Y up, as everything here expects it; BVH files of some programs have Z up.

    Args:
        clip: the motion.
        up: the clip's own axis that points up. `auto` takes Z where the body, from its feet to its head, stands along
            Z in nearly all frames, and Y otherwise, or where the skeleton's parts are unknown.
    """
    if up == "y" or (up == "auto" and not _stands_along_z(clip)):
        return clip
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(Z_TO_Y, rotations[:, 0])
    return replace(clip, root_positions=quat_rotate(Z_TO_Y, clip.root_positions), rotations=rotations)


def _stands_along_z(clip: MotionClip) -> bool:
    roles = clip.skeleton.roles
    if roles is None:
        return False
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    body = positions[:, roles.head] - (positions[:, roles.left_foot[0]] + positions[:, roles.right_foot[0]]) / 2
    share = body[:, 2] / np.maximum(np.linalg.norm(body, axis=-1), 1e-9)
    return float(np.percentile(share, 10)) > STANDING


def headings(clip: MotionClip, points: np.ndarray) -> np.ndarray:
    """[T] radians: where hips and shoulders face; zero where the skeleton's parts are unknown.

    Args:
        clip: T frames.
        points: [T, P, 3] metres, from `body_points`.
    """
    roles = clip.skeleton.roles
    if roles is None:
        return np.zeros(clip.num_frames)
    across = points[:, roles.left_hip] - points[:, roles.right_hip]
    across = across + points[:, roles.left_shoulder] - points[:, roles.right_shoulder]
    return np.arctan2(-across[:, 2], across[:, 0])


def body_capsules(skeleton: Skeleton) -> list[Capsule]:
    """The limb segments of a skeleton, thick where people are, scaled to its legs.

    Without roles every bone is equally thin, scaled to the longest limb; a skeleton without bones is a dot.
    """
    parents = [*(int(parent) for parent in skeleton.parents), *(joint for joint, _ in skeleton.end_sites)]
    offsets = [*skeleton.offsets, *(offset for _, offset in skeleton.end_sites)]
    limbs = _limbs(skeleton, parents)
    scale = _scale(skeleton)
    capsules = []
    for end, (start, offset) in enumerate(zip(parents, offsets, strict=True)):
        part, order, side = limbs.get(end, ("", 0, "middle"))
        if start >= 0 and part != "head" and np.linalg.norm(offset) > SHORTEST * scale:
            first, second = _thickness(skeleton, part, order, end)
            capsules.append(Capsule(start, end, first * scale, second * scale, side))
    capsules += _head(skeleton, parents, offsets, scale)
    return capsules or [Capsule(0, 0, _DOT, _DOT, "middle")]


def _head(skeleton: Skeleton, parents: list[int], offsets: list[np.ndarray], scale: float) -> list[Capsule]:
    """A head on the bone above the head joint, or, where that is missing or too short, in line with the neck."""
    if skeleton.roles is None:
        return []
    head = skeleton.roles.head
    low, high = (radius * scale for radius in _RADII["head"][0])
    above = [point for point, parent in enumerate(parents) if parent == head]
    crown = max(above, key=lambda point: float(np.linalg.norm(offsets[point])), default=head)
    if crown != head and np.linalg.norm(offsets[crown]) > _CROWN * scale:
        return [Capsule(head, crown, low, high, "middle", _HEAD_SPAN)]
    neck = max(float(np.linalg.norm(offsets[head])), SHORTEST * scale)
    span = tuple(1.0 + 0.2 * scale * share / neck for share in _HEAD_SPAN)
    return [Capsule(parents[head], head, low, high, "middle", (span[0], span[1]))]


def capsule_ends(points: np.ndarray, capsule: Capsule) -> tuple[np.ndarray, np.ndarray]:
    """Centres [..., 3] of a capsule's two ends, from points [..., P, 3]."""
    a, b = points[..., capsule.start, :], points[..., capsule.end, :]
    return a + capsule.span[0] * (b - a), a + capsule.span[1] * (b - a)


def _scale(skeleton: Skeleton) -> float:
    if skeleton.roles is None:
        return _reach(skeleton) / _REACH
    total, joint = 0.0, skeleton.roles.left_foot[0]
    while joint != skeleton.roles.left_hip and joint >= 0:
        total += float(np.linalg.norm(skeleton.offsets[joint]))
        joint = int(skeleton.parents[joint])
    return total / LEG


def _reach(skeleton: Skeleton) -> float:
    """Metres along the bones from the root to the farthest end."""
    lengths = np.zeros(skeleton.num_joints)
    for joint in range(1, skeleton.num_joints):
        lengths[joint] = lengths[skeleton.parents[joint]] + np.linalg.norm(skeleton.offsets[joint])
    ends = [lengths[joint] + float(np.linalg.norm(offset)) for joint, offset in skeleton.end_sites]
    return max(float(lengths.max()), *ends, 0.0)


def _limbs(skeleton: Skeleton, parents: list[int]) -> dict[int, tuple[str, int, str]]:
    """For each point below a limb's first joint: (part, bones since that joint, side)."""
    roles = skeleton.roles
    if roles is None:
        return {}
    roots = {
        roles.left_hip: ("leg", "left"),
        roles.right_hip: ("leg", "right"),
        roles.left_shoulder: ("arm", "left"),
        roles.right_shoulder: ("arm", "right"),
        roles.head: ("head", "middle"),
    }
    limbs: dict[int, tuple[str, int, str]] = {}
    for point, parent in enumerate(parents):
        if parent in roots:
            part, side = roots[parent]
            limbs[point] = (part, 0, side)
        elif parent in limbs:
            part, order, side = limbs[parent]
            limbs[point] = (part, order + 1, side)
    return limbs


def _thickness(skeleton: Skeleton, part: str, order: int, end: int) -> tuple[float, float]:
    if part:
        return _RADII[part][min(order, len(_RADII[part]) - 1)]
    roles = skeleton.roles
    if roles is None:
        return 0.03, 0.03
    if end == roles.head:
        return _NECK, _NECK
    if end in (roles.left_hip, roles.right_hip):
        return 0.9 * _TRUNK, 0.085
    if end in (roles.left_shoulder, roles.right_shoulder) or abs(float(skeleton.offsets[end][0])) > 0.02:
        return _GIRDLE, _GIRDLE
    return _TRUNK, _TRUNK
