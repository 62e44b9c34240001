"""Laws of the moves of a style that an engine's blend tree is given."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from pfnn_jax.control.controller import Controller, make_controller
from pfnn_jax.control.controller_state import style_speed
from pfnn_jax.control.moves import CURVE, MOVES, SPOT, Move, MoveClips, at_origin, make_moves
from pfnn_jax.motion.clip import move_clip
from pfnn_jax.motion.cycles import cut_cycle
from pfnn_jax.motion.ground import yaw_of
from pfnn_jax.motion.kinematics import quat_conjugate, quat_from_yaw, quat_multiply
from pfnn_jax.motion.root_motion import in_place, is_cycle
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.trajectory import root_motion
from pfnn_jax.motion.world_motion import world_motion
from pfnn_jax.run import Run
from tests.trained import walking_run

RATE = 0.3
"""Relative to the commanded speed or turn: controllers reach it within 20 % over seconds, a cycle within this."""

FACING = np.deg2rad(30.0)
"""Shoulders and hips swing about the direction of a clip in place."""

DRIFT = 0.3
"""Metres per second at which a character may leave its place while it turns there; a walk has 0.8 and more."""

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


def test_walks_and_turns_are_made(moves: MoveClips):
    assert {"idle", "walk", "walk_left", "walk_right", "turn_left", "turn_right"} <= {*moves.clips}


def test_a_note_names_the_move_and_what_the_character_does_instead(moves: MoveClips):
    """The data has no side steps."""
    left_out = {note.split(" ", 1)[0]: note for note in moves.notes}
    assert {*left_out} == {"strafe_left", "strafe_right", "backward"}
    assert all("degrees" in note and any(map(str.isdigit, note)) for note in left_out.values())


def test_every_move_closes_and_begins_at_the_origin(moves: MoveClips):
    for clip in moves.clips.values():
        assert is_cycle(clip)
        assert np.abs(clip.root_positions[0, [0, 2]]).max() < LATERAL


def test_a_move_in_place_faces_ahead(moves: MoveClips):
    for clip in map(in_place, moves.clips.values()):
        motion = world_motion(clip)
        facing = root_motion(motion.positions, motion.roles, clip.fps).facing
        assert np.abs(yaw_of(facing)).max() < FACING


def test_a_walk_goes_ahead_at_the_speed_of_its_style(moves: MoveClips, controller: Controller):
    speed = float(style_speed(controller.params, jnp.asarray(controller.style_weights("neutral"))).natural)
    x, z = travel(moves, "walk")
    assert abs(x) < LATERAL
    assert z == pytest.approx(speed, rel=RATE)


def test_curves_turn_to_their_side(moves: MoveClips):
    assert turned(moves, "walk_left") == pytest.approx(CURVE, rel=RATE)
    assert turned(moves, "walk_right") == pytest.approx(-CURVE, rel=RATE)


def test_turns_on_the_spot_turn_to_their_side_and_stay(moves: MoveClips):
    for name, rate in (("turn_left", SPOT), ("turn_right", -SPOT)):
        assert turned(moves, name) == pytest.approx(rate, rel=RATE)
        assert np.linalg.norm(travel(moves, name)) < DRIFT


def test_a_move_that_turns_too_little_is_left_out(run: Run, controller: Controller, monkeypatch: pytest.MonkeyPatch):
    """No network follows a command to turn five times a second."""
    monkeypatch.setattr("pfnn_jax.control.moves.MOVES", {"idle": MOVES["idle"], "whirl": Move(turn_rate=10 * np.pi)})
    made = make_moves(controller, controller.style_weights("neutral"), run)
    assert [*made.clips] == ["idle"]
    assert made.notes[0].startswith("whirl is left out: it turns at")


@pytest.mark.parametrize(
    ("name", "way"),
    [("walk", (0.0, 1.0)), ("strafe_left", (1.0, 0.0)), ("strafe_right", (-1.0, 0.0)), ("backward", (0.0, -1.0))],
)
def test_a_straight_move_travels_along_its_heading(name: str, way: tuple[float, float]):
    """Whichever way the cycle that it is made from goes."""
    frames = np.zeros(240)
    cycle = cut_cycle(synthesise("neutral", frames, frames + 1.2)[0])
    moved = at_origin(move_clip(cycle, quat_from_yaw(2.0), np.array([3.0, 0.0, -1.0])), MOVES[name])
    step = (moved.root_positions[-1] - moved.root_positions[0])[[0, 2]]
    assert np.abs(step / np.linalg.norm(step) - way).max() < LATERAL
    assert np.abs(moved.root_positions[0, [0, 2]]).max() < LATERAL


def test_idle_stays_where_it_is(moves: MoveClips):
    assert np.abs(travel(moves, "idle")).max() < 0.01
