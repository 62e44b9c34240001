"""Laws of the phase function: a cyclic Catmull-Rom spline through K control points."""

from __future__ import annotations

import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from jax.test_util import check_grads

from pfnn_jax.models.spline import catmull_rom_basis, evaluate_spline
from tests.models.helpers import normal

FLOAT32 = 2e-6  # a few ulp of a sum of four terms of size one
FLOAT64 = 1e-12  # the same in double precision, with the rounding of 2π·K
SEAM = 2e-5  # a phase of several turns loses log2(turns) of its 24 bits

CONTROL_POINTS = (4, 5, 8)
phases = st.floats(-50.0, 50.0, width=32)
points = st.sampled_from(CONTROL_POINTS)

compiled_basis = jax.jit(catmull_rom_basis, static_argnums=1)


def basis(num: int, phase: jax.Array | np.floating) -> jax.Array:
    return compiled_basis(phase, num)


def mason_2018(alphas: np.ndarray, p: float) -> np.ndarray:
    """Equation 1 of Mason 2018 as printed, for any number of control points, in double precision."""
    count = len(alphas)
    turns = count * p / (2 * math.pi)
    d = turns % 1.0  # Eq. 1b
    k = [(math.floor(turns) + n - 1) % count for n in range(4)]  # Eq. 1c
    return (  # Eq. 1a
        alphas[k[1]]
        + d * (0.5 * alphas[k[2]] - 0.5 * alphas[k[0]])
        + d**2 * (alphas[k[0]] - 2.5 * alphas[k[1]] + 2.0 * alphas[k[2]] - 0.5 * alphas[k[3]])
        + d**3 * (1.5 * alphas[k[1]] - 1.5 * alphas[k[2]] + 0.5 * alphas[k[3]] - 0.5 * alphas[k[0]])
    )


@pytest.mark.parametrize("num", CONTROL_POINTS)
def test_spline_equals_the_published_equation(num: int, float64: None):
    rng = np.random.default_rng(num)
    alphas, spline = rng.normal(size=(num, 3, 2)), jax.jit(evaluate_spline)
    for phase in rng.uniform(-10, 20, size=50):
        np.testing.assert_allclose(spline(jnp.asarray(alphas), phase), mason_2018(alphas, phase), atol=FLOAT64)


@given(points, phases)
def test_coefficients_sum_to_one(num: int, phase: float):
    assert np.asarray(basis(num, np.float32(phase))).sum() == pytest.approx(1.0, abs=FLOAT32)


@given(points, phases)
def test_at_most_four_neighbours_have_weight(num: int, phase: float):
    coefficients = np.asarray(basis(num, np.float32(phase)))
    assert coefficients.shape == (num,)
    assert np.count_nonzero(coefficients) <= 4


@given(points, phases, st.integers(-3, 3))
def test_basis_is_periodic(num: int, phase: float, turns: int):
    here = basis(num, np.float32(phase))
    there = basis(num, np.float32(phase + 2 * math.pi * turns))
    np.testing.assert_allclose(here, there, atol=SEAM * (1 + abs(phase) + abs(turns)))


@given(points, phases)
def test_rotating_the_control_points_shifts_the_phase(num: int, phase: float):
    step = 2 * math.pi / num
    here = basis(num, np.float32(phase))
    there = basis(num, np.float32(phase + step))
    np.testing.assert_allclose(np.roll(here, 1), there, atol=SEAM * (1 + abs(phase)))


@pytest.mark.parametrize("num", CONTROL_POINTS)
def test_passes_through_its_control_points(num: int, float64: None):
    knots = 2 * jnp.pi * jnp.arange(float(num)) / num
    np.testing.assert_allclose(jax.vmap(catmull_rom_basis, (0, None))(knots, num), np.eye(num), atol=FLOAT64)


@pytest.mark.parametrize("num", CONTROL_POINTS)
def test_derivatives_from_both_sides_agree_at_every_knot(num: int, float64: None):
    """The spline is continuously differentiable."""
    derivative = jax.vmap(jax.jacfwd(lambda p: catmull_rom_basis(p, num)))
    knots = 2 * jnp.pi * jnp.arange(float(num)) / num
    before, after = derivative(knots - 1e-9), derivative(knots + 1e-9)
    np.testing.assert_allclose(before, after, atol=1e-7)  # second derivatives are O(K²), times the gap of 2e-9
    central = 0.5 * (np.roll(np.eye(num), 1, axis=1) - np.roll(np.eye(num), -1, axis=1)) * num / (2 * np.pi)
    np.testing.assert_allclose(after, central, atol=1e-7)  # Catmull-Rom tangent: half the chord of the neighbours


@pytest.mark.parametrize("num", CONTROL_POINTS)
@pytest.mark.parametrize("phase", [0.3, 2.0, 6.2, -1.0])
def test_gradients_of_the_basis(num: int, phase: float, float64: None):
    check_grads(partial(basis, num), (jnp.asarray(phase),), order=2, modes=("fwd", "rev"))


@pytest.mark.parametrize("num", CONTROL_POINTS)
def test_gradients_of_the_spline(num: int, float64: None):
    alphas = normal(num, num, 3)
    check_grads(jax.jit(evaluate_spline), (alphas, jnp.asarray(0.7)), order=2, modes=("fwd", "rev"))


@pytest.mark.parametrize("num", CONTROL_POINTS)
def test_gradients_at_a_knot(num: int, float64: None):
    """At the knot itself only first derivatives exist."""
    check_grads(partial(basis, num), (jnp.asarray(0.0),), order=1, modes=("fwd", "rev"), eps=1e-7, atol=1e-5)


def test_integer_phase_equals_float_phase():
    np.testing.assert_allclose(catmull_rom_basis(jnp.asarray(1)), catmull_rom_basis(jnp.asarray(1.0)))


def test_keeps_the_dtype_of_the_phase():
    assert catmull_rom_basis(jnp.float32(0.1)).dtype == jnp.float32


def test_needs_no_gather_or_scatter():
    """Not every exchange format has them."""
    text = jax.jit(jax.vmap(lambda phase: catmull_rom_basis(phase, 5))).lower(jnp.zeros(7)).as_text()
    assert "gather" not in text and "scatter" not in text and "floor" in text


def test_three_control_points_are_refused():
    with pytest.raises(ValueError, match="`num_control_points` must be at least 4, got 3"):
        catmull_rom_basis(jnp.float32(0.0), 3)


def test_a_batch_of_phases_needs_vmap():
    with pytest.raises(AssertionError):
        catmull_rom_basis(jnp.zeros(2))
