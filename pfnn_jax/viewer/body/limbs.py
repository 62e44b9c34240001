"""Arms and legs: tubes along two bones that swell like muscles, with balls at the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.viewer.body.anatomy import ARM, LEG
from pfnn_jax.viewer.body.part import Part, ball, profile, smooth_step, tube

# Position along the limb (0 at its first joint, 1 at knee or elbow, 2 at its end) and metres from the bones to the skin
# of a person: to either side, to the front, to the back. Limbs begin as a ball, which looks the same however they turn.
LEG_PROFILE = (
    (0.00, 0.084, 0.084, 0.084),
    (0.15, 0.084, 0.084, 0.086),
    (0.35, 0.078, 0.082, 0.076),
    (0.60, 0.066, 0.070, 0.062),
    (0.82, 0.053, 0.056, 0.052),
    (0.94, 0.050, 0.055, 0.047),
    (1.00, 0.049, 0.056, 0.045),
    (1.06, 0.047, 0.052, 0.048),
    (1.14, 0.048, 0.045, 0.056),
    (1.28, 0.053, 0.040, 0.066),
    (1.42, 0.050, 0.037, 0.061),
    (1.60, 0.041, 0.034, 0.046),
    (1.80, 0.033, 0.031, 0.034),
    (1.92, 0.031, 0.032, 0.033),
    (2.00, 0.034, 0.034, 0.034),
)
ARM_PROFILE = (
    (0.00, 0.054, 0.054, 0.054),
    (0.16, 0.055, 0.053, 0.053),
    (0.34, 0.046, 0.048, 0.047),
    (0.52, 0.042, 0.047, 0.045),
    (0.78, 0.037, 0.038, 0.038),
    (0.94, 0.035, 0.035, 0.037),
    (1.00, 0.035, 0.034, 0.038),
    (1.08, 0.037, 0.037, 0.037),
    (1.22, 0.039, 0.043, 0.037),
    (1.45, 0.034, 0.038, 0.033),
    (1.70, 0.027, 0.030, 0.028),
    (1.88, 0.022, 0.027, 0.026),
    (2.00, 0.022, 0.026, 0.026),
)
CAP, END = np.radians((68.0, 42.0, 18.0)), np.radians((20.0, 55.0))  # rings of the round ends
BEND = 0.9  # half of the length over which skin passes from one bone to the next, in radii
SHORTEST_BEND = 0.6  # of the shorter bone: the limit of this length
INNER = 0.93  # radius of the ball in the middle joint, of the limb's own there


@dataclass(frozen=True, eq=False)
class LimbForm:
    """The form of a person's arm or leg.

    Attributes:
        profile: rows of a position along the limb and distances from the bones.
        stations: [R] positions along the limb of its rings, from 0 to 2.
        corners: of a ring.
        length: metres from the first joint to the end.
    """

    profile: tuple[tuple[float, ...], ...]
    stations: np.ndarray
    corners: int
    length: float


LEG_FORM = LimbForm(
    LEG_PROFILE,
    np.array([0.0, 0.14, 0.3, 0.5, 0.68, 0.82, 0.91, 0.97, 1.03, 1.09, 1.17, 1.29, 1.43, 1.6, 1.8, 2.0]),
    12,
    LEG,
)
ARM_FORM = LimbForm(
    ARM_PROFILE,
    np.array([0.0, 0.15, 0.32, 0.52, 0.7, 0.84, 0.92, 0.97, 1.03, 1.09, 1.2, 1.38, 1.6, 1.82, 2.0]),
    10,
    ARM,
)


def grow_limb(
    form: LimbForm, points: np.ndarray, joints: tuple[int, int], size: float, colour: np.ndarray
) -> list[Part]:
    """Returns a limb: its tube, and a ball in the middle joint that keeps its volume when it bends.

    Args:
        form: an arm's or a leg's.
        points: [3, 3] metres: first joint, middle joint, end.
        joints: that move the first and the second bone.
        size: of the body, relative to a person.
        colour: [3].
    """
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=-1)
    # short limbs are thinner, but less than in proportion
    thickness = float(np.sqrt(size * max(lengths.sum() / form.length, 0.25 * size)))
    centres, widths = _rows(form, points, thickness)
    axis = unit(points[2] - points[0])
    side = unit(np.cross(axis, [0.0, 0.0, 1.0]))
    rings = centres[:, None] + ellipses(widths, form.corners) @ np.stack([side, np.cross(side, axis)])
    radii = thickness * profile(form.profile, np.ones(1))
    reach = min(BEND * float(radii.max()), SHORTEST_BEND * max(float(lengths.min()), 1e-9))
    shares = smooth_step((centres - points[1]) @ axis / reach)
    weights = [{joints[0]: 1.0 - share, joints[1]: share} for share in shares.tolist()]
    return [tube(rings, weights, colour), ball(points[1], INNER * float(radii.min()), joints[1], colour)]


def _rows(form: LimbForm, points: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Returns the centres [R, 3] and widths [R, 3] of a limb's rings, with those of its round ends."""
    bones = np.diff(points, axis=0)
    along = unit(bones)
    widths = thickness * profile(form.profile, form.stations)
    bone = np.minimum(form.stations.astype(int), 1)
    centres = points[bone] + (form.stations - bone)[:, None] * bones[bone]
    first, last = widths[0].min(), widths[-1].min()
    before, after = np.append(-first, -first * np.sin(CAP)), np.append(last * np.sin(END), last)
    zero = np.zeros((1, 3))
    return (
        np.concatenate([points[0] + before[:, None] * along[0], centres, points[2] + after[:, None] * along[1]]),
        np.concatenate([zero, np.cos(CAP)[:, None] * widths[:1], widths, np.cos(END)[:, None] * widths[-1:], zero]),
    )


def ellipses(widths: np.ndarray, corners: int) -> np.ndarray:
    """Returns the corners [R, N, 2] of rings, to the side and to the front, of widths [R, 3]: side, front, back."""
    angles = 2 * np.pi * np.arange(corners) / corners
    across, ahead = np.cos(angles), np.sin(angles)
    depth = np.where(ahead >= 0, widths[:, 1:2], widths[:, 2:3])
    return np.stack([widths[:, :1] * across, depth * ahead], axis=-1)
