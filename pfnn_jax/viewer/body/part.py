"""Closed surfaces, of which the body consists: tubes of rings, with the joints that move them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator

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
    """Returns the closed surface through rings; its ends are closed by one vertex in the middle of the end ring.

    Args:
        rings: [R, N, 3] metres, every ring in the same sense; the first and the last may be points (N equal vertices).
        weights: [R], or [R * N], of the rings or of their vertices.
        colour: [3], [R, 3] or [R, N, 3], in 0..255.
    """
    count, corners = rings.shape[:2]
    ends = rings[[0, -1]].mean(axis=1)
    vertices = np.concatenate([rings.reshape(-1, 3), ends])
    here, after = np.arange(corners), (np.arange(corners) + 1) % corners
    faces = []
    for first in corners * np.arange(count - 1):
        a, b, c, d = first + here, first + after, first + corners + here, first + corners + after
        faces += [np.stack([a, b, d], axis=1), np.stack([a, d, c], axis=1)]
    last, poles = corners * (count - 1), count * corners
    faces.append(np.stack([after, here, np.full(corners, poles)], axis=1))
    faces.append(np.stack([last + here, last + after, np.full(corners, poles + 1)], axis=1))
    joints, shares = _skin(weights, count, corners)
    colours = np.broadcast_to(np.asarray(colour, float).reshape(_shape(colour)), (count, corners, 3)).reshape(-1, 3)
    colours = np.concatenate([colours, colours[[0, -1]]]).round().astype(np.uint8)
    return Part(vertices, _outward(vertices, np.concatenate(faces)), joints, shares, colours)


def ball(centre: np.ndarray, radius: float, joint: int, colour: np.ndarray, corners: int = 8, rows: int = 5) -> Part:
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
    inside = np.clip(at, table[0, 0], table[-1, 0])
    return PchipInterpolator(table[:, 0], table[:, 1:])(inside)


def smooth_step(x: np.ndarray | float) -> np.ndarray:
    """Returns a smooth step from 0 at -1 to 1 at 1."""
    t = np.clip((np.asarray(x, float) + 1.0) / 2.0, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def unit(vector: np.ndarray) -> np.ndarray:
    """Returns a vector [..., 3] of length 1 in the same direction."""
    return vector / np.maximum(np.linalg.norm(vector, axis=-1, keepdims=True), 1e-12)


def _shape(colour: np.ndarray) -> tuple[int, ...]:
    shape = np.shape(colour)
    return (shape[0], 1, 3) if len(shape) == 2 else shape


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
