"""Measures how high ankles and toes lie above the ground while a foot stands flat.

Producers place joints in the foot and the ground differently: an ankle rests 3 to 12 cm above y = 0. Retargeting puts
feet that stand onto the target's own resting heights where they are known (`Skeleton.resting_heights`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import median
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import positions_of
from pfnn_jax.motion.retargeting.body import SIDES, humanoid_of, limb
from pfnn_jax.motion.retargeting.reference import standing_pitches
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

SHORTEST = 0.75
"""Seconds of motion that show where the ground is: within that time each foot of a person who runs stands once."""

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


def find_resting_heights(clip: MotionClip, body: HumanoidMap) -> np.ndarray | None:
    """Returns the resting heights [2, 2] of a clip's feet in metres, as `Skeleton.resting_heights` has them.

    They are medians over the frames in which ankle and toe are lowest. Where the rest pose shows a flat foot, a foot
    that stands much steeper or flatter than that, as on tiptoe, is taken to rest as there; see `MISPLACED`.

    Args:
        clip: T frames.
        body: humanoid map of its skeleton.

    Returns:
        None for a clip of less than `SHORTEST` seconds, which may show no foot that stands.
    """
    if clip.num_frames < SHORTEST * clip.fps:
        return None
    skeleton = clip.skeleton
    feet = [limb(body, side, "foot", "toe") for side in SIDES]
    joints = [foot if joint is None else joint for foot, toe in feet for joint in (foot, toe)]
    every = slice(None, None, -(-clip.num_frames // MOST_FRAMES))
    positions = positions_of(joints, skeleton, clip.root_positions[every], clip.rotations[every])
    pitches, rest = standing_pitches(skeleton, body), rest_pose(skeleton)
    found = np.empty((2, 2))
    for number, (ankle, toe) in enumerate(zip(joints[::2], joints[1::2], strict=True)):
        found[number] = _lowest(positions[:, 2 * number : 2 * number + 2, 1])
        if pitches is not None and toe != ankle:
            length = float(np.linalg.norm(rest[toe] - rest[ankle]))
            found[number] = _without_style(found[number], length, pitches[number])
    limit = found[:, 1:].min() + UNEVEN * leg_length_of(skeleton, body)
    return found - np.maximum(found[:, 1:] - limit, 0.0)


def with_resting_heights(clip: MotionClip) -> MotionClip:
    """Returns the clip with the resting heights of its feet in its skeleton, if it shows them."""
    try:
        heights = find_resting_heights(clip, humanoid_of(clip.skeleton))
    except InputError:  # it has no feet, or no map
        return clip
    return clip if heights is None else replace(clip, skeleton=replace(clip.skeleton, resting_heights=heights))


def same_floor(skeleton: Skeleton, other: Skeleton, scale: float = 1.0) -> bool:
    """Returns whether feet rest alike on two skeletons, the other `scale` times as large, or whether one is unknown."""
    if skeleton.resting_heights is None or other.resting_heights is None:
        return True
    apart = np.abs(scale * skeleton.resting_heights - other.resting_heights).max()
    return bool(apart <= SAME_FLOOR * leg_length_of(other, need_humanoid(other)))


def _lowest(heights: np.ndarray) -> np.ndarray:
    """Returns the median heights [2] of ankle and toe [T, 2] over the frames in which both are lowest."""
    lowest = np.argsort(heights.sum(axis=1), kind="stable")[: max(1, int(STANDING_SHARE * len(heights)))]
    return median(heights[lowest])


def _without_style(heights: np.ndarray, length: float, rest: float) -> np.ndarray:
    """Returns the heights [2] of ankle and toe without a pitch that belongs to the style.

    Args:
        heights: [2] metres.
        length: metres from ankle to toe.
        rest: pitch in radians of the line from ankle to toe in the rest pose.
    """
    pitch = float(np.arcsin(np.clip((heights[0] - heights[1]) / max(length, 1e-9), -1.0, 1.0)))
    apart = abs(pitch - rest)
    pitch = rest + np.sign(pitch - rest) * min(apart, max(2 * MISPLACED - apart, 0.0))
    drop = length * np.sin(pitch)
    toe = min(heights[1], heights[0] - drop)  # on tiptoe the toe stands, on the heel the ankle
    return np.array([toe + drop, toe])
