"""The head: skull, brow, nose and chin, and a dark visor that shows from afar where it looks."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.retargeting.body import neck_chain, torso_chain
from pfnn_jax.viewer.body.anatomy import Anatomy
from pfnn_jax.viewer.body.part import Part, profile, tube

CORNERS = 20
# Metres of a person above the middle of the head: half the width, where the front and where the back is.
PROFILE = (
    (-0.116, 0.004, 0.060, 0.050),
    (-0.110, 0.026, 0.082, 0.030),
    (-0.097, 0.038, 0.091, 0.008),
    (-0.075, 0.050, 0.092, -0.022),
    (-0.050, 0.059, 0.092, -0.052),
    (-0.022, 0.066, 0.091, -0.078),
    (0.008, 0.072, 0.087, -0.094),
    (0.034, 0.076, 0.094, -0.102),
    (0.060, 0.075, 0.089, -0.101),
    (0.086, 0.065, 0.070, -0.086),
    (0.104, 0.046, 0.045, -0.062),
    (0.114, 0.022, 0.016, -0.032),
    (0.117, 0.004, -0.004, -0.012),
)
STATIONS = np.array(
    [-0.116, -0.110, -0.099, -0.082, -0.062, -0.044, -0.032, -0.018, 0.002, 0.018, 0.034, 0.05, 0.066, 0.082, 0.096, 0.107, 0.114, 0.117]
)  # fmt: skip
NOSE = ((-0.044, 0.0), (-0.034, 0.012), (-0.026, 0.021), (-0.010, 0.014), (0.012, 0.006), (0.03, 0.0))
VISOR = np.radians(64.0)  # to either side
VISOR_HEIGHT = (-0.010, 0.026)
HEAD = 0.233  # metres from chin to crown
JOINT = np.array([0.0, -0.092, -0.012])  # of the head joint, from the middle of the head
CROWN = 0.12  # share of the size from which on a bone above the head joint reaches to the crown


def grow_head(anatomy: Anatomy, colour: np.ndarray, dark: np.ndarray) -> list[Part]:
    """Returns the head and its visor, moved by the head joint or the last joint below it."""
    joint = (*torso_chain(anatomy.body), *neck_chain(anatomy.body))[-1]
    size, middle = _place(anatomy, joint)
    only = {joint: 1.0}
    rings = middle + size * _skull()
    visor = middle + size * _visor()
    return [tube(rings, [only] * len(rings), colour), tube(visor, [only] * len(visor), dark)]


def _place(anatomy: Anatomy, joint: int) -> tuple[float, np.ndarray]:
    """Returns the size of the head relative to a person's, and its middle [3]."""
    size, at = anatomy.size, anatomy.at(joint)
    tips = anatomy.tips(joint) if joint == anatomy.body.head else np.zeros((0, 3))
    crown = max((float(tip[1] - at[1]) for tip in tips), default=0.0)
    if crown > CROWN * size:
        size = float(np.clip(crown / (HEAD / 2 - JOINT[1]), 0.85 * size, 2.5 * size))
    if joint != anatomy.body.head:
        at = at + np.array([0.0, 0.3 * HEAD * size, 0.0])
    return size, at - size * JOINT


def _skull() -> np.ndarray:
    """Returns the rings [R, N, 3] of a person's head around its middle."""
    half, front, back = profile(PROFILE, STATIONS).T
    angles = 2 * np.pi * np.arange(CORNERS) / CORNERS
    c, s = np.cos(angles), np.sin(angles)
    x = half[:, None] * np.sign(c) * np.abs(c) ** 0.9
    middle, depth = (front + back) / 2, (front - back) / 2
    z = middle[:, None] + depth[:, None] * np.sign(s) * np.abs(s) ** 0.9
    nose = np.interp(STATIONS, *np.array(NOSE).T)
    z[:, CORNERS // 4] += nose
    z[:, [CORNERS // 4 - 1, CORNERS // 4 + 1]] += 0.15 * nose[:, None]
    return np.stack([x, np.broadcast_to(STATIONS[:, None], x.shape), z], axis=-1)


def _visor() -> np.ndarray:
    """Returns the rings [R, N, 3] of a band across the eyes: it runs from right to left, and its rings are upright."""
    turns = VISOR * np.array([-1.0, -0.97, -0.85, -0.6, -0.3, 0.0, 0.3, 0.6, 0.85, 0.97, 1.0])[:, None]
    middle, reach = np.mean(VISOR_HEIGHT), np.ptp(VISOR_HEIGHT) / 2
    shrink = np.sqrt(np.clip(1 - (np.abs(turns) / VISOR) ** 8, 0.02, 1))
    levels = middle + reach * shrink * np.array([-1.0, -0.4, 0.4, 1.0])
    return np.concatenate([_face(turns, levels, 0.005), _face(turns, levels[:, ::-1], -0.012)], axis=1)


def _face(turns: np.ndarray, levels: np.ndarray, out: float) -> np.ndarray:
    """Returns points [R, N, 3] that lie `out` metres before the face, at angles from its front."""
    half, front, back = np.moveaxis(profile(PROFILE, levels.ravel()).reshape(*levels.shape, 3), -1, 0)
    c, s = np.sin(turns), np.cos(turns)
    x, z = (half + out) * np.sign(c) * np.abs(c) ** 0.9, ((front - back) / 2 + out) * np.sign(s) * np.abs(s) ** 0.9
    return np.stack([x, levels, (front + back) / 2 + z], axis=-1)
