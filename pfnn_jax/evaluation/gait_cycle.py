"""The mean gait cycle of a motion, and the distance between two of them: how alike two walks are, in metres.

Two walks are never in step, nor in the same place. What the body does on average over a gait cycle can be compared
joint by joint, on one skeleton, whatever their timing.
"""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.body_poses import root_poses
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import CYCLE, PhaseLabels, runs_of
from pfnn_jax.motion.world_motion import WorldMotion

NUM_PHASES = 32
"""Phases at which a cycle is sampled."""

LARGEST_SHIFT = 4
"""Samples by which two cycles may be shifted against each other: labels of contacts differ by up to an eighth of a
cycle between the feet of a real and of a generated walk, which would be counted as a difference of all joints."""


def mean_cycle(world: WorldMotion, labels: PhaseLabels) -> np.ndarray:
    """Returns the mean pose at `NUM_PHASES` evenly spaced phases, over all cycles of a motion.

    Args:
        world: T frames of J joints.
        labels: phase of the T frames; frames without a label are left out.

    Returns:
        [P, J, 3] metres, relative to the root on the ground.

    Raises:
        NoGaitError: if the labels cover less than a whole cycle.
    """
    return mean_cycle_of_poses(root_poses(world), labels.phase, labels.labelled, world.clip.source or "clip")


def mean_cycle_of_poses(poses: np.ndarray, phase: np.ndarray, labelled: np.ndarray, source: str) -> np.ndarray:
    """Returns the `mean_cycle` [P, J, 3] of poses [T, J, 3] relative to their roots.

    Args:
        poses: metres.
        phase: [T] radians.
        labelled: [T] bool, which frames have a phase.
        source: of the poses, for messages.

    Raises:
        NoGaitError: if the labels cover less than a whole cycle.
    """
    step = CYCLE / NUM_PHASES
    sums, counts = np.zeros((NUM_PHASES, *poses.shape[1:])), np.zeros(NUM_PHASES, int)
    for start, stop in runs_of(labelled):
        unwrapped = np.unwrap(phase[start:stop])
        wanted = np.arange(np.ceil(unwrapped[0] / step), np.floor(unwrapped[-1] / step) + 1)
        frames = np.interp(wanted * step, unwrapped, np.arange(start, stop))
        places = wanted.astype(int) % NUM_PHASES
        np.add.at(sums, places, poses_at(poses, frames))
        np.add.at(counts, places, 1)
    if not counts.all():
        found = f"{np.count_nonzero(counts)} of {NUM_PHASES} phases"
        raise NoGaitError(source, "phase", found, "must cover a whole gait cycle")
    return sums / counts[:, None, None]


def cycle_distance(cycle: np.ndarray, other: np.ndarray, largest_shift: int = LARGEST_SHIFT) -> np.ndarray:
    """Returns the mean distance [J] in metres of each joint between two cycles [P, J, 3] of one skeleton.

    The other is shifted in phase by at most `largest_shift` samples, to where the mean over all joints is least.
    """
    shifts = range(-largest_shift, largest_shift + 1)
    found = [np.linalg.norm(cycle - np.roll(other, shift, axis=0), axis=-1).mean(axis=0) for shift in shifts]
    return min(found, key=np.mean)


def poses_at(poses: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Returns poses [N, J, 3] at fractional frames [N], interpolated linearly."""
    before = np.clip(frames.astype(int), 0, len(poses) - 1)
    after = np.minimum(before + 1, len(poses) - 1)
    share = (frames - before)[:, None, None]
    return (1 - share) * poses[before] + share * poses[after]
