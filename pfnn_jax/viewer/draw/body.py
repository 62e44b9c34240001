"""The body that is drawn: tapered capsules along the bones of a skeleton, as thick as a person's limbs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_rotate
from pfnn_jax.motion.reading import Up
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.up_axis import find_up, stand_up

LEG = 0.83  # metres, length of thigh and shin for which the radii below hold
SHORTEST = 0.015  # metres; shorter bones only carry a rotation and are not drawn
_RADII = {  # metres at both ends, by part and by the number of bones from the part's first joint
    "leg": ((0.078, 0.056), (0.056, 0.038), (0.042, 0.034), (0.034, 0.026)),
    "arm": ((0.048, 0.04), (0.04, 0.03), (0.034, 0.022), (0.016, 0.012)),
    "head": ((0.08, 0.092),),
}
_HEAD_SPAN = (0.3, 0.56)
_CROWN = 0.1  # metres; a shorter bone above the head joint does not locate the head
_REACH = 1.1  # metres along the bones from a person's hips to the farthest fingertip or toe
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
        span: positions of the two centres on the line, from 0 at its start to 1 at its end; a head is rounder than the
            bone that carries it.
    """

    start: int
    end: int
    start_radius: float
    end_radius: float
    side: str
    span: tuple[float, float] = (0.0, 1.0)


def body_points(clip: MotionClip) -> np.ndarray:
    """Returns the world positions [T, J + E, 3] in metres of the joints, then of the End Sites."""
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    ends = [positions]
    for joint, offset in clip.skeleton.end_sites:
        ends.append((positions[:, joint] + quat_rotate(rotations[:, joint], offset))[:, None])
    return np.concatenate(ends, axis=1)


def upright(clip: MotionClip, up: Up = "auto") -> MotionClip:
    """Returns the clip with Y up, which all drawing assumes.

    Args:
        clip: the motion. Clips that were read from a file have Y up already.
        up: the axis that points up in the clip; `auto` finds it from how the body stands, if the skeleton has a map.
    """
    if up == "auto":
        up = "y"
        if clip.skeleton.humanoid is not None and clip.reading is None:
            positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
            up = find_up(positions, clip.skeleton.humanoid)[0]
    return stand_up(clip, up)


def facing_angles(clip: MotionClip, points: np.ndarray) -> np.ndarray:
    """Returns the facing direction [T] of hips and shoulders in radians; zero if the skeleton's roles are unknown.

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
    """Returns the limb segments of a skeleton with a person's radii, scaled by the length of the legs.

    Without roles all bones have the same small radius, scaled by the longest limb; a skeleton without bones is a dot.
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
    """Returns a head on the bone above the head joint, or in line with the neck without a bone long enough."""
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
    """Returns the centres [..., 3] of a capsule's two ends, from points [..., P, 3]."""
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
    """Returns the metres along the bones from the root to the farthest end."""
    lengths = np.zeros(skeleton.num_joints)
    for joint in range(1, skeleton.num_joints):
        lengths[joint] = lengths[skeleton.parents[joint]] + np.linalg.norm(skeleton.offsets[joint])
    ends = [lengths[joint] + float(np.linalg.norm(offset)) for joint, offset in skeleton.end_sites]
    return max(float(lengths.max()), *ends, 0.0)


def _limbs(skeleton: Skeleton, parents: list[int]) -> dict[int, tuple[str, int, str]]:
    """Returns (part, number of bones from the limb's first joint, side) of every point below that joint."""
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
