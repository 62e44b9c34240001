"""The share of a distance that a method closes: its anchors, its interval, and what counts."""

from __future__ import annotations

import numpy as np
import pytest

from pfnn_jax.evaluation.share_closed import share_closed

EXACT = 1e-9


def distances(mean: float, takes: int = 18, seeds: int = 1, seed: int = 0) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {style: mean + 0.3 * rng.normal(size=(seeds, takes)) for style in ("a", "b")}


def test_anchors_close_nothing_and_everything():
    none, full = distances(6.0), distances(3.0, seed=1)
    for method, expected in ((none, 0.0), (full, 1.0)):
        found = share_closed(none, full, method)
        assert found.share == pytest.approx(expected) and found.low == found.high == pytest.approx(expected)


def test_interval_contains_the_share_and_shrinks_with_more_takes():
    widths = []
    for takes in (6, 60):
        found = share_closed(*(distances(mean, takes, 3, i) for i, mean in enumerate((6.0, 3.0, 4.0))))
        assert found.low < found.share < found.high and found.share == pytest.approx(2 / 3, abs=0.1)
        widths.append(found.high - found.low)
    assert widths[1] < 0.5 * widths[0]


def test_what_takes_have_in_common_does_not_widen_the_interval():
    hard = {style: 2.0 * np.arange(18.0) for style in ("a", "b")}
    shifted = [{style: mean + own for style, own in hard.items()} for mean in (6.0, 3.0, 4.0)]
    found = share_closed(*shifted)
    assert found.high - found.low < EXACT and found.share == pytest.approx(2 / 3)


def test_styles_count_equally_whatever_their_number_of_takes():
    none, full = ({"a": np.full(2, x), "b": np.full(20, x)} for x in (4.0, 2.0))
    method = {"a": np.full(2, 2.0), "b": np.full(20, 4.0)}
    assert share_closed(none, full, method).share == pytest.approx(0.5)


def test_shares_of_different_takes_are_refused():
    none, full = distances(6.0), distances(3.0)
    with pytest.raises(ValueError, match="same styles"):
        share_closed(none, full, {"a": none["a"]})
    with pytest.raises(ValueError, match="shape"):
        share_closed(none, full, distances(4.0, takes=5))
