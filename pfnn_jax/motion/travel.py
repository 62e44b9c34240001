"""Walks on the spot: the travel that such a clip lacks, rebuilt from the foot that stands."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import gaussian_filter, moving_average, moving_minimum
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.kinematics import positions_of
from pfnn_jax.motion.skeleton import need_roles

SPOT = 0.7
"""Leg lengths within which the hips stay in a walk on the spot."""

SLIDING, SLIDING_PERCENTILE = 0.3, 35.0
"""Leg lengths per second at which standing feet slide in a walk on the spot, apart from a share of pauses in percent.
In dances and fights on the spot most standing feet are still."""

MIN_FRAMES = 10
"""Frames below which a clip is left as it is."""

FASTEST = 10.0
"""Leg lengths per second that a walk or run on the spot travels at most; feet that move faster do not carry a body."""

DRIFT = 0.25
"""Share of the rebuilt travel that the hips may cover already."""

LEVEL, PART_LEVEL = 0.03, 0.015
"""Leg lengths by which one foot, or heel or toe of it, must be lower than the other to bear most of the weight."""

LOW = 0.05
"""Leg lengths above its resting height up to which a part of a foot may stand."""

STEP_SECONDS, WALKING, RUNNING = 0.4, 0.5, 0.8
"""A foot stands while it moves backwards at least at this share of the highest speed within a step: just
before it comes down and after it lifts it is slower."""

FLYING = 0.1
"""Share of a step in which no foot is low, from which on it counts as running."""

HEADING_SECONDS = 0.5
"""Standard deviation of the average that gives the direction of travel: about a step."""

GROUND_PERCENTILE = 5.0
SMOOTHING_SECONDS = 0.05  # of the velocity; shorter than a step


def walks_on_the_spot(clip: MotionClip) -> bool:
    """Returns whether the hips stay in place while the feet that stand slide as in a walk.

    Args:
        clip: of a skeleton with roles.
    """
    leg = _leg(clip)
    ground = clip.root_positions[:, [0, 2]]
    if clip.num_frames < MIN_FRAMES or np.ptp(ground, axis=0).max() > SPOT * leg:
        return False
    velocity, sliding = _support(clip, leg)
    if len(sliding) < MIN_FRAMES or np.percentile(sliding, SLIDING_PERCENTILE) < SLIDING * leg:
        return False
    if np.linalg.norm(velocity, axis=-1).mean() > FASTEST * leg:
        return False
    travelled = np.linalg.norm(np.cumsum(velocity / clip.fps, axis=0), axis=-1).max()
    return bool(np.linalg.norm(ground - ground[0], axis=-1).max() < DRIFT * travelled)


def rebuild_travel(clip: MotionClip) -> tuple[MotionClip, str]:
    """Returns the clip with the hips carried by the foot that stands, so that this foot does not slide, and a note.

    Args:
        clip: of a skeleton with roles.
    """
    velocity, _ = _support(clip, _leg(clip))
    travelled = np.concatenate((np.zeros((1, 2)), np.cumsum((velocity[1:] + velocity[:-1]) / 2, axis=0))) / clip.fps
    positions = clip.root_positions.copy()
    positions[:, [0, 2]] += travelled
    metres = float(np.linalg.norm(np.diff(travelled, axis=0), axis=-1).sum())
    seconds = max(1, clip.num_frames - 1) / clip.fps
    note = (
        f"walks on the spot: {metres:.1f} m of travel ({metres / seconds:.2f} m/s) are rebuilt from the standing feet"
    )
    return replace(clip, root_positions=positions), f"{note}; `--travel keep` leaves it"


def _leg(clip: MotionClip) -> float:
    """Returns the length of the clip's legs in metres."""
    return leg_length_of(clip.skeleton, need_humanoid(clip.skeleton, clip.source or "skeleton"))


def _support(clip: MotionClip, leg: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the velocity [T, 2] on the ground that keeps the standing foot still, and its speed where a foot is low.

    Of the parts of the feet that are low, the one that moves backwards fastest stands: a foot that swings may pass
    low over the ground, but forwards. What is backwards follows from the lower foot's velocity on average.
    """
    feet = gaussian_filter(_feet(clip), clip.fps / 60)  # [T, foot, (heel, toe), 3]
    velocity = -np.gradient(feet[..., [0, 2]], 1 / clip.fps, axis=0)
    height = (feet[..., 1] - np.percentile(feet[..., 1], GROUND_PERCENTILE, axis=0)) / leg
    weight = _softmin(height.mean(axis=-1), LEVEL)[..., None] * _softmin(height, PART_LEVEL)
    ahead = gaussian_filter(np.einsum("tfp,tfpc->tc", weight, velocity), HEADING_SECONDS * clip.fps)
    low = (height < LOW).reshape(clip.num_frames, -1)
    speed = np.einsum("tfpc,tc->tfp", velocity, ahead).reshape(clip.num_frames, -1)
    part = np.argmax(np.where(low, speed, -np.inf), axis=1)
    carried = velocity.reshape(clip.num_frames, -1, 2)[np.arange(clip.num_frames), part]
    backwards = np.where(low, speed, 0.0).max(axis=1) / np.maximum(np.linalg.norm(ahead, axis=-1), 1e-9)
    fastest = -moving_minimum(-backwards, 2 * round(STEP_SECONDS * clip.fps / 2) + 1)
    standing = low.any(axis=1)
    flying = moving_average((~standing).astype(float), 2 * round(STEP_SECONDS * clip.fps / 2) + 1) > FLYING
    standing &= backwards >= np.where(flying, RUNNING, WALKING) * fastest
    sliding = np.linalg.norm(carried, axis=-1)[low.any(axis=1)]
    if standing.any():  # otherwise, as in flight, between the velocities before and after
        frames = np.arange(clip.num_frames)
        carried = np.stack([np.interp(frames, frames[standing], part[standing]) for part in carried.T], axis=-1)
    return gaussian_filter(carried, SMOOTHING_SECONDS * clip.fps), sliding


def _softmin(values: np.ndarray, scale: float) -> np.ndarray:
    """Returns weights along the last axis that sum to one, the largest for the least value."""
    weights = np.exp(-(values - values.min(axis=-1, keepdims=True)) / scale)
    return weights / weights.sum(axis=-1, keepdims=True)


def _feet(clip: MotionClip) -> np.ndarray:
    """Returns the positions [T, 2, 2, 3] of heels and toes, left before right, without posing other limbs."""
    roles = need_roles(clip.skeleton)
    feet = [*roles.left_foot, *roles.right_foot]
    return positions_of(feet, clip.skeleton, clip.root_positions, clip.rotations).reshape(clip.num_frames, 2, 2, 3)
