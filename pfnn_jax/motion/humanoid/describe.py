"""Says what a skeleton looks like: its rest pose, the direction it faces, and what its map leaves out."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.humanoid.map import ARM, LEG, SIDES, HumanoidMap
from pfnn_jax.motion.humanoid.tree import joint_tree
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

T_POSE, A_POSE = 15.0, 60.0
"""Degrees below the shoulders' line up to which raised arms are those of a T-pose, and of an A-pose."""

STRAIGHT = 35.0
"""Degrees up to which the knee of a standing body bends, and legs deviate from the line of the trunk."""

REST_POSES = ("T", "A", "arms down", "arms up", "standing", "a frame of the motion", "none")
"""Kinds of rest poses: `standing` without arms; `none` where bones lie along one axis of their joints."""


def rest_pose_kind(skeleton: Skeleton, humanoid: HumanoidMap) -> str:
    """Returns which of `REST_POSES` a skeleton has where all rotations are zero."""
    pose = rest_pose(skeleton)
    legs = [[joint for joint in humanoid.limb(side, LEG)[:3] if joint is not None] for side in SIDES]
    top = _top(humanoid)
    if top is None:
        return "none"
    thighs = pose[[leg[0] for leg in legs]].mean(axis=0)
    up = pose[top] - thighs
    if any(_angle(pose[leg[0]] - pose[leg[-1]], up) > 2 * STRAIGHT for leg in legs):
        return "none"
    bends = [_angle(pose[leg[1]] - pose[leg[0]], pose[leg[2]] - pose[leg[1]]) for leg in legs if len(leg) == 3]
    slants = [_angle(pose[leg[0]] - pose[leg[-1]], up) for leg in legs]
    if max([*bends, *slants]) > STRAIGHT:
        return "a frame of the motion"
    return _arm_pose(pose, humanoid, up)


def _arm_pose(pose: np.ndarray, humanoid: HumanoidMap, up: np.ndarray) -> str:
    """Returns the kind of a standing rest pose [J, 3] by its arms; A-poses have them between T and down."""
    arms = [[joint for joint in humanoid.limb(side, ARM)[1:] if joint is not None] for side in SIDES]
    if not all(arms):
        return "standing"
    below = np.mean([_angle(pose[arm[-1]] - pose[arm[0]], up) - 90.0 for arm in arms])
    if below < -A_POSE / 2:
        return "arms up"
    return "T" if below < T_POSE else "A" if below < A_POSE else "arms down"


def rest_axes(skeleton: Skeleton, humanoid: HumanoidMap) -> tuple[str, str]:
    """Returns the axes along which the rest pose stands and which it faces, such as `+Y` and `+Z`.

    The facing is that of the toes or, without toes, across the hips. An axis that the pose does not show is empty.
    """
    pose, top = rest_pose(skeleton), _top(humanoid)
    thighs = pose[[humanoid.left_thigh, humanoid.right_thigh]].mean(axis=0)
    up = np.zeros(3) if top is None else pose[top] - thighs
    feet = [humanoid.limb(side, ("foot", "toe")) for side in SIDES]
    if any(None in foot for foot in feet):
        forward = np.cross(pose[humanoid.left_thigh] - pose[humanoid.right_thigh], up)
    else:
        forward = sum((pose[toe] - pose[foot] for foot, toe in feet), np.zeros(3))
    axis = int(np.argmax(np.abs(up)))
    forward[axis] = 0.0
    return _axis_name(up), _axis_name(forward)


def _axis_name(vector: np.ndarray) -> str:
    """Returns the name of the axis that a vector is nearest to, such as `-X`; empty for a vector without length."""
    axis = int(np.argmax(np.abs(vector)))
    return f"{'+' if vector[axis] > 0 else '-'}{'XYZ'[axis]}" if vector[axis] else ""


def leg_length_of(skeleton: Skeleton, humanoid: HumanoidMap) -> float:
    """Returns the length from hip over knee to ankle, the mean of both legs, in the skeleton's unit.

    Joints between them are taken at rest. A leg without an ankle ends at the knee.
    """
    total = 0.0
    for side in SIDES:
        leg = [joint for joint in humanoid.limb(side, LEG)[:3] if joint is not None]
        bones = [_between(skeleton, *pair) for pair in zip(leg, leg[1:], strict=False)]
        total += float(np.linalg.norm(bones, axis=-1).sum())
    return total / 2


def _between(skeleton: Skeleton, joint: int, end: int) -> np.ndarray:
    """Returns the vector [3] from a joint to another one, below it or elsewhere, in the rest pose."""
    tree = joint_tree(tuple(skeleton.parents.tolist()))
    if tree.is_above(joint, end):
        return skeleton.offsets[tree.down(joint, end)].sum(axis=0)
    pose = rest_pose(skeleton)
    return pose[end] - pose[joint]


def left_out(skeleton: Skeleton, humanoid: HumanoidMap) -> list[str]:
    """Returns the names of the joints that are in no part of the map."""
    used: set[int] = set()
    for joint in humanoid.joints().values():
        used |= set(joint) if isinstance(joint, tuple) else {joint} if joint is not None else set()
    return [name for joint, name in enumerate(skeleton.names) if joint not in used]


def _top(humanoid: HumanoidMap) -> int | None:
    """Returns the head, or the highest joint of neck and spine, or None."""
    chain = [*humanoid.spine, *humanoid.neck, *(() if humanoid.head is None else (humanoid.head,))]
    return chain[-1] if chain else None


def _angle(one: np.ndarray, other: np.ndarray) -> float:
    """Returns the degrees between two vectors, 0 if either has no length."""
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.degrees(np.arccos(np.clip(one @ other / size, -1.0, 1.0)))) if size > 0 else 0.0
