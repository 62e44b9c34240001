"""Limbs of a skeleton found from its geometry alone, for joint names that say nothing."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.skeleton import Skeleton


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


def roles_from_geometry(skeleton: Skeleton, pose: np.ndarray) -> dict:
    """The roles that a standing pose gives; empty where it has no two legs.

    Args:
        skeleton: J joints, of which only the parents are read.
        pose: [J, 3] joint positions, Y up, in any unit.

    Returns:
        Role -> joint index, or (heel, toe) for the feet; only the roles that were found.
    """
    parents = skeleton.parents
    inner = set(parents.tolist())
    ends = [joint for joint in range(skeleton.num_joints) if joint not in inner]
    ends.sort(key=lambda joint: pose[joint, 1])
    legs = _two_limbs(parents, pose, ends)
    if legs is None:
        return {}
    hips, legs = legs
    forward = sum(pose[leg[3]] - pose[leg[2]] for leg in legs) * np.array([1.0, 0.0, 1.0])
    side = np.array([forward[2], 0.0, -forward[0]])  # Y x forward
    side = side if np.linalg.norm(side) > 1e-6 else np.array([1.0, 0.0, 0.0])
    right, left = sorted(legs, key=lambda leg: float(pose[leg[0]] @ side))
    roles: dict = {"hips": hips, "left_hip": left[0], "right_hip": right[0]}
    roles["left_foot"], roles["right_foot"] = left[2:], right[2:]
    ends = [joint for joint in ends if not {left[0], right[0]} & set(chain_up(parents, joint))]
    if ends:
        roles["head"] = max(ends, key=lambda joint: pose[joint, 1])
    arms = _two_limbs(parents, pose, sorted(ends, key=lambda j: -abs(float((pose[j] - pose[hips]) @ side))))
    if arms is not None:
        right, left = sorted(arms[1], key=lambda arm: float(pose[arm[2]] @ side))
        roles.update(left_shoulder=left[0], right_shoulder=right[0], left_hand=left[2], right_hand=right[2])
    return roles


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
    """(upper, middle, lower, tip) of a chain given from the body outwards, by its two longest successive bones."""
    kept = [j for i, j in enumerate(chain) if i == 0 or np.linalg.norm(pose[j] - pose[chain[i - 1]]) > 1e-6]
    if len(kept) < 3:
        return None
    bones = np.linalg.norm(np.diff(pose[kept], axis=0), axis=-1)
    start = int(np.argmax(np.minimum(bones[:-1], bones[1:])))
    lower = start + 2
    return kept[start], kept[start + 1], kept[lower], kept[min(lower + 1, len(kept) - 1)]
