"""Jumps in a clip: a pose or a place that no body reaches within one frame, such as a T-pose before the motion."""

from __future__ import annotations

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.skeleton import Roles, need_roles

FASTEST, FAST = 15.0, 9.0
"""Metres per second that no person reaches, as sprinters reach 12.4, and that only sprinters do."""

SUSPECT_SPEED, SUSPECT_ANGLE = 8.0, np.pi / 6
"""Metres per second of the hips, and radians per frame of any joint, above which two frames are compared."""

POSE_STEP, POSE_SPEED = 0.08, 3.0
"""Metres per frame and metres per second that the body's joints move on average, relative to the hips, in a jump."""

CONTRAST = 5.0
"""How many times faster than the frames before and after it a jump is: fast motion accelerates over several frames."""

STILL_CONTRAST, STILL = 3.0, 1e-3
"""The same next to a pose that is held, with its steps in metres, or at an end of the clip."""

MOVING = 0.02
"""Metres per second from which a joint moves: held poses may tremble a little."""

MIN_FRAMES = 10
"""Frames of the shortest clip that is examined, and of the shortest part that is kept."""


def longest_part(clip: MotionClip) -> tuple[int, int, str]:
    """Returns the first frame and the end of the longest part of a clip without a jump, and a note if it is a part.

    Frames in which the body moves count before others: a T-pose may be held for longer than the motion.

    Args:
        clip: of a skeleton with roles.

    Raises:
        InputError: if hardly anything is left.
    """
    whole = 0, clip.num_frames, ""
    if clip.num_frames < MIN_FRAMES:
        return whole
    speeds = _hips_speed(clip)
    _refuse_faster(clip, float(np.partition(speeds, len(speeds) // 2)[len(speeds) // 2]))
    jumps = _jumps(clip, speeds)
    if not len(jumps):
        return whole
    edges = np.concatenate(([0], jumps + 1, [clip.num_frames]))
    moving = np.concatenate(([0], np.cumsum(_moves(clip))))
    part = int(np.lexsort((-np.diff(edges), -np.diff(moving[edges])))[0])
    start, stop = int(edges[part]), int(edges[part + 1])
    if stop - start < MIN_FRAMES:
        rule = f"at least {MIN_FRAMES} successive frames must be without a jump: check `--unit` and `--source-fps`"
        raise InputError(clip.source or "clip", "frames", f"{len(jumps)} jumps in {clip.num_frames} frames", rule)
    first = 0 if clip.reading is None else clip.reading.first_frame  # the note counts the file's frames
    where = ", ".join(str(first + jump + 1) for jump in jumps[:3]) + (", ..." if len(jumps) > 3 else "")
    return start, stop, f"the body jumps at frame {where}: only frames {first + start} to {first + stop - 1} are used"


def check_speed(clip: MotionClip) -> str:
    """Checks that the body moves no faster than a person can, on average over half a second.

    Returns:
        A note if it moves as only sprinters do; else an empty text.

    Raises:
        InputError: if it does.
    """
    if clip.num_frames < MIN_FRAMES:
        return ""
    speeds = _hips_speed(clip)
    width = min(len(speeds), max(1, round(clip.fps / 2)))
    total = np.concatenate(([0.0], np.cumsum(speeds)))
    speed = float((total[width:] - total[:-width]).max()) / width
    _refuse_faster(clip, speed)
    rate = f"{clip.fps:.4g} frames per second"
    note = f"the body moves at {speed:.1f} m/s at {rate}: pass `--source-fps` or `--unit` if that is wrong"
    return note if speed > FAST else ""


def _refuse_faster(clip: MotionClip, speed: float) -> None:
    if speed > FASTEST:
        rule = f"no person moves faster than {FASTEST:g} m/s: check `--unit` and `--source-fps`"
        raise InputError(clip.source or "clip", "speed", f"{speed:.3g} m/s at {clip.fps:.4g} frames per second", rule)


def _hips_speed(clip: MotionClip) -> np.ndarray:
    """Returns the speed [T - 1] of joint 0 in metres per second."""
    step = np.diff(clip.root_positions, axis=0)
    return np.sqrt(np.einsum("tc,tc->t", step, step)) * clip.fps


def _jumps(clip: MotionClip, speeds: np.ndarray) -> np.ndarray:
    """Returns the frames that a jump follows."""
    cosine = np.abs(np.einsum("tjc,tjc->tj", clip.rotations[1:], clip.rotations[:-1])).min(axis=1)
    suspects = np.flatnonzero((speeds > SUSPECT_SPEED) | (cosine < np.cos(SUSPECT_ANGLE / 2)))
    if not len(suspects):
        return suspects
    frames = np.clip(suspects[:, None] + np.arange(-2, 4), 0, clip.num_frames - 1)
    body = _body_positions(clip, frames.ravel()).reshape(len(suspects), 6, -1, 3)
    moved = np.linalg.norm(np.diff(body[:, :, 0], axis=1), axis=-1)  # [N, 5] of the hips
    posed = np.linalg.norm(np.diff(body - body[:, :, :1], axis=1), axis=-1).mean(axis=-1)
    place = (moved[:, 2] * clip.fps > SUSPECT_SPEED) & _stands_out(moved)
    pose = (posed[:, 2] > max(POSE_STEP, POSE_SPEED / clip.fps)) & _stands_out(posed)
    return suspects[place | pose | (moved[:, 2] * clip.fps > FASTEST)]


def _stands_out(steps: np.ndarray) -> np.ndarray:
    """Returns whether the middle of five successive steps [N, 5] is far larger than those around it.

    Next to a pose that is held, two steps of like size may stand out together: a file that was resampled has a frame
    halfway between a T-pose and the motion.
    """
    before, after = steps[:, 1], steps[:, 3]
    fast, slow = np.maximum(before, after), np.minimum(before, after)
    alone = steps[:, 2] > np.where(slow < STILL, STILL_CONTRAST, CONTRAST) * fast
    double = np.zeros(len(steps), bool)
    for partner, outer, held in ((steps[:, 3], steps[:, 4], before), (steps[:, 1], steps[:, 0], after)):
        least = np.minimum(steps[:, 2], partner)
        for one, other in ((held, outer), (outer, held)):
            double |= (one < STILL) & (least > STILL_CONTRAST * other)
    return alone | double


def _moves(clip: MotionClip) -> np.ndarray:
    """Returns [T] whether a joint of the body moves to the next frame; the last frame as that before."""
    body = _body_positions(clip, np.arange(clip.num_frames))
    steps = np.linalg.norm(np.diff(body, axis=0), axis=-1).max(axis=1) * clip.fps > MOVING
    return np.append(steps, steps[-1])


def _body_positions(clip: MotionClip, frames: np.ndarray) -> np.ndarray:
    """Returns the positions [N, B, 3] of the joints with roles in some frames [N]; hips first."""
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions[frames], clip.rotations[frames])
    return positions[:, _body(need_roles(clip.skeleton))]


def _body(roles: Roles) -> list[int]:
    """Returns the joints with roles; hips first."""
    feet = [*roles.left_foot, *roles.right_foot]
    arms = [roles.left_shoulder, roles.right_shoulder, roles.left_hand, roles.right_hand]
    return [roles.hips, roles.left_hip, roles.right_hip, *feet, *arms, roles.head]
