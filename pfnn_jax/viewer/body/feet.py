"""Feet: shoes with a flat sole on the floor that the foot rests on, and toes that bend."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.viewer.body.anatomy import Anatomy
from pfnn_jax.viewer.body.part import Part, ball, profile, smooth_step, tube

BALL, TIP, HEEL = 0.135, 0.072, 0.062
"""Metres of a person from the ankle to the ball of the foot, from there to the tip, and from the ankle back."""

# Share of the way from ankle to ball (up to 1) and from ball to tip (up to 2), or back to the heel (from -1): half the
# width, and the height as a share of the ankle's (up to 0.5) or in metres of a person.
WIDTH = (
    (-1.00, 0.004), (-0.93, 0.020), (-0.72, 0.033), (-0.30, 0.037), (0.00, 0.038), (0.40, 0.040), (0.80, 0.047),
    (1.00, 0.049), (1.35, 0.047), (1.70, 0.037), (1.92, 0.020), (2.00, 0.004),
)  # fmt: skip
HEIGHT = (
    (-1.00, 0.030), (-0.93, 0.048), (-0.72, 0.072), (-0.30, 0.094), (0.10, 0.096), (0.40, 0.078), (0.80, 0.052),
    (1.00, 0.044), (1.35, 0.037), (1.70, 0.031), (1.92, 0.022), (2.00, 0.012),
)  # fmt: skip
STATIONS = np.array([-1.0, -0.93, -0.72, -0.35, 0.0, 0.25, 0.5, 0.75, 0.9, 1.05, 1.3, 1.6, 1.85, 2.0])
CORNERS = 12


def grow_foot(anatomy: Anatomy, side: str, colour: np.ndarray) -> list[Part]:
    """Returns the foot of one side: its shoe, moved by ankle and toes, and a ball around the ankle."""
    size, ankle = anatomy.size, anatomy.leg(side)[2]
    shin, foot, toe = anatomy.limb(side, "shin", "foot", "toe")
    joint = shin if foot is None else foot
    high, low = anatomy.foot_heights(side)
    ahead, length = np.array([0.0, 0.0, 1.0]), BALL * size
    sole = ankle - [0.0, high, 0.0]
    tilt = 0.0
    if toe is not None:
        flat = (anatomy.at(toe) - ankle) * [1.0, 0.0, 1.0]
        if np.linalg.norm(flat) > 0.3 * length:
            length = float(np.linalg.norm(flat))
            ahead = flat / length
        tilt = float(anatomy.at(toe)[1] - low - sole[1]) / length
    scale = length / BALL
    distance = np.where(STATIONS < 0, HEEL * np.sqrt(size * scale) * STATIONS, length * np.minimum(STATIONS, 1.0))
    distance = distance + TIP * scale * np.maximum(STATIONS - 1.0, 0.0)
    rings = sole + distance[:, None, None] * (ahead + [0.0, tilt, 0.0])
    rings = rings + _sections(size, high) @ np.stack([unit(np.cross([0.0, 1.0, 0.0], ahead)), [0.0, 1.0, 0.0]])
    bends = smooth_step((distance - length) / (0.25 * TIP * scale + 0.012 * size)) if toe is not None else 0 * distance
    weights = [
        {joint: 1.0 - bend, (joint if toe is None else toe): bend} if bend else {joint: 1.0} for bend in bends.tolist()
    ]
    return [tube(rings, weights, colour), ball(ankle, 0.041 * size, joint, colour)]


def _sections(size: float, high: float) -> np.ndarray:
    """Returns the cross-sections [R, N, 2] of a shoe, across and above the sole, in metres."""
    half, height = size * profile(WIDTH, STATIONS), size * profile(HEIGHT, STATIONS)
    near = 1 - smooth_step(2 * (np.maximum(STATIONS, 0.0) - 0.1) / 0.7 - 1)[:, None]
    height = height * (1 + near * (high / (0.085 * size) - 1))
    angles = 2 * np.pi * np.arange(CORNERS) / CORNERS
    c, s = np.cos(angles), np.sin(angles)
    across = half * np.sign(c) * np.abs(c) ** 0.75
    above = np.where(s >= 0, 0.35 + 0.65 * np.abs(s) ** 0.95, 0.35 - 0.35 * np.abs(s) ** 0.45) * height
    return np.stack([across, above], axis=-1)
