"""A clip as a scene to look at: its body, the ground below it, its size, and where a camera should stand and look."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.draw.body import Capsule, body_capsules, body_points, capsule_ends, headings

PERSON = 1.7  # metres
WIDE = 0.55  # share of its width that a person with arms held out counts as its height
SWAY = 4.0  # how many times as tall as it strays from the camera's aim a scene counts at least, as a bouncing ball's
DOT = 0.07  # of a person: radius of a joint without bones
GROUND_PERCENTILE = 5.0  # of the lowest point over time: feet stand for longer than this
NEAR_GROUND = 0.12  # of a person: files whose feet are this near to 0 mean 0
FOLLOW = 1.0  # seconds over which the camera's target is averaged, so that it does not sway with every step
STRAIGHT = 0.7  # mean resultant length of the headings above which a clip has one heading


@dataclass(frozen=True, eq=False)
class Scene:
    """What pictures and players draw of a clip.

    Attributes:
        points: [T, P, 3] metres above the ground, Y up; point 0 is the root.
        capsules: limbs between points.
        fps: frames per second.
        tall: 1 for a person; distances of cameras scale with it.
        headings: [T] radians, where the body faces.
        heading: radians, where the clip as a whole faces: on average, or at its start where it turns about.
        focus: [T, 3] metres, what a following camera looks at.
    """

    points: np.ndarray
    capsules: list[Capsule]
    fps: float
    tall: float
    headings: np.ndarray
    heading: float
    focus: np.ndarray


def make_scene(clip: MotionClip) -> Scene:
    """The scene of a clip.

    The ground lies at height 0, unless the body's lowest points are far from there, as in files that keep the hips in
    place: then it lies below them.
    """
    points, capsules = body_points(clip), body_capsules(clip.skeleton)
    ends = np.stack([np.stack(capsule_ends(points, c), axis=1) for c in capsules], axis=1)  # [T, C, 2, 3]
    radii = np.array([(c.start_radius, c.end_radius) for c in capsules])
    low, high = (ends[..., 1] - radii).min(axis=(1, 2)), (ends[..., 1] + radii).max(axis=(1, 2))
    width = np.ptp(ends[..., [0, 2]].reshape(len(points), -1, 2), axis=1).max(axis=-1)
    known = clip.skeleton.roles is not None
    tall = max(float(np.median(high - low)), (WIDE if known else 1.0) * float(np.median(width)))
    floor = float(np.percentile(low, GROUND_PERCENTILE))
    floor = 0.0 if abs(floor) < NEAR_GROUND * tall / PERSON else floor
    across = points[:, 0] if known else (ends.min(axis=(1, 2)) + ends.max(axis=(1, 2))) / 2
    middle = np.stack([across[:, 0], (low + high) / 2 - floor, across[:, 2]], axis=-1)
    focus = _follow(middle, clip.fps)
    tall = max(tall, SWAY * float(np.abs(middle - focus).max())) / PERSON
    capsules = [replace(c, start_radius=DOT * tall, end_radius=DOT * tall) if c.start == c.end else c for c in capsules]
    facing = headings(clip, points)
    return Scene(
        points=points - [0.0, floor, 0.0],
        capsules=capsules,
        fps=clip.fps,
        tall=tall,
        headings=facing,
        heading=_overall(facing, clip.fps),
        focus=focus,
    )


def _overall(facing: np.ndarray, fps: float) -> float:
    whole = np.mean(np.exp(1j * facing))
    start = np.mean(np.exp(1j * facing[: max(1, round(fps / 2))]))
    return float(np.angle(whole if abs(whole) > STRAIGHT else start))


def _follow(points: np.ndarray, fps: float) -> np.ndarray:
    """Running average of points [T, 3]; beyond the ends they go on as they come in, so that nothing lags there."""
    half = max(1, round(FOLLOW * fps / 2))
    before = 2 * points[:1] - points[1 : half + 1][::-1]
    after = 2 * points[-1:] - points[-half - 1 : -1][::-1]
    extended = np.concatenate([before, points, after])
    return uniform_filter1d(extended, 2 * half + 1, axis=0, mode="nearest")[len(before) : len(before) + len(points)]
