"""Measures how far left and right differ in a clip, by its gait cycle and that of its mirror image."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.body_poses import body_joints, root_poses
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import CYCLE, PhaseLabels, label_phase
from pfnn_jax.motion.reflection import WORLD_REFLECTION
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

MOST_SYMMETRIC = 0.35
"""Asymmetry up to which a style counts as symmetric.

Measured: straight walks and runs of Xia (11 clips) 0.13 to 0.25, Bandai-Namco-1 (30) 0.07 to 0.22, Bandai-Namco-2 (42)
0.09 to 0.19, 100STYLE (3) 0.16 to 0.19; walks of Bandai-Namco-2 through a turn of 90° (42) 0.12 to 0.31. The walks of
Bandai-Namco-1's `old` (0.13 and 0.17) and `tired` (0.16 and 0.22) are symmetric, although 100STYLE's `Old` is not; run
and dash of `old`, with one forearm held up, have 0.47 and 0.45. Side steps (16) have 0.28 to 0.72."""

HARMONICS = 3
"""Of the gait cycle that poses are described by; higher ones hold less than a centimetre."""

COVERAGE = 12
"""Parts of the gait cycle; each must hold a frame."""

STILL = 1e-3
"""Metres (root mean square) of motion of the joints below which a clip is still and has no measure."""


def asymmetry(motion: MotionClip | WorldMotion, labels: PhaseLabels | None) -> float | None:
    """Returns how far left and right differ in a clip, as a share of what the poses vary.

    The pose relative to the root is described by a Fourier series of the phase. A symmetric gait equals its mirror
    image half a cycle later. The measure is the root mean square distance of the two, halved, over the cycle and the
    joints of the body, divided by the root mean square variation of the pose: 0 for a symmetric gait, about 1 where the
    difference is as large as the motion itself. Turns and side steps add to it.

    Args:
        motion: T frames of a skeleton with roles; a `WorldMotion` saves forward kinematics.
        labels: phase of the T frames; None for a clip without steps, of which the mean poses are compared instead.

    Returns:
        The measure, or None if the clip is still or its labels cover less than a cycle.
    """
    world = world_motion(motion)
    poses, mirrored = _body_poses(world)
    if labels is None:
        apart, variation = _mean_poses(poses, mirrored)
    elif _covers_cycle(labels):
        phase = labels.phase[labels.labelled]
        apart, variation = _cycles(poses[labels.labelled], mirrored[labels.labelled], phase)
    else:
        return None
    return None if variation < STILL else apart / variation


def find_phase(motion: MotionClip | WorldMotion, labels: PhaseLabels) -> PhaseLabels | None:
    """Returns the labels if any frame has one, otherwise those of `label_phase`, or None for a clip without steps.

    Raises:
        InputError: if the skeleton has no roles.
    """
    if labels.labelled.any():
        return labels
    try:
        return label_phase(motion)
    except NoGaitError:
        return None


def _covers_cycle(labels: PhaseLabels) -> bool:
    parts = (labels.phase[labels.labelled] * (COVERAGE / CYCLE)).astype(int) % COVERAGE
    return len(np.unique(parts)) == COVERAGE


def _body_poses(world: WorldMotion) -> tuple[np.ndarray, np.ndarray]:
    """Returns positions [T, K, 3] relative to the root of the body's joints, in the clip and in its mirror image."""
    poses, joints = root_poses(world), body_joints(world.skeleton)
    return poses[:, joints], poses[:, world.skeleton.mirror[joints]] * WORLD_REFLECTION


def _mean_poses(poses: np.ndarray, mirrored: np.ndarray) -> tuple[float, float]:
    mean = poses.mean(axis=0)
    return 0.5 * _length(mean - mirrored.mean(axis=0)), _length(poses - mean)


def _cycles(poses: np.ndarray, mirrored: np.ndarray, phase: np.ndarray) -> tuple[float, float]:
    """Returns (half the distance of clip and mirror image, variation), both in metres over the gait cycle."""
    order = np.arange(1, HARMONICS + 1)
    angle = phase[:, None] * order
    basis = np.concatenate([np.ones((len(phase), 1)), np.cos(angle), np.sin(angle)], axis=1)
    solve = np.linalg.pinv(basis)
    later = (-1.0) ** order  # half a cycle changes the sign of odd harmonics
    own = np.tensordot(solve, poses, axes=1)
    other = np.tensordot(solve, mirrored, axes=1) * np.concatenate([[1.0], later, later])[:, None, None]
    power = np.concatenate([[1.0], np.full(2 * HARMONICS, 0.5)])[:, None, None]  # mean square over a cycle
    odd, even = 0.5 * (own - other) * np.sqrt(power), 0.5 * (own + other) * np.sqrt(power)
    joints = poses.shape[1]
    apart = np.sqrt((odd**2).sum() / joints)
    return float(apart), float(np.sqrt(((odd[1:] ** 2).sum() + (even[1:] ** 2).sum()) / joints))


def _length(v: np.ndarray) -> float:
    """Returns the root mean square length of vectors [..., 3]."""
    return float(np.sqrt((v**2).sum(axis=-1).mean()))
