"""Clips that are one cycle of a motion, as game characters carry them, repeated so that they can be learned from.

A second of walking has too few steps to label a phase, and no frames a second before and after the others.
"""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.cycles import repeat_cycle
from pfnn_jax.motion.kinematics import quat_from_yaw, quat_multiply
from pfnn_jax.motion.root_motion import cycle_yaw

LOOP_SECONDS = 6.0
"""Longest clip that is taken for one cycle."""

REPEATED_SECONDS = 10.0
"""Seconds that a cycle is repeated for, at least."""

MIN_FRAMES = 6
"""Fewest frames of a cycle."""

MAX_SEAM, CLOSED = 1.8, 0.35
"""How far the first pose may be from the last one, in usual steps from frame to frame: it follows on it, or is it."""

SWAY = 0.05
"""Metres by which the hips of a cycle on the spot may end apart from where they began."""


def repeat_loop(clip: MotionClip) -> tuple[MotionClip, str]:
    """Returns a clip that is one cycle repeated for `REPEATED_SECONDS`, and a note; others unchanged, with no note.

    The motion is a cycle if its first pose follows on its last one. Each repetition goes on from where the one before
    ended, and in its direction.
    """
    length = clip.num_frames / clip.fps
    if clip.num_frames < MIN_FRAMES or length > LOOP_SECONDS:
        return clip, ""
    apart, usual = _steps(clip)
    if usual < 1e-6 or apart > MAX_SEAM * usual:
        return clip, ""
    frames = clip.num_frames - 1 if apart < CLOSED * usual else clip.num_frames
    times = int(np.ceil(REPEATED_SECONDS * clip.fps / frames))
    yaw, step = _travel(clip, frames)
    note = f"a loop of {frames / clip.fps:.2f} s: repeated {times} times"
    return repeat_cycle(cut(clip, 0, frames), yaw, step, times), note


def _steps(clip: MotionClip) -> tuple[float, float]:
    """Returns how far the first pose is from the last one, and the usual step from frame to frame, in radians."""
    local = clip.rotations.copy()
    yaws = 2.0 * np.arctan2(local[:, 0, 2], local[:, 0, 0])
    local[:, 0] = quat_multiply(quat_from_yaw(-yaws), local[:, 0])
    after = np.roll(local, -1, axis=0)
    angles = np.arccos(np.clip(np.abs(np.sum(local * after, axis=-1)), 0.0, 1.0)).sum(axis=1)
    return float(angles[-1]), float(np.median(angles[:-1]))


def _travel(clip: MotionClip, frames: int) -> tuple[float, np.ndarray]:
    """Returns the turn in radians and the step [3] of one cycle on the ground, in the direction of its beginning.

    Args:
        clip: one cycle, with or without its first pose at the end.
        frames: of the cycle.
    """
    share, yaw = frames / (clip.num_frames - 1), cycle_yaw(clip)
    step = (clip.root_positions[-1] - clip.root_positions[0]) * share
    step[1] = 0.0
    if np.linalg.norm(step) < SWAY * share:
        return 0.0 if abs(yaw) < 0.2 else yaw * share, np.zeros(3)
    return (0.0 if abs(yaw) < 0.05 else yaw * share), step
