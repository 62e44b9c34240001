"""Draws triangle meshes into pictures: a depth buffer and shading per pixel, in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SUN = np.array([-0.45, 0.75, 0.55])
"""Direction to the light, in the picture's axes: right, up, towards the viewer."""
AMBIENT, SKY, DIFFUSE, GLOSS, RIM = 0.62, 0.2, 0.5, 0.07, 0.3
SHININESS = 24.0


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
    face, at, depth, shares = _fragments(
        surface.pixels * samples, surface.depth, surface.faces, samples * width, samples * height
    )
    nearest = np.full(samples * samples * width * height, np.inf)
    np.minimum.at(nearest, at, depth)
    seen = depth == nearest[at]
    face, at, shares = face[seen], at[seen], shares[seen]
    corners = surface.faces[face]
    normals = np.einsum("pk,pkc->pc", shares, surface.normals[corners])
    colours = shade(normals, np.einsum("pk,pkc->pc", shares, surface.colours[corners]))
    picture = np.zeros((samples * samples * width * height, 4))
    picture[at, :3], picture[at, 3] = colours, 1.0
    picture = picture.reshape(height, samples, width, samples, 4).mean(axis=(1, 3))
    picture[..., :3] /= np.maximum(picture[..., 3:], 1e-9)
    return picture


def cover(pixels: np.ndarray, faces: np.ndarray, width: int, height: int) -> np.ndarray:
    """Returns the picture [height, width] of bool that faces cover."""
    _, at, _, _ = _fragments(pixels, np.zeros(len(pixels)), faces, width, height)
    covered = np.zeros(width * height, bool)
    covered[at] = True
    return covered.reshape(height, width)


def shade(normals: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """Returns the colours [P, 3] of lit points.

    Args:
        normals: [P, 3] of any length, in the axes of the picture.
        colours: [P, 3] of the surface, in 0..1.
    """
    normals = normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    sun = SUN / np.linalg.norm(SUN)
    half = sun + np.array([0.0, 0.0, 1.0])
    half /= np.linalg.norm(half)
    facing = np.clip(normals @ sun, 0.0, None)
    light = AMBIENT + SKY * (0.5 + 0.5 * normals[:, 1]) + DIFFUSE * facing
    light = light * (1.0 - RIM * np.clip(1.0 - normals[:, 2], 0.0, 1.0) ** 2.5)
    gloss = GLOSS * np.clip(normals @ half, 0.0, None) ** SHININESS
    return np.clip(colours * light[:, None] + gloss[:, None], 0.0, 1.0)


def _fragments(
    pixels: np.ndarray, depth: np.ndarray, faces: np.ndarray, width: int, height: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Returns what every face that looks at the viewer covers.

    Returns:
        (face [P], index of the pixel [P], depth [P], shares of the face's corners [P, 3]).
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
    px, py = column + 0.5, row + 0.5
    x, y = x[number], y[number]
    second = ((px - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (py - y[:, 0])) / area[number]
    third = ((x[:, 1] - x[:, 0]) * (py - y[:, 0]) - (px - x[:, 0]) * (y[:, 1] - y[:, 0])) / area[number]
    shares = np.stack([1.0 - second - third, second, third], axis=-1)
    face = shown[number]
    return face, row * width + column, np.sum(shares * depth[faces[face]], axis=-1), shares


def _ranges(first: np.ndarray, past: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns (number of the range, value) for every value of the ranges from first [N] to past [N], exclusive."""
    counts = np.maximum(past - first, 0)
    number = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return number, np.arange(len(number)) - before[number] + first[number]
