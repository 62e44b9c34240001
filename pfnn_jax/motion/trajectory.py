"""The root of every frame (position and facing on the ground), and the trajectory around every frame.

Ground vectors are (x, z); `ground` defines facing and yaw.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.motion.features.layout import TRAJECTORY_OFFSETS, FrameLayout
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.ground import facing_of, to_local, yaw_of
from pfnn_jax.motion.skeleton import Roles

LAYOUT_FPS = 60.0
"""Frame rate of the frames that `TRAJECTORY_OFFSETS` counts."""

EXTRAPOLATION_SECONDS = 0.5
"""Span at a clip's ends whose mean velocity extrapolates it: about one step, so that hip sway averages out."""


@dataclass(frozen=True, eq=False)
class Root:
    """The root of every frame.

    Attributes:
        positions: [T, 2] metres, the hips projected onto the ground (x, z).
        directions: [T, 2] unit vectors (x, z), the facing; zero in degenerate poses.
    """

    positions: np.ndarray
    directions: np.ndarray

    @property
    def yaw(self) -> np.ndarray:
        """Yaw [T] of `directions` in radians."""
        return yaw_of(self.directions)

    @property
    def facing(self) -> np.ndarray:
        """Facing [T, 2]: `directions`, or +Z where a degenerate pose has none."""
        return facing_of(self.yaw)


def root_motion(positions: np.ndarray, roles: Roles, fps: float, smoothing_seconds: float = 20 / 60) -> Root:
    """Returns the hips' position and a smoothed facing (Holden et al. 2017, section 5; sigma of 20 frames at 60 fps).

    Across is the unit vector along (left - right shoulder) + (left - right hip), forward = across × up, smoothed in
    time by a Gaussian and normalised.

    Args:
        positions: [T, J, 3] metres, world joint positions.
        roles: hips and shoulders.
        fps: frames per second.
        smoothing_seconds: standard deviation of the Gaussian; 0 for none.
    """
    across = positions[:, roles.left_shoulder] - positions[:, roles.right_shoulder]
    across = across + positions[:, roles.left_hip] - positions[:, roles.right_hip]
    forward = _across_up(unit(across))
    if smoothing_seconds > 0:
        forward = gaussian_filter(forward, smoothing_seconds * fps)
    return Root(positions[:, roles.hips][:, [0, 2]], unit(forward))


def hips_root(positions: np.ndarray, roles: Roles) -> Root:
    """Returns position and facing of the hips alone, without smoothing (Mason et al. 2022, section 4.2).

    Forward = across × up, with across along left - right hip joint, so that the axes of the hip joint do not matter.

    Args:
        positions: [T, J, 3] metres, world joint positions.
        roles: hips.
    """
    across = positions[:, roles.left_hip] - positions[:, roles.right_hip]
    return Root(positions[:, roles.hips][:, [0, 2]], unit(_across_up(across)))


def layout_root(positions: np.ndarray, roles: Roles, layout: FrameLayout) -> Root:
    """Returns the root that a layout's rows are relative to: `hips_root` or `root_motion`.

    Args:
        positions: [T, J, 3] metres, world joint positions at the layout's frame rate.
        roles: hips and shoulders.
        layout: its `hips_heading` selects the rule.
    """
    return hips_root(positions, roles) if layout.hips_heading else root_motion(positions, roles, layout.fps)


def relative_to_root(positions: np.ndarray, root: Root) -> np.ndarray:
    """Returns positions [T, J, 3] of joints relative to the root on the ground; heights are kept.

    Args:
        positions: [T, J, 3] metres, in the world.
        root: of the T frames.
    """
    offset = positions.copy()
    offset[..., [0, 2]] -= root.positions[:, None]
    return to_local(offset, root.facing)


def trajectory_windows(root: Root, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the trajectory around every frame, relative to its root: 12 samples within one second either way.

    Beyond both ends of the clip the root is extrapolated at constant velocity (the mean over `EXTRAPOLATION_SECONDS`)
    and constant facing, so that no frame is lost.

    Args:
        root: T frames.
        fps: frames per second, a multiple of 6 so that samples fall on frames.

    Returns:
        positions [T, 12, 2] metres and directions [T, 12, 2], in each frame's root.

    Raises:
        ValueError: if fps is not a multiple of 6.
    """
    offsets = sample_offsets(fps)
    before, after = -int(offsets.min()), int(offsets.max())
    path, facing = _extrapolate(root, before, after, fps)
    index = np.arange(len(root.positions))[:, None] + before + offsets
    current = root.facing
    return to_local(path[index] - root.positions[:, None], current), to_local(facing[index], current)


def sample_offsets(fps: float) -> np.ndarray:
    """Returns the offsets [12] of the trajectory samples in frames at `fps`.

    Raises:
        ValueError: if they are not whole numbers of frames.
    """
    offsets = np.array(TRAJECTORY_OFFSETS) * fps / LAYOUT_FPS
    if np.abs(offsets - np.round(offsets)).max() > 1e-6:
        raise ValueError(f"Trajectory samples are 1/6 s apart: fps must be a multiple of 6, got {fps:g}.")
    return np.round(offsets).astype(np.int64)


def _across_up(across: np.ndarray) -> np.ndarray:
    """Returns x and z [T, 2] of across [T, 3] × (0, 1, 0); its y is zero."""
    return np.stack([-across[:, 2], across[:, 0]], axis=-1)


def _extrapolate(root: Root, before: int, after: int, fps: float) -> tuple[np.ndarray, np.ndarray]:
    positions, directions = root.positions, root.directions
    span = min(max(1, round(EXTRAPOLATION_SECONDS * fps)), len(positions) - 1)
    if span == 0:
        start = end = np.zeros(2)
    else:
        start, end = (positions[span] - positions[0]) / span, (positions[-1] - positions[-1 - span]) / span
    head = positions[0] + np.arange(-before, 0)[:, None] * start
    tail = positions[-1] + np.arange(1, after + 1)[:, None] * end
    facing = np.concatenate(
        [np.repeat(directions[:1], before, 0), directions, np.repeat(directions[-1:], after, 0)], axis=0
    )
    return np.concatenate([head, positions, tail], axis=0), facing
