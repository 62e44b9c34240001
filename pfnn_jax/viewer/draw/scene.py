"""A clip as a scene: the body above its ground, its size, where it faces, and the camera that follows it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.viewer.draw.body import Capsule, body_capsules, body_points, capsule_ends, facing_angles

PERSON = 1.7  # metres
WIDE = 0.55  # the height of a person with arms spread, as a fraction of the width
SWAY = 4.0  # a scene is at least this many times as tall as it departs from the camera's target (a bouncing ball)
DOT = 0.07  # radius of a joint without bones, relative to a person
GROUND_PERCENTILE = 5.0  # of the lowest point over time: feet are on the ground for longer than this
NEAR_GROUND = 0.12  # relative to a person: feet this close to height 0 mean that the file's ground is at 0
FOLLOW = 1.0  # seconds over which the camera's target is averaged, so that it does not sway with every step
STRAIGHT = 0.7  # mean resultant length of the facing directions above which a clip has one direction
NEAREST = 0.2  # metres in front of the eye; nearer points are not drawn


@dataclass(frozen=True, eq=False)
class Scene:
    """What pictures, videos and players draw of a clip.

    Attributes:
        points: [T, P, 3] metres above the ground, Y up; point 0 is the root.
        capsules: limbs between points.
        fps: frames per second.
        tall: size relative to a person (1); distances of cameras scale with it.
        facings: [T] radians, facing direction of the body.
        facing: radians, facing direction of the whole clip: the mean, or that of the start if the body turns around.
        focus: [T, 3] metres, target of a following camera.
    """

    points: np.ndarray
    capsules: list[Capsule]
    fps: float
    tall: float
    facings: np.ndarray
    facing: float
    focus: np.ndarray


def make_scene(clip: MotionClip) -> Scene:
    """Returns the scene of a clip.

    The ground is at height 0 unless the body's lowest points are far from it, as in files that keep the hips in place;
    then it is just below them.
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
    focus = _running_mean(middle, clip.fps)
    tall = max(tall, SWAY * float(np.abs(middle - focus).max())) / PERSON
    capsules = [replace(c, start_radius=DOT * tall, end_radius=DOT * tall) if c.start == c.end else c for c in capsules]
    facings = facing_angles(clip, points)
    return Scene(
        points=points - [0.0, floor, 0.0],
        capsules=capsules,
        fps=clip.fps,
        tall=tall,
        facings=facings,
        facing=_overall_facing(facings, clip.fps),
        focus=focus,
    )


def _overall_facing(facings: np.ndarray, fps: float) -> float:
    whole = np.mean(np.exp(1j * facings))
    start = np.mean(np.exp(1j * facings[: max(1, round(fps / 2))]))
    return float(np.angle(whole if abs(whole) > STRAIGHT else start))


def _running_mean(points: np.ndarray, fps: float) -> np.ndarray:
    """Returns the centred running mean over `FOLLOW` seconds of points [T, 3].

    Both ends are extended by point reflection, so that the mean does not lag behind there.
    """
    half = max(1, round(FOLLOW * fps / 2))
    before = 2 * points[:1] - points[1 : half + 1][::-1]
    after = 2 * points[-1:] - points[-half - 1 : -1][::-1]
    extended = np.concatenate([before, points, after])
    pad = (half, half)  # clips shorter than the window repeat their outermost point
    sums = np.cumsum(np.pad(extended, (pad, (0, 0)), mode="edge"), axis=0)
    sums = np.concatenate([np.zeros((1, 3)), sums])
    means = (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
    return means[len(before) : len(before) + len(points)]


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera ahead of a body, a little to its left and above; the same as in `player_scene.js`.

    Attributes:
        target: [3] metres, the point at the centre of the picture.
        facing: radians, facing direction of the body.
        tall: size of the body relative to a person; the camera's distance scales with it.
        width, height: of the picture, pixels.
        yaw: radians from `facing` to the camera.
        pitch: radians above the ground.
        away: distance from a person, metres.
    """

    target: np.ndarray
    facing: float
    tall: float
    width: float
    height: float
    yaw: float = 0.75
    pitch: float = 0.28
    away: float = 4.6

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Projects points [..., 3] into the picture.

        Returns:
            (pixels [..., 2] right and up from the lower left corner, pixels per metre [...], nearness [...] metres in
            front of the target). Pixels are NaN for points behind the eye.
        """
        yaw = self.yaw + self.facing
        cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(self.pitch), np.sin(self.pitch)
        x, y, z = np.moveaxis(points - self.target, -1, 0)
        right, ahead = cy * x - sy * z, sy * x + cy * z
        up, near = cp * y - sp * ahead, sp * y + cp * ahead
        depth = self.away * self.tall - near
        zoom = 1.75 * min(self.height, 1.25 * self.width)
        scale = np.where(depth > NEAREST * self.tall, zoom / np.maximum(depth, 1e-9), np.nan)
        middle = np.array([self.width, self.height]) / 2
        return middle + np.stack([right, up], axis=-1) * scale[..., None], scale, near
