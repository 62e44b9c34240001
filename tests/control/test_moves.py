"""Laws of the moves of a style that an engine's blend tree is given."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.controller import Controller, make_controller
from pfnn_jax.control.controller_state import style_speed
from pfnn_jax.control.moves import CURVE, MOVES, MoveClips, make_moves
from pfnn_jax.motion.kinematics import quat_conjugate, quat_multiply
from pfnn_jax.run import Run
from tests.motion.retargeting import angles
from tests.trained import walking_run

CLOSED = 1e-5  # degrees, rounding
RATE = 0.3
"""Relative to the commanded speed or turn: controllers reach it within 20 % over seconds, a cycle within this."""

LATERAL = 1e-6
"""Metres; a straight move travels along its heading exactly."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return walking_run(tmp_path_factory)


@pytest.fixture(scope="module")
def controller(run: Run) -> Controller:
    return make_controller(run)


@pytest.fixture(scope="module")
def moves(run: Run, controller: Controller) -> MoveClips:
    return make_moves(controller, controller.style_weights("neutral"), run)


def travel(moves: MoveClips, name: str) -> np.ndarray:
    """Returns x and z [2] in metres per second."""
    clip = moves.clips[name]
    return (clip.root_positions[-1] - clip.root_positions[0])[[0, 2]] * clip.fps / (clip.num_frames - 1)


def turned(moves: MoveClips, name: str) -> float:
    """Returns radians per second about +Y, positive to the left."""
    clip = moves.clips[name]
    w, _, y, _ = quat_multiply(clip.rotations[-1, 0], quat_conjugate(clip.rotations[0, 0]))
    return 2 * np.arctan2(y, w) * clip.fps / (clip.num_frames - 1)


def test_every_move_is_made_or_named(moves: MoveClips):
    left_out = {note.split(" ", 1)[0] for note in moves.notes}
    assert {*moves.clips} | left_out == {*MOVES}
    assert not {*moves.clips} & left_out
    assert {"idle", "walk", "walk_left", "walk_right"} <= {*moves.clips}


def test_every_move_closes(moves: MoveClips):
    for clip in moves.clips.values():
        assert angles(clip.rotations[-1, 1:], clip.rotations[0, 1:]).max() < CLOSED
        assert np.abs(clip.root_positions[0, [0, 2]]).max() < LATERAL


def test_a_walk_goes_ahead_at_the_speed_of_its_style(moves: MoveClips, controller: Controller):
    speed = float(style_speed(controller.params, jnp.asarray(controller.style_weights("neutral"))).natural)
    x, z = travel(moves, "walk")
    assert abs(x) < LATERAL
    assert z == pytest.approx(speed, rel=RATE)


def test_curves_turn_to_their_side(moves: MoveClips):
    assert turned(moves, "walk_left") == pytest.approx(CURVE, rel=RATE)
    assert turned(moves, "walk_right") == pytest.approx(-CURVE, rel=RATE)


def test_idle_stays_where_it_is(moves: MoveClips):
    assert np.abs(travel(moves, "idle")).max() < 0.01
