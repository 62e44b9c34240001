"""Limbs of a skeleton found from its geometry alone, for joint names that say nothing."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.skeleton import Skeleton

LIMB = (
    0.6  # of the longest bone: forearms and calves are longer than this, clavicles before them do not count, nor feet
)


def chain_up(parents: np.ndarray, joint: int) -> list[int]:
    """The joint and all above it, up to the root."""
    chain = [int(joint)]
    while parents[chain[-1]] >= 0:
        chain.append(int(parents[chain[-1]]))
    return chain


def rest_pose(skeleton: Skeleton) -> np.ndarray:
    """[J, 3] positions with all rotations zero."""
    pose = np.zeros((skeleton.num_joints, 3))
    for joint in range(1, skeleton.num_joints):
        pose[joint] = pose[skeleton.parents[joint]] + skeleton.offsets[joint]
    return pose


def longest_chain(skeleton: Skeleton) -> float:
    """Length of the longest run of bones from the root to an end, End Sites left out, in the skeleton's unit."""
    reach = np.zeros(skeleton.num_joints)
    for joint in range(1, skeleton.num_joints):
        reach[joint] = reach[skeleton.parents[joint]] + np.linalg.norm(skeleton.offsets[joint])
    return float(reach.max())


def roles_from_geometry(skeleton: Skeleton, poses: np.ndarray) -> dict:
    """The roles that standing or moving poses give; empty where there are no two legs.

    Args:
        skeleton: J joints, of which only the parents are read.
        poses: [N, J, 3] joint positions, Y up, in any unit.

    Returns:
        Role -> joint index, or (heel, toe) for the feet; only the roles that were found.
    """
    parents, pose, height = skeleton.parents, poses[0], poses[..., 1].mean(axis=0)
    inner = set(parents.tolist())
    ends = sorted((joint for joint in range(skeleton.num_joints) if joint not in inner), key=lambda j: height[j])
    fork = _two_limbs(parents, pose, ends)
    if fork is None:
        return {}
    hips, legs = fork
    # how far to the left of the hips each joint is, on average over the poses
    leftness = np.einsum("njc,nc->j", poses - poses[:, hips, None], _left(poses, legs))
    right, left = sorted(legs, key=lambda leg: leftness[leg[0]])
    roles: dict = {"hips": hips, "left_hip": left[0], "right_hip": right[0]}
    roles["left_foot"], roles["right_foot"] = left[2:], right[2:]
    ends = [joint for joint in ends if not {left[0], right[0]} & set(chain_up(parents, joint))]
    if ends:
        roles["head"] = max(ends, key=lambda joint: height[joint])
    fork = _two_limbs(parents, pose, sorted(ends, key=lambda joint: -abs(leftness[joint])))
    if fork is not None:
        right, left = sorted(fork[1], key=lambda arm: leftness[arm[2]])
        roles.update(left_shoulder=left[0], right_shoulder=right[0], left_hand=left[2], right_hand=right[2])
    return roles


def _left(poses: np.ndarray, legs: list[tuple]) -> np.ndarray:
    """[N, 3] horizontal direction to the left of where the toes point, as long as they do; +X if there are no toes."""
    (_, _, *one), (_, _, *other) = legs
    forward = poses[:, one[1]] - poses[:, one[0]] + poses[:, other[1]] - poses[:, other[0]]
    left = np.stack((forward[:, 2], np.zeros(len(poses)), -forward[:, 0]), axis=-1)  # Y x forward
    return left if np.abs(left).max() > 1e-6 else np.tile([1.0, 0.0, 0.0], (len(poses), 1))


def _two_limbs(parents: np.ndarray, pose: np.ndarray, ends: list[int]) -> tuple[int, list[tuple]] | None:
    """The joint where the first end's chain parts from another's, and both limbs, trying ends in order."""
    for other in ends[1:]:
        first, second = chain_up(parents, ends[0]), chain_up(parents, other)
        fork = next(joint for joint in first if joint in second)
        limbs = [_limb(pose, chain[: chain.index(fork)][::-1]) for chain in (first, second)]
        if limbs[0] is not None and limbs[1] is not None:
            return fork, [limb for limb in limbs if limb is not None]
    return None


def _limb(pose: np.ndarray, chain: list[int]) -> tuple[int, int, int, int] | None:
    """(upper, middle, lower, tip) of a chain given from the body outwards, by the last two successive long bones."""
    kept = [j for i, j in enumerate(chain) if i == 0 or np.linalg.norm(pose[j] - pose[chain[i - 1]]) > 1e-6]
    if len(kept) < 3:
        return None
    bones = np.linalg.norm(np.diff(pose[kept], axis=0), axis=-1)
    shorter = np.minimum(bones[:-1], bones[1:])
    long = np.flatnonzero(shorter >= LIMB * bones.max())
    start = int(long[-1]) if len(long) else int(np.argmax(shorter))
    lower = start + 2
    return kept[start], kept[start + 1], kept[lower], kept[min(lower + 1, len(kept) - 1)]
