"""Closed surfaces, of which the body consists: tubes of rings, with the joints that move them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

INFLUENCES = 4
"""Joints that move one vertex at the most."""

Weights = dict[int, float]
"""Joint -> share of the joint in the movement of a vertex."""


@dataclass(frozen=True, eq=False)
class Part:
    """A closed surface with the joints that move it.

    Attributes:
        vertices: [V, 3] metres in the reference pose.
        faces: [F, 3] vertex indices, anticlockwise as seen from outside.
        joints: [V, 4] indices of the joints that move each vertex.
        weights: [V, 4], of sum 1.
        colours: [V, 3] uint8, sRGB.
    """

    vertices: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    colours: np.ndarray


def tube(rings: np.ndarray, weights: Sequence[Weights], colour: np.ndarray) -> Part:
    """Returns the closed surface through rings; one vertex closes each end, in the middle of its ring.

    Args:
        rings: [R, N, 3] metres, every ring in the same sense. The first and the last may be points (N equal vertices).
        weights: [R], or [R * N], of the rings or of their vertices.
        colour: [3], in 0..255.
    """
    ends = rings[[0, -1]].mean(axis=1)
    points = np.ptp(rings[[0, -1]], axis=1).max(axis=1) == 0.0
    kept = slice(int(points[0]), len(rings) - int(points[1]))
    if len(weights) == len(rings):
        weights = list(weights)[kept]
    else:
        weights = list(weights)[kept.start * rings.shape[1] : kept.stop * rings.shape[1]]
    rings = rings[kept]
    vertices = np.concatenate([rings.reshape(-1, 3), ends])
    joints, shares = _skin(weights, *rings.shape[:2])
    colours = np.tile(np.asarray(colour).round().astype(np.uint8), (len(vertices), 1))
    return Part(vertices, _outward(vertices, _faces(*rings.shape[:2])), joints, shares, colours)


def _faces(count: int, corners: int) -> np.ndarray:
    """Returns the faces [F, 3] of `count` rings, one after another, and of the two vertices after them."""
    here, after = np.arange(corners), (np.arange(corners) + 1) % corners
    first = corners * np.arange(count - 1)[:, None]
    a, b, c, d = first + here, first + after, first + corners + here, first + corners + after
    sides = np.concatenate([np.stack([a, b, d], axis=-1), np.stack([a, d, c], axis=-1)]).reshape(-1, 3)
    last, pole = corners * (count - 1), count * corners
    start = np.stack([after, here, np.full(corners, pole)], axis=1)
    end = np.stack([last + here, last + after, np.full(corners, pole + 1)], axis=1)
    return np.concatenate([sides, start, end])


def ball(centre: np.ndarray, radius: float, joint: int, colour: np.ndarray, corners: int = 8, rows: int = 4) -> Part:
    """Returns a ball that one joint moves."""
    polar = np.pi * np.arange(1, rows + 1) / (rows + 1)
    angles = 2 * np.pi * np.arange(corners) / corners
    unit = np.stack(
        [
            np.outer(np.sin(polar), np.cos(angles)),
            np.repeat(np.cos(polar)[:, None], corners, axis=1),
            np.outer(np.sin(polar), np.sin(angles)),
        ],
        axis=-1,
    )
    part = tube(centre + radius * unit, [{joint: 1.0}] * rows, colour)
    part.vertices[-2:] = centre + radius * np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    return part


def profile(keys: Sequence[Sequence[float]], at: np.ndarray) -> np.ndarray:
    """Returns the values [R, C] of a smooth curve without overshoot at positions [R].

    Args:
        keys: rows of a position and C values, by increasing position; constant beyond the first and the last.
        at: [R] positions.
    """
    table = np.asarray(keys, float)
    x, y = table[:, 0], table[:, 1:]
    at = np.clip(at, x[0], x[-1])
    step = np.diff(x)[:, None]
    rise = np.diff(y, axis=0) / step
    # slopes at the keys: the harmonic mean of those on either side, and none at an extreme (Fritsch and Butland 1984)
    before, after = rise[:-1], rise[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(before * after > 0.0, 2.0 * before * after / (before + after), 0.0)
    slopes = np.concatenate([rise[:1], mean, rise[-1:]])
    cell = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    width = step[cell]
    t = ((at - x[cell])[:, None]) / width
    low = y[cell] + t * t * (3.0 - 2.0 * t) * (y[cell + 1] - y[cell])
    return low + width * t * (1.0 - t) * ((1.0 - t) * slopes[cell] - t * slopes[cell + 1])


def smooth_step(x: np.ndarray | float) -> np.ndarray:
    """Returns a smooth step from 0 at -1 to 1 at 1."""
    t = np.clip((np.asarray(x, float) + 1.0) / 2.0, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _skin(weights: Sequence[Weights], count: int, corners: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns joints and weights [V, 4] of the vertices of a tube; poles move like the ring that they close."""
    joints, shares = np.zeros((len(weights), INFLUENCES), int), np.zeros((len(weights), INFLUENCES))
    for number, row in enumerate(weights):
        kept = sorted(row.items(), key=lambda item: -item[1])[:INFLUENCES]
        joints[number, : len(kept)] = [joint for joint, _ in kept]
        shares[number, : len(kept)] = [share for _, share in kept]
    shares /= shares.sum(axis=1, keepdims=True)
    if len(weights) == count:
        joints, shares = joints.repeat(corners, axis=0), shares.repeat(corners, axis=0)
    return np.concatenate([joints, joints[[0, -1]]]), np.concatenate([shares, shares[[0, -1]]])


def _outward(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Returns faces that all look outwards, from faces that all look to one side."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    volume = np.sum(np.cross(a, b) * c)
    return faces if volume > 0 else faces[:, ::-1]
