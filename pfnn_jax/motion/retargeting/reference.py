"""The reference pose of a skeleton: a T pose that faces +Z, stands upright and has flat feet.

Two skeletons are comparable in it: there every part of both bodies has the same orientation, however the local axes of
their joints were chosen. It is given by the world rotation of every joint.

- Where the zero pose is a person who stands (T pose, A pose, arms down, legs apart), it is that pose with arms and legs
  turned to the axes by the shortest arc; spine, neck, clavicles and feet keep their own shape.
- Elsewhere (bones along the local X axis, say) zero rotations mean nothing. Hips and chest are then oriented by the
  hips, shoulders and spine that hang on them, every other bone is turned to its direction in a T pose, and the twist
  about it, which positions do not show, is the mean twist in a motion and its mirror image
  (`find_reference`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip, mirror_clip
from pfnn_jax.motion.filters import median
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_between,
    quat_conjugate,
    quat_from_axis_angle,
    quat_from_matrix,
    quat_multiply,
    quat_normalise,
    quat_rotate,
)
from pfnn_jax.motion.retargeting.body import (
    FORWARD,
    MIN_LENGTH,
    SIDES,
    Part,
    bone_of,
    limb,
    neck_chain,
    parts_of,
    torso_chain,
)
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

UPRIGHT = np.cos(np.radians(40.0))
"""Cosine of the angle to the vertical within which thighs, shins and spine of a standing person lie."""

FLAT = np.sin(np.radians(65.0))
"""Sine of the angle below the horizontal at which a foot of a standing person may point; beyond it hangs."""

FOOT_PITCH = np.radians(30.0)
"""Angle below the horizontal of the line from ankle to toe in a flat foot, where no pose shows it: it is 10° to 40°."""

HEAD_UP = np.cos(np.radians(60.0))
"""Cosine of the angle to the neck beyond which a head's bone, often a made-up End Site, does not point to its crown."""

NUM_POSES = 60  # enough for the mean twist of each joint and for some flat feet
STANDING_SHARE = 0.1  # of all poses: those with the lowest foot, in which it is flat

Twist = Callable[[Part, np.ndarray], np.ndarray]
"""Gives the reference rotation [4] of a part's joint, from one whose twist about the bone is arbitrary."""


def reference_pose(skeleton: Skeleton, body: HumanoidMap) -> np.ndarray:
    """Returns the world rotation [J, 4] of every joint in the reference pose.

    It is the one stored in the skeleton, that of the zero pose, or that of the poses stored in the skeleton. Without
    any of these the twist about bones is arbitrary, which positions do not show, and the pitch of the feet is a guess.
    Joints that do not belong to the body turn with their parents.

    Args:
        skeleton: J joints.
        body: its humanoid map.
    """
    if skeleton.reference is not None:
        return skeleton.reference
    if stands(skeleton, body):
        return _from_zero_pose(skeleton, body)
    if skeleton.poses is not None:
        return find_reference(skeleton, skeleton.poses, body)
    return _from_bones(skeleton, body, {side: FOOT_PITCH for side in SIDES}, lambda part, turn: turn)


def some_poses(rotations: np.ndarray) -> np.ndarray:
    """Returns at most `NUM_POSES` of T poses [T, J, 4], evenly spread."""
    return rotations[:: -(-len(rotations) // NUM_POSES)].copy()


def find_reference(skeleton: Skeleton, poses: np.ndarray, body: HumanoidMap) -> np.ndarray:
    """Returns the reference pose [J, 4] of a skeleton whose zero pose says nothing, from poses of a motion.

    The twist of each bone against the part that carries it is zero on average, and a foot is flat where it is lowest
    below the hips. Averages are taken over the poses and their mirror images, so that left and right are alike however
    the body turns or limps.

    Args:
        skeleton: J joints.
        poses: [N, J, 4] local rotations, as in a clip.
        body: the skeleton's humanoid map.
    """
    poses = _with_mirror_images(skeleton, poses, body)
    positions, world = forward_kinematics(skeleton, np.zeros((len(poses), 3)), poses)
    positions = positions - positions[:, body.hips, None]
    pitches = {side: _foot_pitch(positions, body, side) for side in SIDES}
    turns: dict[int, np.ndarray] = {}  # [N, 4] of each part in the world, from the reference pose

    def twist(part: Part, turn: np.ndarray) -> np.ndarray:
        if part.above in turns:
            relative = quat_multiply(quat_conjugate(turns[part.above]), world[:, part.joint])
            turn = _mean_twist(part, turn, relative, skeleton)
        turns[part.joint] = quat_multiply(world[:, part.joint], quat_conjugate(turn))
        return turn

    return _from_bones(skeleton, body, pitches, twist)


def _with_mirror_images(skeleton: Skeleton, poses: np.ndarray, body: HumanoidMap) -> np.ndarray:
    """Returns poses [N, J, 4] with their mirror images; alone if left and right joints are not paired."""
    if skeleton.mirror[body.left_thigh] != body.right_thigh:
        return poses
    clip = MotionClip(skeleton, 1.0, np.zeros((len(poses), 3)), poses)
    return np.concatenate((poses, mirror_clip(clip).rotations))


def stands(skeleton: Skeleton, body: HumanoidMap) -> bool:
    """Returns whether the zero pose is a person standing upright, whatever the arms do."""
    frame = _zero_frame(skeleton, body)
    if frame is None:
        return False
    rest = rest_pose(skeleton) @ frame
    for side in SIDES:
        leg = np.diff(rest[list(limb(body, side, "thigh", "shin", "foot"))], axis=0)
        if np.any(-leg[:, 1] < UPRIGHT * np.linalg.norm(leg, axis=-1)):
            return False
        foot, toe = limb(body, side, "foot", "toe")
        if foot is not None and toe is not None and rest[toe, 2] - rest[foot, 2] < -MIN_LENGTH:
            return False  # left and right are exchanged, or it is no stance
    spine = _shoulders(rest, body) - rest[body.hips]
    return bool(spine[1] >= UPRIGHT * np.linalg.norm(spine))


def standing_pitches(skeleton: Skeleton, body: HumanoidMap) -> list[float] | None:
    """Returns the pitch in radians below the horizontal of the line from ankle to toe of each foot in the zero pose.

    Left before right; None where the zero pose is not a person who stands. A foot without toe has none, here 0.
    """
    frame = _zero_frame(skeleton, body)
    if frame is None or not stands(skeleton, body):
        return None
    rest, pitches = rest_pose(skeleton) @ frame, []
    for side in SIDES:
        foot, toe = limb(body, side, "foot", "toe")
        bone = np.zeros(3) if toe is None else rest[toe] - rest[foot]
        sine = -bone[1] / max(float(np.linalg.norm(bone)), 1e-9)
        pitches.append(FOOT_PITCH if sine > FLAT else float(np.arcsin(sine)))  # as in `_flat_foot`
    return pitches


def _zero_frame(skeleton: Skeleton, body: HumanoidMap) -> np.ndarray | None:
    """Returns the axes [3, 3] of the body in the zero pose, as columns: to its left, upwards, and to the front."""
    rest = rest_pose(skeleton)
    left = rest[body.left_thigh] - rest[body.right_thigh]
    up = _shoulders(rest, body) - (rest[body.left_foot] + rest[body.right_foot]) / 2
    return _axes(left, up, MIN_LENGTH * leg_length_of(skeleton, body))


def _shoulders(rest: np.ndarray, body: HumanoidMap) -> np.ndarray:
    """Returns the point [3] between the shoulders; without arms the base of neck or head, or the chest."""
    if body.left_upper_arm is not None and body.right_upper_arm is not None:
        return (rest[body.left_upper_arm] + rest[body.right_upper_arm]) / 2
    return rest[(*neck_chain(body), *torso_chain(body)[::-1])[0]]


def _axes(left: np.ndarray, up: np.ndarray, shortest: float) -> np.ndarray | None:
    """Returns orthonormal columns [3, 3]: left, up made perpendicular to it, and forward; None if undefined."""
    if np.linalg.norm(left) < shortest:
        return None
    x = left / np.linalg.norm(left)
    y = up - (up @ x) * x
    if np.linalg.norm(y) < shortest:
        return None
    y = y / np.linalg.norm(y)
    return np.stack((x, y, np.cross(x, y)), axis=-1)


def _from_zero_pose(skeleton: Skeleton, body: HumanoidMap) -> np.ndarray:
    """Returns the reference of a skeleton that stands in its zero pose."""
    frame = _zero_frame(skeleton, body)
    assert frame is not None
    shortest = MIN_LENGTH * leg_length_of(skeleton, body)
    swings: dict[int, np.ndarray] = {}  # from the zero pose, in the body's axes
    for part in parts_of(body):
        carried = swings.get(part.above, np.array([1.0, 0.0, 0.0, 0.0]))
        kind = part.name.split("_", 1)[-1]
        bone = bone_of(skeleton, part) @ frame
        if kind == "foot":
            carried = _flat_foot(bone, shortest)
        elif kind in ("upper_arm", "lower_arm", "thigh", "shin") and np.linalg.norm(bone) > shortest:
            carried = quat_multiply(quat_between(quat_rotate(carried, bone), part.direction), carried)
        swings[part.joint] = carried
    to_body = quat_conjugate(quat_from_matrix(frame))
    return _carry(skeleton, {joint: quat_multiply(swing, to_body) for joint, swing in swings.items()})


def _flat_foot(bone: np.ndarray, shortest: float) -> np.ndarray:
    """Returns the rotation [4] from a flat foot in the body's axes to one that points forward."""
    flat, size = bone * np.array([1.0, 0.0, 1.0]), np.linalg.norm(bone)
    if size <= shortest:
        return np.array([1.0, 0.0, 0.0, 0.0])
    if -bone[1] > FLAT * size:  # it hangs, and its own pitch says nothing
        return quat_between(bone, _pitched(FOOT_PITCH))
    return quat_between(flat, FORWARD)


def _pitched(pitch: float) -> np.ndarray:
    return np.array([0.0, -np.sin(pitch), np.cos(pitch)])


def _from_bones(skeleton: Skeleton, body: HumanoidMap, pitches: dict[str, float], twist: Twist) -> np.ndarray:
    """Returns the reference by turning every bone to its direction in a T pose.

    Args:
        skeleton: J joints.
        body: its humanoid map.
        pitches: of the line from ankle to toe of each foot below the horizontal, in radians.
        twist: chooses the twist about each bone.
    """
    shortest = MIN_LENGTH * leg_length_of(skeleton, body)
    turns: dict[int, np.ndarray] = {}
    for part in parts_of(body):
        above = turns.get(part.above, np.array([1.0, 0.0, 0.0, 0.0]))
        frame = _trunk_frame(skeleton, body, part.joint, shortest)
        if frame is not None:
            turns[part.joint] = quat_conjugate(quat_from_matrix(frame))
            twist(replace(part, above=-1), turns[part.joint])  # its twist is known
            continue
        side, kind = part.name.split("_", 1) if "_" in part.name else ("", part.name)
        direction = _pitched(pitches[side]) if kind == "foot" else part.direction
        bone = bone_of(skeleton, part)
        if np.linalg.norm(bone) > shortest:
            above = quat_multiply(quat_between(quat_rotate(above, bone), direction), above)
        turns[part.joint] = twist(replace(part, direction=direction), above)
    return _carry(skeleton, turns)


def _trunk_frame(skeleton: Skeleton, body: HumanoidMap, joint: int, shortest: float) -> np.ndarray | None:
    """Returns the body's axes [3, 3] in the frame of the hips or the chest, by what hangs on them; None for others."""
    rest = rest_pose(skeleton)
    torso, neck = torso_chain(body), neck_chain(body)
    pairs, upwards = [], (*torso[1:], *neck)
    if joint == body.hips:
        pairs = [limb(body, side, "thigh") for side in SIDES]
    elif joint == torso[-1]:
        pairs = [[j for j in limb(body, side, "clavicle", "upper_arm") if j is not None] for side in SIDES]
        upwards = neck
    if not pairs or not upwards:
        return None
    for left, right in zip(*pairs, strict=True):
        found = _axes(rest[left] - rest[right], rest[upwards[0]] - rest[joint], shortest)
        if found is not None:
            return found
    return None


def _mean_twist(part: Part, turn: np.ndarray, relative: np.ndarray, skeleton: Skeleton) -> np.ndarray:
    """Returns the reference rotation [4] about whose bone the mean twist of a motion is zero.

    Args:
        part: the part.
        turn: [4] reference rotation with an arbitrary twist.
        relative: [N, 4] rotations of its joint against the part that carries it.
        skeleton: of the joints.

    A part without a bone takes the mean of its rotations, and so does a head whose bone is no axis of the head.
    """
    bone = bone_of(skeleton, part)
    held = quat_rotate(relative, bone).mean(axis=0)
    misleads = part.name == "head" and held @ part.direction < HEAD_UP * np.linalg.norm(held)
    if np.linalg.norm(bone) < MIN_LENGTH or misleads:
        signs = np.sign(relative @ relative[0])[:, None]
        return quat_normalise((relative * np.where(signs == 0, 1.0, signs)).mean(axis=0))
    remaining = quat_multiply(relative, quat_conjugate(turn))
    # the twist of a quaternion (w, v) about a unit axis c is the angle of w + i (v · c), doubled
    half = remaining[:, 0] + 1j * (remaining[:, 1:] @ part.direction)
    angle = float(np.angle(np.sum(half**2)))
    return quat_multiply(quat_from_axis_angle(part.direction, np.array(angle)), turn)


def _foot_pitch(positions: np.ndarray, body: HumanoidMap, side: str) -> float:
    """Returns the pitch in radians of the line from ankle to toe while the foot stands, in positions [N, J, 3]."""
    foot, toe = limb(body, side, "foot", "toe")
    if toe is None:
        return FOOT_PITCH
    bones = positions[:, toe] - positions[:, foot]
    lowest = np.argsort(positions[:, toe, 1] + positions[:, foot, 1], kind="stable")
    lowest = lowest[: max(1, int(STANDING_SHARE * len(lowest)))]
    size = float(np.linalg.norm(bones, axis=-1).max())
    return FOOT_PITCH if size < MIN_LENGTH else float(np.arcsin(np.clip(median(-bones[lowest, 1]) / size, -1, 1)))


def _carry(skeleton: Skeleton, turns: dict[int, np.ndarray]) -> np.ndarray:
    """Returns rotations [J, 4]: joints without one of their own turn with their parents, a root with the hips."""
    first = next(iter(turns.values()))
    rotations = np.tile(first, (skeleton.num_joints, 1))
    for joint in range(skeleton.num_joints):
        parent = skeleton.parents[joint]
        rotations[joint] = turns.get(joint, rotations[parent] if parent >= 0 else first)
    return rotations
