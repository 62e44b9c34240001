"""Paths on the ground for characters to follow: straight, circle, figure-eight, or points from a CSV file."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from pfnn_jax.errors import InputError

SPACING = 0.05
"""Default distance in metres between neighbouring points of a path."""

SHAPES = ("straight", "circle", "figure-eight")
"""Names that `make_path` knows."""


@dataclass(frozen=True, eq=False)
class Path:
    """A polyline whose points are equally spaced along it.

    Attributes:
        points: [N, 2] metres, x and z on the ground. A closed path does not repeat its first point.
        closed: whether the last point is joined to the first.
        length: of the whole path in metres.
    """

    points: np.ndarray
    closed: bool
    length: float

    @property
    def spacing(self) -> float:
        """Distance in metres along the path from one point to the next."""
        return self.length / (len(self.points) - (0 if self.closed else 1))

    @property
    def start_yaw(self) -> float:
        """Yaw of the path's initial direction in radians (0 = +Z, π/2 = +X)."""
        x, z = self.points[1] - self.points[0]
        return math.atan2(x, z)


def resample_path(points: np.ndarray, closed: bool, num_points: int | None = None) -> Path:
    """Returns the path of points at equal arc length along a polyline.

    Args:
        points: [M, 2] metres; repeated neighbours are dropped.
        closed: whether the polyline returns to its first point, which may be repeated at the end.
        num_points: N; by default one point every `SPACING` metres. Paths in a batch need equal N.

    Returns:
        The path; its length is the polyline's.

    Raises:
        ValueError: if the points are not [M, 2] and finite, fewer than two differ, or N is below 2 (3 if closed).
    """
    points = np.asarray(points, np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or not np.isfinite(points).all():
        raise ValueError(f"`points` must be [M, 2] and finite, got shape {points.shape}.")
    if closed:
        points = np.concatenate([points, points[:1]])
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    keep = np.concatenate([[True], np.diff(along) > 0.0])
    points, along = points[keep], along[keep]
    length = float(along[-1])
    if len(points) < 2:
        raise ValueError("`points` must hold at least two different points.")
    if num_points is None:
        num_points = max(round(length / SPACING) + (0 if closed else 1), 3)
    if num_points < (3 if closed else 2):
        raise ValueError(f"`num_points` must be at least {3 if closed else 2}, got {num_points}.")
    stations = np.linspace(0.0, length, num_points, endpoint=not closed)
    resampled = np.stack([np.interp(stations, along, points[:, axis]) for axis in range(2)], axis=-1)
    return Path(resampled, closed, length)


def straight(length: float = 10.0) -> Path:
    """Returns a straight path of `length` metres from the origin along +Z."""
    _positive("length", length)
    return resample_path(np.array([[0.0, 0.0], [0.0, length]]), closed=False)


def circle(radius: float | None = None, *, turn_rate: float | None = None, speed: float | None = None) -> Path:
    """Returns a circle that starts at the origin along +Z.

    Args:
        radius: metres; positive turns left (towards +X), negative right.
        turn_rate: radians per second about +Y, with `speed` in metres per second, instead of a radius.

    Raises:
        ValueError: unless either `radius` or both `turn_rate` and `speed` are given, finite and not zero.
    """
    if radius is None:
        if turn_rate is None or speed is None or turn_rate == 0.0:
            raise ValueError(f"`circle` needs a radius, or a turn rate (not 0) and a speed, got {turn_rate}, {speed}.")
        _positive("speed", speed)
        radius = speed / turn_rate
    elif turn_rate is not None:
        raise ValueError("`circle` takes a radius or a turn rate, got both.")
    _positive("radius", abs(radius))
    return _smooth(_arc(radius), 2.0 * math.pi * abs(radius))


def figure_eight(radius: float = 2.0) -> Path:
    """Returns two circles of `radius` metres that touch at the origin, the first to the left, starting along +Z."""
    _positive("radius", radius)
    return _smooth(np.concatenate([_arc(radius), _arc(-radius)]), 4.0 * math.pi * radius)


def mirror_path(path: Path) -> Path:
    """Mirrors a path across the plane x = 0."""
    return Path(path.points * np.array([-1.0, 1.0]), path.closed, path.length)


def read_path(file: str | FilePath) -> Path:
    """Reads a path from a CSV file of two columns, x and z in metres, with or without a header line.

    The path is closed if the last point equals the first. Blank lines are skipped.

    Raises:
        InputError: if a line does not hold two finite numbers, or fewer than two points differ.
        OSError: if the file cannot be read.
    """
    rows: list[list[float]] = []
    try:
        with open(file, encoding="utf-8-sig", newline="") as handle:
            reader = csv.reader(handle)
            for cells in reader:
                if not any(cell.strip() for cell in cells):
                    continue
                point = _parse_point(file, reader.line_num, cells, header=not rows and reader.line_num == 1)
                if point is not None:
                    rows.append(point)
    except UnicodeDecodeError as error:
        raise InputError(file, f"byte {error.start}", repr(error.object[error.start]), "must be UTF-8 text") from error
    except csv.Error as error:
        raise InputError(file, "text", error, "must be a table of two columns, x and z") from error
    points = np.array(rows).reshape(-1, 2)
    if len(np.unique(points, axis=0)) < 2:
        raise InputError(file, "rows", f"{len(points)} points", "must have at least two different points")
    closed = len(points) > 3 and bool((points[0] == points[-1]).all())
    return resample_path(points, closed)


def make_path(shape: str, size: float | None = None) -> Path:
    """Returns a path by the name of its shape, or from a CSV file.

    Args:
        shape: one of `SHAPES`, or the name of a file.
        size: in metres: length of the straight path, or radius (a circle with a negative one turns right); not used for
            files.

    Raises:
        InputError: if `shape` is neither a known shape nor a file, or the size is not valid for the shape.
    """
    makers = {"straight": (straight, 10.0), "circle": (circle, 2.0), "figure-eight": (figure_eight, 2.0)}
    if shape in makers:
        maker, default = makers[shape]
        try:
            return maker(default if size is None else size)
        except ValueError as error:
            raise InputError("path", shape, size, "must have a size that is a positive number of metres") from error
    if not FilePath(shape).is_file():
        raise InputError("path", "shape", shape, f"must be {', '.join(SHAPES)} or the name of a CSV file")
    return read_path(shape)


def _arc(radius: float) -> np.ndarray:
    """Returns one full turn [M, 2] from the origin, starting along +Z, towards +X if the radius is positive."""
    angle = np.linspace(0.0, 2.0 * math.pi, 1440, endpoint=False)
    return np.stack([radius * (1.0 - np.cos(angle)), abs(radius) * np.sin(angle)], axis=-1)


def _smooth(points: np.ndarray, length: float) -> Path:
    """Returns a closed path through a fine polyline, with the exact length of the curve that it approximates."""
    return Path(resample_path(points, closed=True).points, True, length)


def _positive(name: str, value: float) -> None:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError(f"`{name}` must be positive and finite, got {value}.")


def _parse_point(file: str | FilePath, line: int, cells: list[str], header: bool) -> list[float] | None:
    """Returns the two numbers of a line, or None for a header."""
    place = f"line {line}"
    rule = "each line must hold two numbers, x and z in metres"
    if len(cells) != 2:
        raise InputError(file, place, f"{len(cells)} columns", rule)
    numbers = [_number(cell) for cell in cells]
    if header and all(number is None for number in numbers):
        return None
    for cell, number in zip(cells, numbers, strict=True):
        if number is None or not math.isfinite(number):
            raise InputError(file, place, repr(cell.strip()), rule)
    return [number for number in numbers if number is not None]


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
