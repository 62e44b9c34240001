"""Encodes clips as rows of a layout, decodes rows to positions in the world, and cuts windows of rows."""

from __future__ import annotations

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.body_points import POINT_NAMES, find_body_points
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.ground import facing_of, to_local, to_world
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.trajectory import Root, relative_to_root, root_motion
from pfnn_jax.motion.world_motion import WorldMotion, world_motion
from pfnn_jax.transfer.layout import LAYOUT_FPS, WINDOW_FRAMES, ClipLayout

ROOT_SMOOTHING = 3.0
"""Frames, standard deviation of the Gaussian that smooths the root's path (Holden et al. 2016)."""

MAX_SQUARED_STEP = 0.05 * 0.056444**2
"""Square metres that a foot in contact moves to the next frame at the most (Holden et al. 2016)."""

MAX_HEIGHT = 0.056444 * np.array([3.0, 2.0, 3.0, 2.0])
"""Metres above the floor up to which heels and toes are in contact (Holden et al. 2016)."""

FEET = [POINT_NAMES.index(f"{side}_{part}") for side in ("left", "right") for part in ("foot", "toe")]
"""Points in the order of contacts: left heel, left toe, right heel, right toe."""


def prepare_clip(clip: MotionClip, skeleton: Skeleton) -> MotionClip:
    """Returns a clip of any humanoid on a run's skeleton at the frame rate of rows, ready for `encode_clip`.

    Raises:
        InputError: if either skeleton has no humanoid map, no ankles, or a leg without length.
    """
    return resample(retarget(clip, skeleton).clip, LAYOUT_FPS)


def encode_clip(clip: MotionClip | WorldMotion, layout: ClipLayout) -> np.ndarray:
    """Returns the rows [T, D] of a clip, in layout units.

    Heights are above the floor, the lowest that a foot comes. The last row's velocities repeat those of the row before.

    Args:
        clip: T frames at 60 fps, T at least 2, on any humanoid skeleton.
        layout: of the rows.

    Raises:
        InputError: if the clip has another frame rate, a single frame, values that are not finite, or a skeleton
            without roles.

    Source: Holden et al. 2016 (released code), 2017 (Data Representation).
    """
    motion = world_motion(clip)
    _check(motion)
    points, root = clip_points(motion), clip_root(motion)
    points[..., 1] -= points[:, FEET, 1].min()
    local = relative_to_root(points, root)
    blocks = [np.zeros((len(local), 3))] if layout.has_reference else []
    blocks += [local.reshape(len(local), -1), _velocities(root)]
    rows = np.concatenate(blocks, axis=-1)
    rows[:, : 3 * layout.num_points + 2] /= layout.length_unit
    return np.concatenate([rows, ground_contacts(points)], axis=-1) if layout.has_contacts else rows


def decode_rows(rows: np.ndarray, layout: ClipLayout, start: Root) -> tuple[np.ndarray, Root]:
    """Returns positions and root of rows in the world, heights above the floor.

    Args:
        rows: [T, D] in layout units.
        layout: of the rows.
        start: a root whose first frame the rows begin at.

    Returns:
        (positions [T, 21, 3] metres of the points of `POINT_NAMES`, the root of every frame).
    """
    yaw = start.yaw[0] - np.concatenate([[0.0], np.cumsum(rows[:-1, layout.root_yaw_rate])])
    facing = facing_of(yaw)
    steps = layout.length_unit * to_world(rows[:-1, layout.root_velocity], facing[1:])
    path = start.positions[0] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    local = layout.length_unit * rows[:, layout.joint_position].reshape(len(rows), -1, 3)
    positions = to_world(local[:, -len(POINT_NAMES) :], facing)
    positions[..., [0, 2]] += path[:, None]
    return positions, Root(path, facing)


def cut_windows(
    rows: np.ndarray, layout: ClipLayout, size: int = WINDOW_FRAMES, step: int = WINDOW_FRAMES // 2
) -> np.ndarray:
    """Cuts rows [T, D] into overlapping windows [N, size, D]; the last one ends with the last row.

    Fewer rows than `size` are padded as in `pad_rows`, as much before as after.

    Args:
        rows: in layout units, not normalised.
        layout: of the rows.
        size: frames of a window.
        step: frames from one window to the next.
    """
    missing = max(size - len(rows), 0)
    rows = pad_rows(rows, layout, (missing + 1) // 2, missing // 2)
    starts = list(range(0, len(rows) - size + 1, step))
    if starts[-1] + size < len(rows):
        starts.append(len(rows) - size)
    return np.stack([rows[start : start + size] for start in starts])


def pad_rows(rows: np.ndarray, layout: ClipLayout, before: int, after: int) -> np.ndarray:
    """Pads rows [T, D] in layout units by the first and the last row, in which the root stands still.

    Source: Holden et al. 2016 (released code), which sets the root's velocity and turn to zero there.
    """
    padded = np.pad(rows, ((before, after), (0, 0)), mode="edge")
    standing = np.r_[:before, len(padded) - after : len(padded)]
    padded[standing, layout.root_velocity] = 0.0
    padded[standing, layout.root_yaw_rate] = 0.0
    return padded


def clip_points(motion: MotionClip | WorldMotion) -> np.ndarray:
    """Returns the 21 points [T, 21, 3] of a clip in metres, in the world."""
    motion = world_motion(motion)
    points = find_body_points(motion.skeleton, motion.clip.source or "clip")
    return points.positions(motion.positions, motion.rotations)


def clip_root(motion: MotionClip | WorldMotion) -> Root:
    """Returns the root of every frame of a clip: the path of the hips and the facing, both smoothed."""
    motion = world_motion(motion)
    root = root_motion(motion.positions, motion.roles, motion.fps)
    return Root(gaussian_filter(root.positions, ROOT_SMOOTHING * motion.fps / LAYOUT_FPS), root.directions)


def floor_height(motion: MotionClip | WorldMotion) -> float:
    """Returns the height in metres of the floor of a clip: the lowest that a foot comes."""
    return float(clip_points(motion)[:, FEET, 1].min())


def ground_contacts(points: np.ndarray) -> np.ndarray:
    """Returns contacts [T, 4] (0 or 1) of heels and toes that are low and slow, from points above the floor.

    Args:
        points: [T, 21, 3] metres at 60 fps.
    """
    feet = points[:, FEET]
    squared = np.sum(np.diff(feet, axis=0) ** 2, axis=-1)
    squared = np.concatenate([squared, squared[-1:]])
    return ((squared < MAX_SQUARED_STEP) & (feet[..., 1] < MAX_HEIGHT)).astype(float)


def _velocities(root: Root) -> np.ndarray:
    """Returns root velocity and yaw rate [T, 3] of every frame, in metres and radians per frame."""
    facing, yaw = root.facing, np.unwrap(root.yaw)
    steps = to_local(np.diff(root.positions, axis=0), facing[1:])
    both = np.concatenate([steps, -np.diff(yaw)[:, None]], axis=-1)
    return np.concatenate([both, both[-1:]])


def _check(motion: WorldMotion) -> None:
    source = motion.clip.source or "clip"
    if abs(motion.fps - LAYOUT_FPS) > 1e-3:
        raise InputError(source, "frame rate", motion.fps, f"must be {LAYOUT_FPS:g}; resample the clip")
    if motion.num_frames < 2:
        raise InputError(source, "frames", motion.num_frames, "must be at least 2")
    if not np.isfinite(motion.positions).all():
        raise InputError(source, "positions", "not finite", "must be finite numbers")
