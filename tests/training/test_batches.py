"""Batches: rows and clips gathered on the device, in host memory or in several draws at once are the same."""

from __future__ import annotations

import jax
import numpy as np
import pytest

from pfnn_jax.motion.datasets.splits import row_windows
from pfnn_jax.motion.features.layout import mason2018, mason2022
from pfnn_jax.training.config import num_clip_columns
from pfnn_jax.training.data import (
    clip_columns,
    make_gather,
    window_rows,
)
from pfnn_jax.training.order import order_of
from tests.training.toy import LAYOUT, assert_bitwise, body_rows


def test_a_clip_holds_the_joint_columns_in_stored_order():
    layout = mason2022(25)
    assert clip_columns(layout) == slice(48, 348)
    assert num_clip_columns(layout) == 300
    assert clip_columns(mason2018(31)) == slice(48, 234)
    assert clip_columns(LAYOUT) == slice(2, 5)


def test_a_short_window_is_padded_by_its_last_row():
    windows = row_windows(np.arange(5)) + [[7, 0]]
    np.testing.assert_array_equal(window_rows(windows, 8), [[7, 8, 9, 10, 11, 11, 11, 11]])


@pytest.mark.parametrize("layout", ["mason2022", "mason2022_pfnn"])
def test_gathering_on_the_device_and_on_the_host_is_the_same(layout):
    data = body_rows(layout)
    draw = order_of(data, 4, seed=0, num_clips=2).draw(0, 6)
    together = data.gather(draw)
    assert together.clip is not None and together.clip.shape == (6, 2, 240, 36)
    gather = jax.jit(make_gather(data.layout))
    on_device = data.on_device()
    for step in range(6):
        one = jax.tree.map(lambda leaf, i=step: leaf[i], draw)
        assert_bitwise(gather(on_device, one), jax.tree.map(lambda leaf, i=step: leaf[i], together))


def test_clips_are_rows_of_their_own_style():
    data = body_rows()
    marked = data.parts[0].x.copy()
    marked[:] = np.searchsorted(data.first_row, np.arange(len(marked)), side="right")[:, None]
    order = order_of(data, 4, seed=0, num_clips=3)
    for step in range(9):
        draw = order.draw(step, 1)
        clips = marked[window_rows(draw.windows, 240)]
        assert set(np.unique(clips)) == {step % 3 + 1}
        assert set(np.unique(marked[draw.rows])) == {step % 3 + 1}
