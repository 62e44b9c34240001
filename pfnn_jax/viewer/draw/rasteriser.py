"""Draws triangle meshes into pictures: a depth buffer and shading per pixel, in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SUN = np.array([-0.45, 0.75, 0.55])
"""Direction to the light, in the picture's axes: right, up, towards the viewer."""
AMBIENT, SKY, DIFFUSE, GLOSS, RIM = 0.62, 0.2, 0.5, 0.07, 0.3
SHININESS = 5  # times that the highlight is squared


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh in the axes of a picture, ready to be drawn.

    Attributes:
        pixels: [V, 2] right and down from the upper left corner.
        depth: [V] smaller is nearer.
        normals: [V, 3] right, up, towards the viewer.
        faces: [F, 3].
        colours: [V, 3] in 0..1.
    """

    pixels: np.ndarray
    depth: np.ndarray
    normals: np.ndarray
    faces: np.ndarray
    colours: np.ndarray


def draw_surface(surface: Surface, width: int, height: int, samples: int = 2) -> np.ndarray:
    """Returns a picture [height, width, 4] of a mesh, with straight opacity, in 0..1.

    Args:
        surface: the mesh.
        width, height: pixels.
        samples: per pixel and direction, against jagged edges.
    """
    wide = samples * width
    face, at, depth, shares = _fragments(surface.pixels * samples, surface.depth, surface.faces, wide, samples * height)
    nearest = np.full(wide * samples * height, np.inf, np.float32)
    np.minimum.at(nearest, at, depth)
    seen = np.flatnonzero(depth == nearest[at])
    at, shares = at[seen], shares[:, seen]
    corners = np.ascontiguousarray(surface.faces.T).take(face[seen], axis=1)
    normals, colours = (_blend(shares, values, corners) for values in (surface.normals, surface.colours))
    pixel = at // wide // samples * width + at % wide // samples
    sums = [np.bincount(pixel, values, width * height) for values in shade(normals, colours)]
    count = np.bincount(pixel, minlength=width * height)
    picture = np.stack([*(values / np.maximum(count, 1) for values in sums), count / samples**2], axis=-1)
    return np.minimum(picture, 1.0).reshape(height, width, 4)


def cover(pixels: np.ndarray, faces: np.ndarray, width: int, height: int) -> np.ndarray:
    """Returns the picture [height, width] of bool that faces cover."""
    _, at, _, _ = _fragments(pixels, np.zeros(len(pixels)), faces, width, height)
    covered = np.zeros(width * height, bool)
    covered[at] = True
    return covered.reshape(height, width)


def shade(normals: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Returns the colours [3, P] of lit points.

    Args:
        normals: [3, P] of any length, in the axes of the picture.
        colours: [3, P] of the surface, in 0..1.
    """
    normals = normals / np.sqrt(np.maximum(np.sum(normals * normals, axis=0), 1e-12))
    sun = SUN / np.linalg.norm(SUN)
    half = sun + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    facing = np.maximum(_along(normals, sun), 0.0)
    edge = np.clip(1.0 - normals[2], 0.0, 1.0)
    light = (AMBIENT + SKY * (0.5 + 0.5 * normals[1]) + DIFFUSE * facing) * (1.0 - RIM * edge * edge * edge)
    gloss = np.maximum(_along(normals, half), 0.0)
    for _ in range(SHININESS):
        gloss = gloss * gloss
    return np.clip(colours * light + GLOSS * gloss, 0.0, 1.0)


def _along(vectors: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Returns the scalar products [P] of vectors [3, P] with one vector [3] or with as many."""
    return vectors[0] * direction[0] + vectors[1] * direction[1] + vectors[2] * direction[2]


def _blend(shares: np.ndarray, values: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Returns values [3, P] between those [V, 3] of the corners [3, P] of faces, by shares [3, P]."""
    columns = np.ascontiguousarray(values.T, np.float32)
    return np.stack([sum(s * column.take(c) for s, c in zip(shares, corners, strict=True)) for column in columns])


def _fragments(
    pixels: np.ndarray, depth: np.ndarray, faces: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns what every face that looks at the viewer covers.

    Returns:
        (face [P], index of the pixel [P], depth [P], shares of the face's corners [3, P]).
    """
    x, y = pixels[faces, 0], pixels[faces, 1]  # [F, 3]
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    with np.errstate(invalid="ignore"):
        shown = np.flatnonzero(area < -1e-9)  # y points down
    x, y, area = x[shown], y[shown], area[shown]
    # rows whose centres a face covers
    first = np.clip(np.ceil(y.min(axis=1) - 0.5), 0, height).astype(int)
    last = np.clip(np.ceil(y.max(axis=1) - 0.5), 0, height).astype(int)
    number, row = _ranges(first, last)
    level = row + 0.5
    ends = np.full((2, len(row)), np.inf)
    for a, b in ((0, 1), (1, 2), (2, 0)):
        xa, ya, xb, yb = x[number, a], y[number, a], x[number, b], y[number, b]
        crosses = (ya <= level) != (yb <= level)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = np.where(crosses, xa + (level - ya) * (xb - xa) / (yb - ya), np.nan)
        ends[0] = np.fmin(ends[0], at)
        ends[1] = np.fmin(ends[1], -at)
    left = np.clip(np.ceil(ends[0] - 0.5), 0, width).astype(int)
    right = np.clip(np.ceil(-ends[1] - 0.5), 0, width).astype(int)
    span, column = _ranges(left, right)
    number, row = number[span], row[span]
    # shares of the second and the third corner are linear in the picture
    x0, y0 = x[:, 0], y[:, 0]
    slopes = np.stack([y[:, 2] - y0, x0 - x[:, 2], y0 - y[:, 1], x[:, 1] - x0]) / area
    at_corner = np.stack([slopes[0] * x0 + slopes[1] * y0, slopes[2] * x0 + slopes[3] * y0])
    terms = np.concatenate([slopes, at_corner]).astype(np.float32)[:, number]
    px, py = (column + 0.5).astype(np.float32), (row + 0.5).astype(np.float32)
    second, third = terms[0] * px + terms[1] * py - terms[4], terms[2] * px + terms[3] * py - terms[5]
    face = shown[number]
    shares = np.stack([1.0 - second - third, second, third])
    return face, row * width + column, _along(shares, depth[faces].T.astype(np.float32).take(face, axis=1)), shares


def _ranges(first: np.ndarray, past: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns (number of the range, value) for every value of the ranges from first [N] to past [N], exclusive."""
    counts = np.maximum(past - first, 0)
    number = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return number, np.arange(len(number)) - before[number] + first[number]
