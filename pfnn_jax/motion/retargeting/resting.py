"""Measures how high ankles and toes lie above the ground while a foot stands flat.

Producers place joints in the foot and the ground differently: an ankle rests 3 to 12 cm above y = 0. Retargeting puts
feet that stand onto the target's own resting heights where they are known (`Skeleton.resting_heights`).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.retargeting.body import SIDES, humanoid_of, limb
from pfnn_jax.motion.retargeting.feet import FlatFoot, flat_foot
from pfnn_jax.motion.retargeting.reference import reference_pose, stands
from pfnn_jax.motion.skeleton import Skeleton

SHORTEST = 1.0
"""Seconds of motion that show where the ground is: both feet of a person who walks stand within that time."""

STANDING_SHARE = 0.25
"""Share of all frames in which a foot stands flat at the most: those in which ankle and toe are lowest."""

MOST_FRAMES = 240
"""Frames, evenly spread, that are looked at."""

MISPLACED = np.radians(12.0)
"""Pitch up to which a standing foot differs from that of the rest pose because its joints lie elsewhere in the foot (in
the PFNN files by 12°). Beyond it the difference belongs to the style, as on tiptoe: it counts less from there on, and
not at all from twice as much on."""

SAME_FLOOR = 0.05
"""Leg lengths by which resting heights of two clips of one producer may differ (of Xia's six by 2.9 cm)."""

UNEVEN = 0.03
"""Leg lengths by which left and right may rest at different heights; a foot that rests higher does not stand flat."""


def find_resting_heights(clip: MotionClip) -> np.ndarray | None:
    """Returns the resting heights [2, 2] of a clip's feet in metres, as `Skeleton.resting_heights` has them.

    Args:
        clip: T frames on a skeleton with a humanoid map.

    Returns:
        None for a clip of less than `SHORTEST` seconds, which may show no foot that stands.

    Raises:
        InputError: if the skeleton has no humanoid map or no ankles.
    """
    if clip.num_frames < SHORTEST * clip.fps:
        return None
    body = humanoid_of(clip.skeleton, clip.source or "clip")
    every = slice(None, None, -(-clip.num_frames // MOST_FRAMES))
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions[every], clip.rotations[every])
    return measure_resting_heights(positions, clip.skeleton, body, reference_pose(clip.skeleton, body))


def with_resting_heights(clip: MotionClip) -> MotionClip:
    """Returns the clip with the resting heights of its feet in its skeleton, if it shows them."""
    heights = None
    with suppress(InputError):
        heights = find_resting_heights(clip)
    return clip if heights is None else replace(clip, skeleton=replace(clip.skeleton, resting_heights=heights))


def same_floor(skeleton: Skeleton, other: Skeleton, scale: float = 1.0) -> bool:
    """Returns whether feet rest alike on two skeletons, the other `scale` times as large, or whether one is unknown."""
    if skeleton.resting_heights is None or other.resting_heights is None:
        return True
    apart = np.abs(scale * skeleton.resting_heights - other.resting_heights).max()
    return bool(apart <= SAME_FLOOR * leg_length_of(other, humanoid_of(other)))


def measure_resting_heights(
    positions: np.ndarray, skeleton: Skeleton, body: HumanoidMap, reference: np.ndarray
) -> np.ndarray:
    """Returns the resting heights [2, 2] in metres of the feet in a motion; see `Skeleton.resting_heights`.

    They are medians over the frames in which ankle and toe are lowest. Where the rest pose shows a flat foot, a foot
    that stands much steeper or flatter than that, as on tiptoe, is taken to rest as there; see `MISPLACED`.

    Args:
        positions: [T, J, 3] metres.
        skeleton: of the J joints.
        body: its humanoid map.
        reference: [J, 4], its reference pose.
    """
    known = stands(skeleton, body)
    heights = []
    for side in SIDES:
        foot, toe = limb(body, side, "foot", "toe")
        pair = positions[:, [foot, foot if toe is None else toe], 1]
        lowest = np.argsort(pair.sum(axis=1), kind="stable")[: max(1, int(STANDING_SHARE * len(pair)))]
        measured = np.median(pair[lowest], axis=0)
        flat = flat_foot(skeleton, body, reference, side)
        heights.append(_without_style(measured, flat) if known and flat.toe is not None else measured)
    rest = np.array(heights)
    limit = rest[:, 1].min() + UNEVEN * leg_length_of(skeleton, body)
    return rest - np.maximum(rest[:, 1:] - limit, 0.0)


def _without_style(measured: np.ndarray, flat: FlatFoot) -> np.ndarray:
    """Returns the heights [2] of ankle and toe without a pitch that belongs to the style."""
    assert flat.toe is not None
    length = float(np.linalg.norm(flat.toe))
    rest, found = np.arcsin(np.clip([-flat.toe[1] / length, (measured[0] - measured[1]) / length], -1.0, 1.0))
    differs = found - rest
    pitch = rest + np.sign(differs) * np.clip(2 * MISPLACED - abs(differs), 0.0, abs(differs))
    drop = length * np.sin(pitch)
    toe = min(measured[1], measured[0] - drop)  # on tiptoe the toe stands, on the heel the ankle
    return np.array([toe + drop, toe])
