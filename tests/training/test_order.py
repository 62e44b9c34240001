"""Style cycling: one style per batch, all in turn, every style through shuffled passes of its own length."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.training.order import StepOrder, order_of
from tests.training.toy import body_rows

LENGTHS = (11, 23, 8)


def order(lengths=LENGTHS, batch_size=4, seed=0) -> StepOrder:
    return StepOrder(np.cumsum([0, *lengths]), batch_size, seed)


def test_an_epoch_is_one_pass_of_the_shortest_style():
    assert order().steps_per_epoch == 3 * 2
    assert order((23104,) * 8, 32).steps_per_epoch == 5776


def test_a_style_shorter_than_a_batch_is_refused():
    with pytest.raises(ValueError, match="`batch_size` must be at most the 8 rows of a style, got 9"):
        order(batch_size=9)


@given(
    lengths=st.lists(st.integers(4, 30), min_size=1, max_size=4),
    batch_size=st.integers(1, 4),
    seed=st.integers(0, 2**31 - 1),
)
def test_every_row_is_seen_at_most_once_in_a_pass_of_its_style(lengths, batch_size, seed):
    found = order(tuple(lengths), batch_size, seed)
    for style, count in enumerate(lengths):
        batches = count // batch_size
        for number in range(2):
            steps = [style + len(lengths) * (number * batches + b) for b in range(batches)]
            seen = np.concatenate([found.rows(step) for step in steps])
            assert len(set(seen)) == batches * batch_size
            assert found.first_row[style] <= seen.min() and seen.max() < found.first_row[style + 1]


def test_every_row_is_seen_where_batches_fill_the_style():
    found = order((12, 8))
    assert set(np.concatenate([found.rows(step) for step in (0, 2, 4)])) == set(range(12))


def test_every_window_of_as_many_steps_as_styles_holds_each_style_once():
    found = order()
    owner = [set(np.searchsorted(found.first_row, found.rows(step), side="right") - 1) for step in range(20)]
    assert owner == [{step % 3} for step in range(20)]


def test_passes_differ_and_styles_are_shuffled_apart():
    found = order((8, 8))
    first, second, other = (np.concatenate([found.rows(s), found.rows(s + 2)]) for s in (0, 4, 1))
    assert sorted(first) == sorted(second) and not np.array_equal(first, second)
    assert not np.array_equal(first, other - 8)


def test_a_step_depends_on_the_seed_and_its_number_alone():
    np.testing.assert_array_equal(order().draw(7, 5).rows, order().draw(0, 12).rows[7:])
    assert not np.array_equal(order().rows(0), order(seed=1).rows(0))


def test_clips_are_drawn_independently_of_the_frames():
    data = body_rows()
    few, many = order_of(data, 4, 0, num_clips=1), order_of(data, 8, 0, num_clips=1)
    np.testing.assert_array_equal(few.draw(0, 30).windows, many.draw(0, 30).windows)
    found = np.concatenate([few.clips(step) for step in range(0, 60, 3)])
    assert data.first_window is not None
    assert len(np.unique(found[:, 0])) == data.first_window[1]  # all windows of the first style


def test_clips_need_windows():
    with pytest.raises(ValueError, match="`windows` are needed"):
        StepOrder(np.array([0, 8]), 4, 0, num_clips=1)
