"""Clips of many skeletons, and ways to write the same motion differently, for the laws of retargeting."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from random import Random

import numpy as np

from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_from_yaw,
    quat_multiply,
    quat_normalise,
    quat_rotate,
)
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.retargeting.reference import some_poses
from pfnn_jax.motion.retargeting.resting import find_resting_heights, with_resting_heights
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.walks import synthesise

FILES = {
    "bandai": ("bandai-namco-2/dataset-2_walk-turn-left_normal_001.bvh", 0, None),
    "xia": ("xia/neutral_01_000.bvh", 0, None),
    "100style": ("100style/Neutral_FW.bvh", 400, 700),
    "pfnn": ("pfnn/LocomotionFlat04_000.bvh", 0, 400),
    "mixamo": ("field/mixamorig_colon.bvh", 0, None),
    "momask": ("field/momask_walk.bvh", 0, None),
}
SOURCES = (*FILES, "procedural")


@cache
def example(mocap: Path, name: str) -> MotionClip:
    """Returns a walk of a source."""
    if name == "procedural":
        return synthesise("neutral", np.full(240, 0.3), np.full(240, 1.3))[0]
    file, start, stop = FILES[name]
    clip = read_bvh(mocap / file)
    return with_resting_heights(cut(clip, start, clip.num_frames if stop is None else stop))


def known_heights(skeleton: Skeleton) -> np.ndarray:
    """Returns the resting heights [2, 2] that a skeleton states."""
    assert skeleton.resting_heights is not None
    return skeleton.resting_heights


def measured_heights(clip: MotionClip) -> np.ndarray:
    """Returns the resting heights [2, 2] of a clip's feet."""
    found = find_resting_heights(clip, humanoid_of(clip.skeleton))
    assert found is not None
    return found


def world(clip: MotionClip) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions [T, J, 3] and rotations [T, J, 4] in the world."""
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)


def angles(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the angles in degrees between rotations [..., 4]."""
    inner = quat_multiply(quat_conjugate(a), b)
    return 2 * np.degrees(np.arctan2(np.linalg.norm(inner[..., 1:], axis=-1), np.abs(inner[..., 0])))


def renamed(clip: MotionClip) -> MotionClip:
    """Returns the clip with joints that have numbers for names."""
    names = tuple(f"joint {number}" for number in range(clip.skeleton.num_joints))
    return replace(clip, skeleton=replace(clip.skeleton, names=names))


def called(clip: MotionClip, random: Random) -> MotionClip:
    """Returns the clip with joints whose names are random words."""
    names = tuple("".join(random.choices("abcdefghij", k=6)) + str(at) for at in range(clip.skeleton.num_joints))
    return replace(clip, skeleton=replace(clip.skeleton, names=names))


def padded(clip: MotionClip, count: int, seed: int) -> MotionClip:
    """Returns the clip with joints that are in no part of the humanoid map, somewhere below its joints, in any pose."""
    random, skeleton = np.random.default_rng(seed), clip.skeleton
    joints = skeleton.num_joints
    own = np.arange(joints, joints + count)
    names = (*skeleton.names, *(f"prop {number}" for number in range(count)))
    more = replace(
        skeleton,
        names=names,
        parents=np.concatenate([skeleton.parents, random.integers(0, joints, count)]),
        offsets=np.concatenate([skeleton.offsets, random.normal(size=(count, 3))]),
        mirror=np.concatenate([skeleton.mirror, own]),
        poses=None,
        reference=None,
    )
    turned = quat_normalise(random.normal(size=(clip.num_frames, count, 4)))
    rotations = np.concatenate([clip.rotations, turned], axis=1)
    return replace(clip, skeleton=replace(more, poses=some_poses(rotations)), rotations=rotations)


def moved(clip: MotionClip, yaw: float, shift: np.ndarray) -> MotionClip:
    """Returns the clip turned about the vertical through the origin, then shifted."""
    turn, rotations = quat_from_yaw(yaw), clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    return replace(clip, root_positions=quat_rotate(turn, clip.root_positions) + shift, rotations=rotations)


def scaled(clip: MotionClip, factor: float) -> MotionClip:
    """Returns the clip of a body of another size."""
    skeleton = replace(clip.skeleton, offsets=factor * clip.skeleton.offsets)
    skeleton = replace(skeleton, end_sites=tuple((joint, factor * site) for joint, site in skeleton.end_sites))
    if skeleton.resting_heights is not None:
        skeleton = replace(skeleton, resting_heights=factor * skeleton.resting_heights)
    return replace(clip, skeleton=skeleton, root_positions=factor * clip.root_positions)


def with_rest(clip: MotionClip, pose: np.ndarray) -> MotionClip:
    """Returns the same motion of the same body on a skeleton whose zero pose is another.

    Args:
        clip: T frames on J joints.
        pose: [J, 4] world rotations of the joints in the new zero pose.
    """
    _, rotations = world(clip)
    turned = quat_multiply(rotations, quat_conjugate(pose))
    parents = clip.skeleton.parents
    local = quat_multiply(quat_conjugate(turned[:, np.maximum(parents, 0)]), turned)
    local[:, 0] = turned[:, 0]
    skeleton = skeleton_with_rest(clip.skeleton, pose)
    return replace(clip, skeleton=replace(skeleton, poses=some_poses(local)), rotations=local)


def skeleton_with_rest(skeleton: Skeleton, pose: np.ndarray) -> Skeleton:
    """Returns the skeleton with another zero pose; see `with_rest`."""
    reference = skeleton.reference  # its poses are those of the old axes
    return replace(
        skeleton,
        offsets=quat_rotate(pose[np.maximum(skeleton.parents, 0)], skeleton.offsets),
        end_sites=tuple((joint, quat_rotate(pose[joint], site)) for joint, site in skeleton.end_sites),
        poses=None,
        reference=None if reference is None else quat_multiply(reference, quat_conjugate(pose)),
    )


def turned_at(skeleton: Skeleton, joints: dict[int, np.ndarray]) -> np.ndarray:
    """Returns the world rotations [J, 4] of the zero pose with some joints, and all below them, turned in the world."""
    pose = np.tile([1.0, 0.0, 0.0, 0.0], (skeleton.num_joints, 1))
    for joint in range(skeleton.num_joints):
        if skeleton.parents[joint] >= 0:
            pose[joint] = pose[skeleton.parents[joint]]
        if joint in joints:
            pose[joint] = quat_multiply(joints[joint], pose[joint])
    return pose


Change = Callable[[MotionClip], MotionClip]
