"""Puts cycles onto another skeleton such that they stay closed."""

from __future__ import annotations

from dataclasses import replace

from pfnn_jax.motion.clip import MotionClip, cut, move_clip
from pfnn_jax.motion.cycles import repeat_cycle
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_yaw, quat_multiply, quat_rotate
from pfnn_jax.motion.retargeting.retarget import Retargeted, retarget
from pfnn_jax.motion.root_motion import cycle_yaw, is_cycle
from pfnn_jax.motion.skeleton import Skeleton


def retarget_closed(clip: MotionClip, target: Skeleton) -> Retargeted:
    """Returns the clip on another skeleton as `retarget`, and a cycle as a cycle: its last pose remains its first.

    What stands on the ground depends on frames before and after, so a cycle is retargeted between two others.
    """
    if not is_cycle(clip):
        return retarget(clip, target)
    result = retarget(_three_times(clip), target)
    steps = clip.num_frames - 1
    middle = cut(result.clip, steps, 2 * steps + 1)
    yaw = cycle_yaw(clip)
    rotations, positions = middle.rotations.copy(), middle.root_positions.copy()
    rotations[-1] = rotations[0]
    rotations[-1, 0] = quat_multiply(quat_from_yaw(yaw), rotations[0, 0])
    positions[-1, 1] = positions[0, 1]
    return replace(result, clip=replace(middle, root_positions=positions, rotations=rotations))


def _three_times(clip: MotionClip) -> MotionClip:
    """Returns a cycle of N + 1 frames three times, 3 N frames: the one before, itself, and the one after."""
    yaw = cycle_yaw(clip)
    turn, step = quat_from_yaw(yaw), clip.root_positions[-1] - clip.root_positions[0]
    back = quat_conjugate(turn)
    first = clip.root_positions[0]
    before = move_clip(clip, back, first - quat_rotate(back, first + step))
    return repeat_cycle(cut(before, 0, clip.num_frames - 1), yaw, quat_rotate(back, step), 3)
