"""Cuts one cycle out of a motion that repeats itself, such that it plays in a loop without a jump; repeats cycles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, cut, move_clip
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.kinematics import (
    quat_conjugate,
    quat_exp,
    quat_from_yaw,
    quat_log,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.trajectory import relative_to_root, root_motion
from pfnn_jax.motion.world_motion import world_motion

GAIT_SECONDS = (0.5, 2.5)
"""Shortest and longest cycle of a gait: two steps, from a sprint to a shuffle."""

VELOCITY_SECONDS = 0.1
"""Seconds by which velocities are multiplied to be compared with positions: poses that match must also move alike."""

MOST_DIFFERENCE = 0.12
"""Of a leg's length: root mean square over the joints by which both ends of a cycle may differ."""

AS_GOOD = 2.0
"""A shorter cycle is taken if its ends differ by at most so many times as much as those of the best."""

LEAST_DIFFERENCE = 0.02
"""Of a leg's length: ends that differ by less are equally good."""

LIVELY = 0.7
"""A cycle moves at least this share of what the liveliest cycle of the clip moves: not the standing before a walk."""

STILL = 0.05
"""Metres per second of the joints relative to the root below which a whole clip stands."""

MAX_TURN = 0.95 * np.pi
"""Largest turn of a cycle in radians: its ends show a turn up to whole ones, so that half a turn has no side."""

STRAIGHT = np.deg2rad(5.0)
"""Turn in one cycle below which a walk counts as straight; a loop of it would turn in a wide circle otherwise."""


def cut_cycle(clip: MotionClip, *, seconds: tuple[float, float] = GAIT_SECONDS) -> MotionClip:
    """Returns one cycle of a clip, closed: its last frame is its first, moved and turned along the ground.

    The cycle is the shortest whose two ends have nearly the same pose and velocities. What they still differ by is
    spread evenly over its frames. A turn of less than `STRAIGHT` is spread too. It turns by less than half a circle.

    Args:
        clip: T frames of a gait, or of standing.
        seconds: shortest and longest cycle.

    Returns:
        N + 1 frames of a cycle of N.

    Raises:
        InputError: for a skeleton without roles, a clip too short for a cycle, or one whose pose does not come back.
    """
    motion, source = world_motion(clip), clip.source or "clip"
    root = root_motion(motion.positions, need_roles(clip.skeleton, source), clip.fps, smoothing_seconds=0.0)
    leg = leg_length_of(clip.skeleton, need_humanoid(clip.skeleton, source))
    yaws = np.unwrap(root.yaw)
    start, length = _find_ends(clip, relative_to_root(motion.positions, root), yaws, leg, seconds)
    yaw = float(wrap_angle(yaws[start + length] - yaws[start]))
    return _close(cut(clip, start, start + length + 1), yaw if abs(yaw) >= STRAIGHT else 0.0)


def repeat_cycle(clip: MotionClip, yaw: float, step: np.ndarray, times: int) -> MotionClip:
    """Returns a cycle of N frames, without its first pose again at its end, several times: N * times frames.

    Args:
        clip: the cycle.
        yaw: radians about +Y by which each repetition is turned from the one before, about the hips of its first frame.
        step: [3] metres by which the hips of the second repetition begin from those of the first.
        times: how often.
    """
    parts, first, moved = [], clip.root_positions[0], np.zeros(3)
    for number in range(times):
        turn = quat_from_yaw(number * yaw)
        parts.append(move_clip(clip, turn, first + moved - quat_rotate(turn, first)))
        moved = moved + quat_rotate(turn, step)
    positions = np.concatenate([part.root_positions for part in parts])
    return replace(clip, root_positions=positions, rotations=np.concatenate([part.rotations for part in parts]))


def _find_ends(
    clip: MotionClip, local: np.ndarray, yaws: np.ndarray, leg: float, seconds: tuple[float, float]
) -> tuple[int, int]:
    """Returns first frame and number of frames of the cycle.

    Args:
        clip: T frames.
        local: [T, J, 3] joint positions relative to the root.
        yaws: [T] radians of the root, continuous.
        leg: metres.
        seconds: shortest and longest cycle.
    """
    shortest = max(2, round(seconds[0] * clip.fps))
    longest = min(round(seconds[1] * clip.fps), len(local) - 2)
    if longest < shortest:
        found = f"{clip.num_frames / clip.fps:.2g} s"
        rule = f"must be at least {(shortest + 2) / clip.fps:.2f} s, and longer than one cycle"
        raise InputError(clip.source or "clip", "cycle", found, rule)
    velocity = np.gradient(local, 1 / clip.fps, axis=0)
    features = np.concatenate([local, VELOCITY_SECONDS * velocity], axis=-1)
    speed = np.linalg.norm(velocity, axis=-1).mean(axis=-1)
    lengths = np.arange(shortest, longest + 1)
    best = [_best_start(features, speed, yaws, int(length)) for length in lengths]
    starts, differences = np.array([b[0] for b in best]), np.array([b[1] for b in best]) / leg
    chosen = _shortest_good(differences)
    if not np.isfinite(differences[chosen]):
        found = f"turns by more than {np.degrees(MAX_TURN):.0f} degrees in {seconds[0]:g} s"
        raise InputError(clip.source or "clip", "cycle", found, "must turn by less than half a circle")
    if differences[chosen] > MOST_DIFFERENCE:
        found = f"no pose comes back to nearer than {100 * leg * differences[chosen]:.0f} cm"
        rule = f"must repeat itself within {seconds[0]:g} to {seconds[1]:g} s"
        raise InputError(clip.source or "clip", "cycle", found, rule)
    return int(starts[chosen]), int(lengths[chosen])


def _best_start(features: np.ndarray, speed: np.ndarray, yaws: np.ndarray, length: int) -> tuple[int, float]:
    """Returns the start of the best cycle of a length, and the root mean square by which its ends differ.

    That is infinite if all cycles of this length turn by more than `MAX_TURN`.

    Args:
        features: [T, J, 6] metres.
        speed: [T] m/s, mean over the joints.
        yaws: [T] radians of the root, continuous.
        length: frames.
    """
    differences = np.sqrt(np.square(features[length:] - features[:-length]).sum(axis=-1).mean(axis=-1))
    mean = np.convolve(speed, np.full(length, 1 / length), "valid")[: len(differences)]
    if mean.max() > STILL:
        differences = np.where(mean >= LIVELY * mean.max(), differences, np.inf)
    differences = np.where(np.abs(yaws[length:] - yaws[:-length]) <= MAX_TURN, differences, np.inf)
    start = int(np.argmin(differences))
    return start, float(differences[start])


def _shortest_good(differences: np.ndarray) -> int:
    """Returns the index of the shortest cycle that is about as good as the best: not two cycles for one.

    Args:
        differences: [N] of cycles of increasing length.
    """
    padded = np.concatenate([[np.inf], differences, [np.inf]])
    lowest = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])
    limit = max(AS_GOOD * float(differences.min()), LEAST_DIFFERENCE)
    return int(np.flatnonzero(lowest & (differences <= limit))[0])


def _close(clip: MotionClip, yaw: float) -> MotionClip:
    """Returns the clip with its last pose made equal to its first, turned by `yaw` radians, by an even correction."""
    last = clip.rotations[0].copy()
    last[0] = quat_multiply(quat_from_yaw(yaw), last[0])
    missing = quat_multiply(last, quat_conjugate(clip.rotations[-1]))
    share = np.linspace(0.0, 1.0, clip.num_frames)
    rotations = quat_multiply(quat_exp(share[:, None, None] * quat_log(missing)), clip.rotations)
    rotations[-1] = last
    positions = clip.root_positions.copy()
    positions[:, 1] += share * (positions[0, 1] - positions[-1, 1])
    return replace(clip, root_positions=positions, rotations=rotations)
