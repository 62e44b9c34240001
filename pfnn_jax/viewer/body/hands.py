"""Hands: a palm, four fingers and a thumb, a little curled, moved by the wrist."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.viewer.body.anatomy import ARM, Anatomy
from pfnn_jax.viewer.body.part import Part, tube

# Metres of a person along the hand, and half its breadth, half its thickness, and how far it sinks.
PALM = (
    (-0.022, 0.000, 0.000, 0.000),
    (-0.018, 0.018, 0.016, 0.000),
    (-0.004, 0.028, 0.022, 0.000),
    (0.016, 0.032, 0.019, 0.000),
    (0.040, 0.039, 0.018, 0.001),
    (0.066, 0.042, 0.016, 0.003),
    (0.088, 0.041, 0.013, 0.006),
    (0.098, 0.036, 0.009, 0.008),
    (0.100, 0.000, 0.000, 0.008),
)
FINGERS = ((0.031, 0.086, 0.075), (0.011, 0.090, 0.084), (-0.010, 0.087, 0.077), (-0.030, 0.080, 0.060))
"""Metres to the thumb's side, along the hand, and the length of index, middle, ring and little finger."""
FINGER_RADIUS = 0.0098
CURL = np.radians((8.0, 18.0, 30.0, 42.0))  # below the palm, at four places of a finger
THUMB = ((0.012, 0.022, 0.002), (0.032, 0.040, 0.010), (0.056, 0.056, 0.018), (0.078, 0.064, 0.024))
THUMB_RADII = (0.016, 0.0145, 0.0115, 0.0095)


def grow_hand(anatomy: Anatomy, side: str, colour: np.ndarray) -> list[Part]:
    """Returns the hand of one side, moved by the wrist, or by the forearm of an arm without a hand."""
    arm = anatomy.arm(side)
    assert arm is not None
    lower, hand = anatomy.limb(side, "lower_arm", "hand")
    joint = lower if hand is None else hand
    size = np.sqrt(anatomy.size * np.linalg.norm(np.diff(arm, axis=0), axis=-1).sum() / ARM)
    along = unit(arm[2] - arm[1])
    front = unit(np.array([0.0, 0.0, 1.0]) - along[2] * along)
    down = np.cross(along, front) * (1.0 if side == "left" else -1.0)
    down = down * np.sign(-down[1]) if down[1] else down
    axes = size * np.stack([along, front, down])  # along the hand, to the thumb, to the palm
    parts = [_palm(), *(_finger(*finger) for finger in FINGERS), _thumb()]
    return [tube(arm[2] + rings @ axes, [{joint: 1.0}] * len(rings), colour) for rings in parts]


def _palm(corners: int = 10) -> np.ndarray:
    """Returns the rings [R, N, 3] of a person's palm: along the hand, to the thumb, to the palm."""
    angles = 2 * np.pi * np.arange(corners) / corners
    c, s = (np.sign(f) * np.abs(f) ** 0.8 for f in (np.cos(angles), np.sin(angles)))
    return np.array([np.stack([np.full(corners, x), w * c, t * s + d], axis=-1) for x, w, t, d in PALM])


def _finger(across: float, along: float, length: float) -> np.ndarray:
    """Returns the rings [R, N, 3] of a person's finger."""
    fan = 0.12 * across / 0.031
    steps = length * np.array([0.40, 0.34, 0.26])
    heading = np.stack([np.cos(CURL), fan * np.cos(CURL), np.sin(CURL)], axis=-1)
    points = np.array([along, across, 0.004]) + np.concatenate(
        [np.zeros((1, 3)), np.cumsum(steps[:, None] * heading[:3], axis=0)]
    )
    return _worm(points, FINGER_RADIUS * np.array([1.0, 0.98, 0.88, 0.74]))


def _thumb() -> np.ndarray:
    return _worm(np.array(THUMB), np.array(THUMB_RADII))


def _worm(points: np.ndarray, radii: np.ndarray, corners: int = 5) -> np.ndarray:
    """Returns the rings [R, N, 3] of a round tube through points [P, 3] with a round tip."""
    along = unit(np.gradient(points, axis=0))
    points = np.concatenate([points, points[-1:] + 0.8 * radii[-1] * along[-1:]])
    along = np.concatenate([along, along[-1:]])
    radii = np.concatenate([radii, [0.55 * radii[-1]]])
    across = unit(np.cross(along, np.array([0.0, 0.0, 1.0])))
    upward = np.cross(across, along)
    angles = 2 * np.pi * np.arange(corners) / corners
    circle = np.cos(angles)[:, None, None] * across + np.sin(angles)[:, None, None] * upward
    return points[:, None] + radii[:, None, None] * circle.swapaxes(0, 1)
