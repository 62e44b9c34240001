"""Metrics of style transfer between clips, in NumPy: distances of poses, with and without their timing, and of paths.

Poses are [T, P, 3] in metres: points of the body relative to the hips and to the facing of each frame
(`facing_poses`). All clips compared have the same points of one skeleton, at one frame rate.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pfnn_jax.motion.trajectory import relative_to_root, root_motion
from pfnn_jax.motion.world_motion import WorldMotion
from pfnn_jax.transfer.clip_rows import clip_points


def facing_poses(world: WorldMotion) -> np.ndarray:
    """Returns the 21 points of the body [T, 21, 3] in metres, without the motion of the hips and the facing.

    Positions are relative to the hips, turned so that the character faces +Z, and heights begin at the height of the
    hips in the first frame: what a jump adds to the height of all joints is not part of the pose.

    Source: preprocessing of MoST (Kim et al. 2024), which uses the same 21 joints and the facing of Holden et al. 2016.
    """
    points, root = clip_points(world), root_motion(world.positions, world.roles, world.fps)
    hips = points[:, 0, 1].copy()
    poses = relative_to_root(points, root)
    poses[..., 1] += (hips[0] - hips)[:, None]
    return poses


def content_consistency(result: np.ndarray, content: np.ndarray, *, warp: bool = False) -> float:
    """Returns the distance of a result from its content clip in metres (CC), small if the content is kept.

    MoST measures CC where content and style clip have the same style, so that the content itself is the right answer.
    Between different styles it also counts what the transfer should change.

    Args:
        result: [T, P, 3] poses of the result.
        content: [U, P, 3] poses of the content clip.
        warp: as in `pose_distance`.

    Source: Kim et al. 2024 (MoST), section 4. Its numbers are sums over 21 joints in units of 5.6444 cm: this mean in
    metres times 372.
    """
    return pose_distance(result, content, warp=warp)


def style_consistency(result: np.ndarray, truths: Sequence[np.ndarray], *, warp: bool = False) -> float:
    """Returns the mean distance of a result from real clips of its content in the target style in metres (SC++).

    Args:
        result: [T, P, 3] poses of the result.
        truths: [U, P, 3] poses of each real clip.
        warp: as in `pose_distance`.

    Source: Kim et al. 2024 (MoST), section 4; units as in `content_consistency`.
    """
    return float(np.mean([pose_distance(result, truth, warp=warp) for truth in truths]))


def pose_distance(a: np.ndarray, b: np.ndarray, *, warp: bool = False) -> float:
    """Returns the mean distance of points between two motions in metres.

    Args:
        a: [T, P, 3] metres.
        b: [U, P, 3] metres.
        warp: compare the frames that `dynamic_time_warping` matches, so that a change of timing alone costs nothing;
            otherwise frames of the same number, up to the end of the shorter clip.
    """
    if warp:
        return dynamic_time_warping(frame_distances(a, b))[0]
    shorter = min(len(a), len(b))
    return float(np.linalg.norm(a[:shorter] - b[:shorter], axis=-1).mean())


def frame_distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the mean distance [T, U] of points between each frame of [T, P, 3] and each of [U, P, 3], in metres."""
    total = np.zeros((len(a), len(b)))
    for point in range(a.shape[1]):  # point by point, which keeps [T, U, P, 3] out of memory
        total += np.linalg.norm(a[:, None, point] - b[None, :, point], axis=-1)
    return total / a.shape[1]


def dynamic_time_warping(distances: np.ndarray) -> tuple[float, np.ndarray]:
    """Matches the frames of two motions, in order and from end to end, at the least mean distance.

    A step in both motions has twice the weight of a step in one, so that all paths have the same total weight T + U.
    The cost of two motions of the same length is therefore at most the mean of the diagonal.

    Args:
        distances: [T, U] distance of each pair of frames.

    Returns:
        The weighted mean distance, and the matched frames [M, 2].

    Source: Sakoe and Chiba 1978, the symmetric form without slope constraint.
    """
    rows, columns = distances.shape
    least = np.full((rows + 1, columns + 1), np.inf)  # one row and column more, so that every cell has a predecessor
    least[0, 0] = 0.0
    for diagonal in range(2, rows + columns + 1):  # cells of an anti-diagonal do not depend on each other
        i = np.arange(max(1, diagonal - columns), min(rows, diagonal - 1) + 1)
        j = diagonal - i
        own = distances[i - 1, j - 1]
        single = np.minimum(least[i - 1, j], least[i, j - 1]) + own
        least[i, j] = np.minimum(single, least[i - 1, j - 1] + 2.0 * own)
    return float(least[-1, -1] / (rows + columns)), _matched(least, distances)


def _matched(least: np.ndarray, distances: np.ndarray) -> np.ndarray:
    """Returns the matched frames [M, 2] by following the least sums [T + 1, U + 1] back from the end."""
    i, j = distances.shape
    path = []
    while i and j:
        path.append((i - 1, j - 1))
        both = least[i - 1, j - 1] + distances[i - 1, j - 1]  # the step counts twice, and once in each other sum
        i, j = min(((both, i - 1, j - 1), (least[i - 1, j], i - 1, j), (least[i, j - 1], i, j - 1)))[1:]
    return np.array(path[::-1])


def trajectory_distance(result: np.ndarray, content: np.ndarray, *, fit_speed: bool = False) -> float:
    """Returns the mean distance in metres between two paths of the root that begin at one point.

    Frames of the same number are compared, up to the end of the shorter clip.

    Args:
        result: [T, 2] metres, x and z.
        content: [U, 2] metres.
        fit_speed: scale the result's path by the factor that fits best first, which leaves the shape: a style may be
            faster than the content, and Holden et al. 2016 scale the trajectory by the ratio of speeds. Two paths that
            lead apart are fitted by no positive factor, and the result's path by 0.

    Source: after the trajectory similarity index (TSI) of MCM-LDM (Song et al. 2024), a mean distance of root paths
    from a common start; that the speed may be fitted is added here.
    """
    shorter = min(len(result), len(content))
    a, b = result[:shorter] - result[0], content[:shorter] - content[0]
    if fit_speed:
        a = a * (max(float((a * b).sum()), 0.0) / max(float((a * a).sum()), 1e-12))
    return float(np.linalg.norm(a - b, axis=-1).mean())
