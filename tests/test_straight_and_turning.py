"""The parts of a long take that are learned from and judged on: straight frames, and a part for every turn."""

from __future__ import annotations

import numpy as np
import pytest

from experiments.common.straight_and_turning import (
    LEAST_PIECE,
    LEAST_SPEED,
    MARGIN_SECONDS,
    Travel,
    cut_parts,
    straight_frames,
    travel_of,
    turns_of,
)
from pfnn_jax.evaluation.turning_judge import TURNING
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.synthetic.walks import synthesise

FPS = 60.0
SMOOTHED = 1.0  # seconds from the edge of a turn within which the smoothed facing turns: three standard deviations


def travel(*pieces: tuple[float, float]) -> Travel:
    """Returns travel at 1 m/s of pieces of (seconds, degrees per second)."""
    rate = np.concatenate([np.full(round(seconds * FPS), np.deg2rad(turn)) for seconds, turn in pieces])
    return Travel(rate, np.ones(len(rate)), FPS)


@pytest.fixture(scope="module")
def walk() -> LabelledClip:
    """Returns 4 s ahead, 2 s to the left by 90 degrees, 4 s ahead, 2 s to the right, and 4 s ahead."""
    seconds_and_rates = [(4.0, 0.0), (2.0, 45.0), (4.0, 0.0), (2.0, -45.0), (4.0, 0.0)]
    rate = np.concatenate([np.full(round(seconds * FPS), np.deg2rad(turn)) for seconds, turn in seconds_and_rates])
    return LabelledClip(*synthesise("neutral", rate, np.full(len(rate), 1.2)))


def test_straight_frames_come_first_and_do_not_turn(walk):
    moves = travel_of(walk)
    frames = straight_frames(moves, 5.0)
    assert len(frames) == 5 * FPS and (np.diff(frames) > 0).all()
    assert (np.abs(moves.rate[frames]) < TURNING).all()
    assert frames[-1] < (4.0 + 2.0 + 4.0) * FPS
    assert not ((frames > (4.0 + SMOOTHED) * FPS) & (frames < (6.0 - SMOOTHED) * FPS)).any()


def test_every_turn_has_one_part_with_its_margins(walk):
    parts = turns_of(travel_of(walk), np.zeros(0, int))
    assert len(parts) == 2
    for (start, stop), turn in zip(parts, (4.0, 10.0), strict=True):
        assert (turn - MARGIN_SECONDS - SMOOTHED) * FPS <= start < turn * FPS
        assert (turn + 2.0) * FPS < stop <= (turn + 2.0 + MARGIN_SECONDS + SMOOTHED) * FPS


def test_no_part_holds_a_learned_frame(walk):
    moves = travel_of(walk)
    learned = straight_frames(moves, 8.0)
    parts = turns_of(moves, learned)
    assert len(parts) == 2
    assert not any(np.isin(np.arange(*part), learned).any() for part in parts)


def test_parts_keep_the_motion_and_the_phase_of_their_frames(walk):
    ((start, stop),) = turns_of(travel_of(walk), np.arange(round(8.0 * FPS)))
    (part,) = cut_parts(walk, [(start, stop)])
    assert part.world is not None and part.clip.num_frames == stop - start
    np.testing.assert_array_equal(part.clip.root_positions, walk.clip.root_positions[start:stop])
    np.testing.assert_array_equal(part.labels.phase, walk.labels.phase[start:stop])


def test_turn_that_was_learned_from_is_not_judged_on():
    moves = travel((3.0, 0.0), (2.0, 45.0), (3.0, 0.0), (2.0, 45.0), (3.0, 0.0))
    assert turns_of(moves, np.array([round(4.0 * FPS)])) == [(round(7.0 * FPS), round(11.0 * FPS))]


def test_small_turns_and_turns_on_the_spot_are_not_judged_on():
    assert turns_of(travel((3.0, 0.0), (1.0, 40.0), (3.0, 0.0)), np.zeros(0, int)) == []
    moves = travel((3.0, 0.0), (2.0, 45.0), (3.0, 0.0))
    still = Travel(moves.rate, np.full_like(moves.speed, LEAST_SPEED / 2), FPS)
    assert turns_of(still, np.zeros(0, int)) == [] and len(straight_frames(still, 5.0)) == 0


def test_change_from_one_turn_into_another_is_not_straight():
    moves = travel((2.0, 45.0), (LEAST_PIECE / 2, 0.0), (2.0, -45.0))
    assert len(straight_frames(moves, 5.0)) == 0 and len(turns_of(moves, np.zeros(0, int))) == 2
