"""Arms and legs: tubes along two bones that swell like muscles, with balls at the joints."""

from __future__ import annotations

import numpy as np

from pfnn_jax.viewer.body.part import Part, ball, profile, smooth_step, tube, unit

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
CAP = np.radians((68.0, 42.0, 18.0))
BEND = 0.9  # half of the length over which skin passes from one bone to the next, in radii


def grow_limb(
    points: np.ndarray,
    joints: tuple[int, int],
    keys: tuple[tuple[float, ...], ...],
    thickness: float,
    colour: np.ndarray,
    stations: np.ndarray,
    corners: int,
) -> list[Part]:
    """Returns a limb: its tube, and a ball in the middle joint that keeps its volume when it bends.

    Args:
        points: [3, 3] metres: first joint, middle joint, end.
        joints: that move the first and the second bone.
        keys: profile of a person's limb.
        thickness: relative to a person.
        colour: [3].
        stations: [R] positions along the limb of its rings, from 0 to 2.
        corners: of a ring.
    """
    front = np.array([0.0, 0.0, 1.0])
    lengths = np.maximum(np.linalg.norm(np.diff(points, axis=0), axis=-1), 1e-9)
    widths = thickness * profile(keys, stations)
    bone = np.minimum(stations.astype(int), 1)
    centres = points[bone] + (stations - bone)[:, None] * np.diff(points, axis=0)[bone]
    first, last = widths[0, 0], widths[-1].min()
    starts = [(-first * np.sin(a), np.full(3, first * np.cos(a))) for a in CAP]
    ends = [(last * np.sin(a), widths[-1] * np.cos(a)) for a in CAP[::-1]]
    along = unit(np.diff(points, axis=0))
    centres = np.concatenate(
        [
            [points[0] + d * along[0] for d in (-first, *(d for d, _ in starts))],
            centres,
            [points[2] + d * along[1] for d in (*(d for d, _ in ends), last)],
        ]
    )
    zero = np.zeros((1, 3))
    widths = np.concatenate([zero, [w for _, w in starts], widths, [w for _, w in ends], zero])
    axis = unit(points[2] - points[0])
    side = unit(np.cross(axis, front))
    front = np.cross(side, axis)
    rings = centres[:, None] + ellipses(widths, corners) @ np.stack([side, front])
    distance = (centres - points[1]) @ axis
    reach = BEND * thickness * float(np.max(profile(keys, np.ones(1))))
    reach = min(reach, 0.6 * float(lengths.min()))
    shares = smooth_step(distance / reach)
    weights = [{joints[0]: 1.0 - share, joints[1]: share} for share in shares.tolist()]
    middle = 0.93 * thickness * float(profile(keys, np.ones(1)).min())
    return [tube(rings, weights, colour), ball(points[1], middle, joints[1], colour)]


def ellipses(widths: np.ndarray, corners: int) -> np.ndarray:
    """Returns the corners [R, N, 2] of rings, to the side and to the front, of widths [R, 3]: side, front, back."""
    angles = 2 * np.pi * np.arange(corners) / corners
    across, ahead = np.cos(angles), np.sin(angles)
    depth = np.where(ahead >= 0, widths[:, 1:2], widths[:, 2:3])
    return np.stack([widths[:, :1] * across, depth * ahead], axis=-1)


LEG_STATIONS = np.array(
    [0.0, 0.12, 0.25, 0.4, 0.55, 0.7, 0.82, 0.89, 0.95, 1.0, 1.05, 1.11, 1.2, 1.3, 1.42, 1.56, 1.7, 1.84, 2.0]
)
ARM_STATIONS = np.array(
    [0.0, 0.14, 0.28, 0.42, 0.56, 0.7, 0.8, 0.88, 0.94, 1.0, 1.06, 1.13, 1.22, 1.36, 1.52, 1.7, 1.86, 2.0]
)
