"""Laws of the clock that says which steps of a simulation are due."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.viewer.page.character import CATCH_UP, Clock

FPS = 60.0
STEP = 1.0 / FPS
EXACT = 1e-9  # seconds: quotients of a few seconds, in double precision
ROUNDED = 2e-6 / FPS  # seconds by which a step may be early, and as much again for the sum of the pauses


def read(clock: Clock, times: list[float]) -> list[float]:
    return [moment for now in times for moment in clock.due(now)]


def test_the_first_call_starts_the_clock():
    clock = Clock(FPS)
    assert clock.due(1234.5) == [] and clock.rate == 0.0
    np.testing.assert_allclose(clock.due(1234.5 + 3 * STEP), 1234.5 + STEP * np.arange(1, 4), atol=EXACT)


@given(st.floats(0.0, 1e4), st.lists(st.floats(0.0, CATCH_UP * STEP), max_size=60))
def test_steps_are_equal_whenever_the_clock_is_read(begin, pauses):
    times = [float(time) for time in begin + np.cumsum([0.0, *pauses])]
    clock = Clock(FPS)
    moments = []
    for now in times:
        new = clock.due(now)
        assert len(new) <= CATCH_UP and all(moment <= now + ROUNDED for moment in new)
        moments += new
        assert now - (moments[-1] if moments else begin) < STEP + ROUNDED  # no step that is due is omitted
    np.testing.assert_allclose(moments, begin + STEP * np.arange(1, len(moments) + 1), atol=EXACT * 10)


def test_after_a_long_pause_only_the_last_steps_are_due():
    clock = Clock(FPS)
    clock.due(0.0)
    moments = clock.due(100.0)
    np.testing.assert_allclose(moments, 100.0 - STEP * np.arange(CATCH_UP)[::-1], atol=EXACT)
    np.testing.assert_allclose(clock.due(100.0 + STEP), [100.0 + STEP], atol=EXACT)


def test_time_that_goes_backwards_repeats_no_step():
    clock = Clock(FPS)
    before = read(clock, [0.0, 0.05, 0.1])
    assert read(clock, [0.02, 0.0, 0.1]) == []
    after = clock.due(0.1 + STEP)
    np.testing.assert_allclose([*before, *after], STEP * np.arange(1, 8), atol=EXACT)


@pytest.mark.parametrize("every", [1, 2, 5])
def test_the_rate_counts_the_steps_of_the_last_second(every):
    clock = Clock(FPS)
    read(clock, [every * frame * STEP for frame in range(240 // every)])
    assert clock.rate == FPS
    clock.due(100.0)
    assert clock.rate == CATCH_UP
