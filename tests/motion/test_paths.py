"""Paths: exact lengths and turns of the shapes, equal spacing, and CSV files of points, good and bad."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.errors import InputError
from pfnn_jax.motion.paths import (
    SPACING,
    circle,
    figure_eight,
    make_path,
    mirror_path,
    read_path,
    resample_path,
    straight,
)
from tests.raising import assert_refused

# Metres: a circle of 1440 chords lies this close to the true one, and its chords sum to this much less.
CHORDS = 1e-4
# float64 rounding over some hundred sums.
FLOAT64 = 1e-9

points_lists = st.lists(
    st.tuples(st.floats(-50.0, 50.0, width=32), st.floats(-50.0, 50.0, width=32)), min_size=2, max_size=20
).filter(lambda points: len(set(points)) > 1 and points[0] != points[-1])


def test_straight_runs_along_z():
    path = straight(3.0)
    assert path.length == 3.0 and not path.closed and path.start_yaw == 0.0
    np.testing.assert_allclose(path.points[:, 0], 0.0)
    np.testing.assert_allclose(path.points[:, 1], np.linspace(0.0, 3.0, 61), atol=FLOAT64)


@pytest.mark.parametrize("radius", [0.8, 2.0, -3.0])
def test_circle_has_its_radius_and_side(radius):
    path = circle(radius)
    assert path.closed and path.length == pytest.approx(2 * math.pi * abs(radius))
    distance = np.hypot(*(path.points - [radius, 0.0]).T)
    np.testing.assert_allclose(distance, abs(radius), atol=CHORDS)
    np.testing.assert_allclose(path.points[0], 0.0, atol=FLOAT64)
    # It sets out along +Z; its first chord already leans half a step to its side.
    assert path.start_yaw == pytest.approx(0.5 * path.spacing / radius, abs=CHORDS)


def test_circle_from_a_turn_rate():
    np.testing.assert_allclose(circle(turn_rate=-0.5, speed=1.0).points, circle(-2.0).points)


def test_figure_eight_is_a_left_and_a_right_circle():
    path = figure_eight(1.5)
    half = len(path.points) // 2
    assert path.length == pytest.approx(6 * math.pi) and path.closed
    np.testing.assert_allclose(np.hypot(*(path.points[:half] - [1.5, 0.0]).T), 1.5, atol=CHORDS)
    np.testing.assert_allclose(np.hypot(*(path.points[half + 1 :] - [-1.5, 0.0]).T), 1.5, atol=CHORDS)


def test_mirror_is_an_involution():
    path = circle(2.0)
    np.testing.assert_allclose(mirror_path(path).points, circle(-2.0).points, atol=FLOAT64)
    np.testing.assert_array_equal(mirror_path(mirror_path(path)).points, path.points)


@given(points_lists, st.booleans(), st.integers(3, 60))
def test_resampling_keeps_length_and_spaces_evenly(points, closed, num_points):
    points = np.array(points)
    path = resample_path(points, closed, num_points)
    ring = np.concatenate([points, points[:1]]) if closed else points
    length = np.hypot(*np.diff(ring, axis=0).T).sum()
    assert path.length == pytest.approx(length) and path.points.shape == (num_points, 2)
    np.testing.assert_allclose(path.points[0], points[0])
    if not closed:
        np.testing.assert_allclose(path.points[-1], points[-1], atol=FLOAT64 * (1 + length))
    # A chord is never longer than the piece of the polyline that it cuts off.
    assert np.hypot(*np.diff(path.points, axis=0).T).max() <= path.spacing * (1 + FLOAT64) + FLOAT64


@given(points_lists, st.booleans(), st.sampled_from(["\n", "\r\n", "\n\n"]))
def test_csv_round_trip(tmp_path_factory, points, header, newline):
    file = tmp_path_factory.mktemp("paths") / "path.csv"
    lines = ["x,z"] * header + [f"{x!r}, {z!r}" for x, z in points]
    file.write_bytes(newline.join(lines).encode())
    found, expected = read_path(file), resample_path(np.array(points), closed=False)
    assert not found.closed
    np.testing.assert_allclose(found.points, expected.points)


def test_csv_that_returns_to_its_start_is_closed(tmp_path):
    (tmp_path / "square.csv").write_text("x,z\n0,0\n0,2\n2,2\n2,0\n0,0\n")
    path = read_path(tmp_path / "square.csv")
    assert path.closed and path.length == pytest.approx(8.0)
    assert len(path.points) == round(8.0 / SPACING)


@pytest.mark.parametrize(
    ("text", "place", "value"),
    [
        ("x,z\n0,0\n1,one\n", "line 3", "'one'"),
        ("0,0\n1,nan\n", "line 2", "'nan'"),
        ("0,0\n1,inf\n", "line 2", "'inf'"),
        ("0,0,0\n1,1,1\n", "line 1", "3 columns"),
        ("0 0\n1 1\n", "line 1", "1 columns"),
        ("0,0\n\n1\n", "line 3", "1 columns"),
        ("x,1\n0,0\n1,1\n", "line 1", "'x'"),
        ("x,z\nx,z\n0,0\n", "line 2", "'x'"),
        ("", "rows", "0 points"),
        ("x,z\n1,1\n1,1\n", "rows", "2 points"),
    ],
)
def test_bad_csv_names_file_place_and_value(tmp_path, text, place, value):
    file = tmp_path / "bad.csv"
    file.write_text(text)
    error = assert_refused(lambda: read_path(file), file=file, place=place, value=value)
    assert str(error).startswith(f"{file}: {place}: {value}; ") and "\n" not in str(error)


def test_csv_must_be_utf_8_text(tmp_path):
    (tmp_path / "image.csv").write_bytes(b"0,0\n\xff\xfe\n")
    assert_refused(lambda: read_path(tmp_path / "image.csv"), place="byte 4")


@given(st.binary(max_size=60))
def test_any_bytes_are_read_or_raise_input_error(tmp_path_factory, data):
    file = tmp_path_factory.mktemp("paths") / "any.csv"
    file.write_bytes(data)
    try:
        assert np.isfinite(read_path(file).points).all()
    except InputError as error:
        assert str(file) in str(error)


@pytest.mark.parametrize(("shape", "size"), [("circle", 0.0), ("straight", -1.0), ("figure-eight", math.nan)])
def test_sizes_must_be_positive(shape, size):
    assert_refused(lambda: make_path(shape, size), file="path", place=shape, value=size)


def test_make_path_by_name_or_file(tmp_path):
    assert make_path("circle", -1.0).points[:, 0].min() == pytest.approx(-2.0, abs=CHORDS)
    assert make_path("straight").length == 10.0
    (tmp_path / "a.csv").write_text("0,0\n0,4\n")
    assert make_path(str(tmp_path / "a.csv")).length == 4.0
    assert_refused(lambda: make_path("spiral"), place="shape", value="spiral", rule_mentions="figure-eight")


@pytest.mark.parametrize("arguments", [{}, {"turn_rate": 0.0, "speed": 1.0}, {"radius": 1.0, "turn_rate": 1.0}])
def test_circle_needs_radius_or_turn_rate(arguments):
    with pytest.raises(ValueError, match="circle"):
        circle(**arguments)
