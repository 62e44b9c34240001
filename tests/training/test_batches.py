"""Style cycling: one style per batch, all styles in turn, every frame at most once an epoch."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.training.batches import Batch, epoch_order, gather, steps_per_epoch
from tests.training.toy import assert_bitwise, toy_data

SIZES = {"num_styles": 3, "num_frames": 11, "batch_size": 4}


def order(seed: int = 0, epoch: int = 0, **sizes) -> np.ndarray:
    return np.asarray(epoch_order(jax.random.key(seed), jnp.int32(epoch), **(sizes or SIZES)))


def test_steps_per_epoch_drops_the_last_incomplete_batch():
    assert steps_per_epoch(3, 11, 4) == 6
    assert steps_per_epoch(8, 23104, 32) == 5776


def test_a_style_shorter_than_a_batch_is_refused():
    with pytest.raises(ValueError, match="`batch_size` must be at most the 11 frames of a style, got 12"):
        steps_per_epoch(3, 11, 12)


@pytest.mark.parametrize("sizes", [SIZES, {"num_styles": 1, "num_frames": 5, "batch_size": 5}])
@given(seed=st.integers(0, 2**31 - 1), epoch=st.integers(0, 10_000))
def test_every_frame_is_seen_at_most_once_an_epoch(sizes, seed, epoch):
    frames = order(seed, epoch, **sizes)
    assert frames.shape == (steps_per_epoch(**sizes), sizes["batch_size"])
    for style in range(sizes["num_styles"]):
        seen = frames[style :: sizes["num_styles"]].ravel()
        assert len(set(seen)) == len(seen)
        assert set(seen) <= set(range(sizes["num_frames"]))


def test_every_frame_is_seen_where_batches_fill_the_style():
    frames = order(num_styles=2, num_frames=12, batch_size=4)
    for style in range(2):
        assert set(frames[style::2].ravel()) == set(range(12))


def test_every_window_of_as_many_steps_as_styles_holds_each_style_once():
    data = toy_data(num_frames=11)
    marked = Batch(data.x, data.y, np.broadcast_to(np.arange(3.0)[:, None], (3, 11)))  # the style in place of the phase
    frames = order()
    styles = [np.asarray(gather(marked, step % 3, frames[step]).phase) for step in range(len(frames))]
    assert all(np.unique(batch).size == 1 for batch in styles)
    for start in range(len(frames) - 2):
        assert {batch[0] for batch in styles[start : start + 3]} == {0, 1, 2}


def test_epochs_differ_and_styles_are_shuffled_apart():
    assert not np.array_equal(order(epoch=0), order(epoch=1))
    frames = order()
    assert not np.array_equal(frames[0::3], frames[1::3])


def test_an_epoch_depends_on_the_key_and_its_number_alone():
    np.testing.assert_array_equal(order(3, 7), order(3, 7))
    assert not np.array_equal(order(3, 7), order(4, 7))


def test_gathering_on_the_device_and_on_the_host_is_the_same():
    data, frames = toy_data(), np.array([3, 0, 23])
    on_device = gather(jax.tree.map(jnp.asarray, data), jnp.int32(1), jnp.asarray(frames))
    assert_bitwise(on_device, gather(data, 1, frames))
    np.testing.assert_array_equal(on_device.y, data.y[1][frames])


def test_several_batches_are_gathered_at_once():
    data, frames = toy_data(), np.array([[3, 0, 23], [5, 6, 7]])
    batches = gather(data, np.array([2, 0])[:, None], frames)
    for i, style in enumerate((2, 0)):
        assert_bitwise(jax.tree.map(lambda leaf, i=i: leaf[i], batches), gather(data, style, frames[i]))
