"""Laws of a character under an artificial clock: time, independence, input, styles, recordings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.viewer.page.character import CATCH_UP, FASTEST, RUN, TURN_RATE, Character
from pfnn_jax.viewer.page.drive_input import FIRST_HOLD, HOLD, TOGETHER, DriveInput, HeldKeys
from pfnn_jax.viewer.page.recording import LONGEST, Recording, bvh_bytes
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.view import SPEED_SPAN, RootHistory, View, phase_dials
from tests.raising import assert_refused

FRAME = 1.0 / 60.0
SOON = 1e-6  # seconds before or after a moment
WRITTEN = 1e-4  # metres: a file's six decimals of degrees along a body's bones, in single precision
SMOOTH = 0.1  # largest change of a style's weight in one frame


@pytest.fixture(scope="module")
def library(played_run) -> RunLibrary:
    return RunLibrary([played_run])


def play(character: Character, seconds: float, keys: str = "", start: float = 0.0, every: int = 1) -> list[View]:
    """Returns the view of every `every`th frame while keys repeat 30 times a second, from second `start` on."""
    views = [character.advance(start)]
    for frame in range(1, round(seconds * 60) + 1):
        now = start + frame * FRAME
        if frame % 2 == 1:
            for key in keys:
                character.press(key, False, now - 0.5 * FRAME)
        if frame % every == 0:
            views.append(character.advance(now))
    return views


# Keys whose releases are not known


def held(keys: HeldKeys, now: float) -> tuple[float, float, float]:
    drive = keys.drive_input(now)
    return drive.ahead, drive.left, drive.turn


def test_a_key_counts_as_held_until_it_would_have_repeated():
    keys = HeldKeys()
    keys.press("w", False, 10.0)
    assert held(keys, 10.0) == held(keys, 10.0 + FIRST_HOLD - SOON) == (1.0, 0.0, 0.0)
    assert held(keys, 10.0 + FIRST_HOLD + SOON) == (0.0, 0.0, 0.0)


def test_a_repeating_key_is_released_soon_after_its_last_press():
    keys, last = HeldKeys(), 0.0
    for last in (0.0, 0.5, *np.arange(0.53, 2.0, 0.033)):
        keys.press("A", False, last)
        assert held(keys, last + 0.03) == (0.0, 1.0, 0.0)
    assert held(keys, last + HOLD - SOON) == (0.0, 1.0, 0.0)
    assert held(keys, last + HOLD + SOON) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("first", "second", "apart", "drive"),
    [
        ("w", "s", 0.0, (-1.0, 0.0, 0.0)),  # opposites: the last one
        ("q", "e", 0.0, (0.0, 0.0, -1.0)),
        ("w", "q", 0.4, (1.0, 0.0, 1.0)),  # a chord, though W repeats no more
        ("e", "d", 0.4, (0.0, -1.0, -1.0)),
        ("w", "d", TOGETHER / 2, (np.sqrt(0.5), -np.sqrt(0.5), 0.0)),  # a diagonal
        ("w", "d", 2 * TOGETHER, (0.0, -1.0, 0.0)),  # one after the other
    ],
)
def test_two_keys_form_chords_and_diagonals_or_replace_each_other(first, second, apart, drive):
    keys = HeldKeys()
    keys.press(first, False, 0.0)
    for now in (apart, *np.arange(apart + 0.5, 2.0, 0.033)):
        keys.press(second, False, now)
    np.testing.assert_allclose(held(keys, 2.0), drive, atol=1e-12)
    assert keys.drive_input(2.0 + FIRST_HOLD) == DriveInput()


def test_shift_is_taken_from_the_last_press_and_other_keys_are_refused():
    keys = HeldKeys()
    keys.press("w", True, 0.0)
    assert keys.drive_input(0.1).run
    keys.press("w", False, 0.5)
    assert not keys.drive_input(0.6).run
    with pytest.raises(ValueError, match="`key` must be one of"):
        keys.press("x", False, 1.0)
    keys.clear()
    assert not keys.drive_input(0.6).moves


# Time


def test_motion_does_not_depend_on_how_often_it_is_advanced(library):
    often, seldom = Character(library), Character(library)
    one, three = play(often, 1.5, "wq"), play(seldom, 1.5, "wq", start=1000.0, every=3)
    assert one[-1].frame == three[-1].frame == 90
    for view, other in zip(one[::3], three, strict=True):
        np.testing.assert_array_equal(view.joints, other.joints)
        assert view.heading == other.heading
    assert one[-1].steps_per_second == three[-1].steps_per_second == 60.0


def test_steps_missed_in_a_long_pause_are_skipped(library):
    character = Character(library)
    assert character.advance(0.0).frame == 0
    assert character.advance(100.0).frame == CATCH_UP
    assert character.advance(100.0 + FRAME).frame == CATCH_UP + 1
    assert character.advance(50.0).frame == CATCH_UP + 1  # time that goes backwards takes no step


def test_characters_are_independent(library):
    alone = play(Character(library), 0.5, "w")[-1]
    one, other = Character(library), Character(library, style="proud")
    for frame in range(1, 31):
        other.press("s", True, frame * FRAME)
        other.advance(frame * FRAME)
    together = play(one, 0.5, "w")[-1]
    np.testing.assert_array_equal(together.joints, alone.joints)
    assert np.abs(other.advance(31 * FRAME).joints - alone.joints).max() > 1e-3


# Keys and stick


def test_w_walks_along_the_heading_and_q_turns_it(library):
    character = Character(library)
    walked = play(character, 2.0, "w")[-1]
    assert (
        walked.wanted_speed > 0.3 and np.linalg.norm(walked.joints[0] - Character(library).advance(0.0).joints[0]) > 0.2
    )
    np.testing.assert_allclose(walked.future_positions[0], walked.past_positions[-1])
    assert np.linalg.norm(walked.future_positions[-1] - walked.root) > 0.2
    standing = play(Character(library), 0.5, "")[-1]
    np.testing.assert_array_equal(standing.future_positions, np.tile(standing.root, (6, 1)))
    before = character.advance(2.0).heading
    turned = play(Character(library), 0.5, "q")[-1]
    assert before == 0.0 and turned.wanted_speed == 0.0
    np.testing.assert_allclose(turned.heading, 29 * FRAME * TURN_RATE, atol=2 * FRAME * TURN_RATE)


def test_the_speed_is_the_natural_one_unless_it_is_set(library):
    character = Character(library, style="proud")
    own = library.get(character.run).speeds["proud"]
    character.set_stick(0.5, 0.0)
    character.advance(0.0)
    np.testing.assert_allclose(character.advance(FRAME).wanted_speed, 0.5 * own)
    character.set_speed(0.8)
    character.set_stick(3.0 / 5.0, 4.0 / 5.0, run=True)
    np.testing.assert_allclose(character.advance(2 * FRAME).wanted_speed, 0.8 * RUN)
    character.press("w", False, 2.5 * FRAME)  # keys take precedence over the stick
    np.testing.assert_allclose(character.advance(3 * FRAME).wanted_speed, 0.8)
    for wrong in (0.0, -1.0, np.nan, 2 * FASTEST):
        with pytest.raises(ValueError, match="`speed` must be"):
            character.set_speed(wrong)
    with pytest.raises(ValueError, match="DriveInput must be"):
        character.set_stick(np.nan, 0.0)


def test_reset_returns_to_the_initial_state(library):
    character = Character(library)
    begin = character.advance(0.0)
    play(character, 1.0, "we")
    character.reset()
    after = character.advance(1.0)
    np.testing.assert_array_equal(after.joints, begin.joints)
    assert after.heading == 0.0 and character.advance(1.0 + FRAME).wanted_speed == 0.0


# Styles


def test_styles_change_smoothly(library):
    character = Character(library, style="neutral")
    views = play(character, 0.2, "w")
    character.choose(character.run, "proud")
    views += play(character, 1.0, "w", start=0.2)[1:]
    character.mix(["proud", "neutral", "depressed"], [0.2, 0.3, 0.5])
    views += play(character, 2.0, "w", start=1.2)[1:]
    shares = np.array(
        [[view.style_weights.get(name, 0.0) for name in library.get(character.run).styles] for view in views]
    )
    assert np.abs(np.diff(shares, axis=0)).max() < SMOOTH
    np.testing.assert_allclose(shares[-1], [0.5, 0.3, 0.2], atol=0.01)
    assert views[0].style_weights == {"neutral": 1.0}


@pytest.mark.parametrize(
    ("names", "weights"),
    [
        (["proud", "none"], [0.5, 0.5]),
        (["proud", "neutral"], [0.5, 0.6]),
        (["proud", "neutral"], [1.5, -0.5]),
        (["proud"], [np.nan]),
        (["proud"], [0.5, 0.5]),
        ([], []),
    ],
)
def test_invalid_mixtures_and_runs_change_nothing(library, names, weights):
    character = Character(library, style="proud")
    with pytest.raises(InputError):
        character.mix(names, weights)
    assert_refused(lambda: character.choose("../elsewhere", "proud"), place="run")
    assert character.shares == {"proud": 1.0}


# Recordings


def test_a_recording_equals_what_was_shown(library, tmp_path):
    character = Character(library)
    play(character, 0.2, "w")
    assert character.stop_recording() is None
    character.start_recording()
    views = play(character, 1.0, "wq", start=0.2)[1:]
    assert views[-1].recorded_seconds == pytest.approx(1.0)
    clip = character.stop_recording()
    assert clip is not None and clip.num_frames == 60 and character.advance(1.3).recorded_seconds is None
    path = Path(tmp_path) / "played.bvh"
    path.write_bytes(bvh_bytes(clip))
    read = read_bvh(path, unit=0.01)
    joints, _ = forward_kinematics(read.skeleton, read.root_positions, read.rotations)
    order = [clip.skeleton.names.index(name) for name in read.skeleton.names]
    shown = np.stack([view.joints for view in views])[:, order]
    assert read.fps == 60.0
    np.testing.assert_allclose(joints, shown, atol=WRITTEN)


def test_reset_ends_a_recording(library):
    character = Character(library)
    play(character, 1.0, "w")
    character.start_recording()
    shown = play(character, 1.0, "w", start=1.0)[1:]
    character.reset()
    after = play(character, 0.5, "w", start=2.0)[-1]
    assert after.recorded_seconds == shown[-1].recorded_seconds == pytest.approx(1.0)
    assert shown[-1].recording and not after.recording
    clip = character.stop_recording()
    assert clip is not None and clip.num_frames == 60
    character.start_recording()  # the next one starts empty
    assert play(character, 0.1, "w", start=2.5)[-1].recording
    clip = character.stop_recording()
    assert clip is not None and clip.num_frames == 6


def test_a_new_recording_discards_a_waiting_one(library):
    character = Character(library)
    character.start_recording()
    play(character, 0.2, "w")
    character.reset()
    character.start_recording()
    assert character.advance(0.2).recorded_seconds == 0.0
    assert character.stop_recording() is None


def test_a_recording_has_a_greatest_length(library):
    skeleton = library.get(library.runs[0]).run.skeleton
    recording = Recording(skeleton, 60.0, "style", "run")
    assert recording.clip() is None
    pose = np.tile(np.array([1.0, 0.0, 0.0, 0.0]), (skeleton.num_joints, 1))
    for _ in range(round(LONGEST * 60) + 5):
        recording.add(np.zeros(3), pose)
    assert recording.seconds == LONGEST and not recording.open


# What is shown


def test_a_root_history_gives_past_positions_and_speed():
    ahead, metres = np.array([0.0, 1.0]), 0.02
    history = RootHistory(np.zeros(2), ahead, 60.0)
    assert history.speed == 0.0
    np.testing.assert_array_equal(history.positions, np.zeros((6, 2)))
    for step in range(1, 101):
        history.add(step * metres * ahead, ahead)
        np.testing.assert_allclose(history.speed, 60.0 * metres)
    np.testing.assert_allclose(history.positions[:, 1], metres * np.arange(50, 101, 10))
    np.testing.assert_array_equal(history.directions, np.tile(ahead, (6, 1)))
    np.testing.assert_array_equal(history.root, history.positions[-1])
    for step in range(1, SPEED_SPAN + 1):
        history.add(history.root, ahead)
        np.testing.assert_allclose(history.speed, 60.0 * metres * (1.0 - step / SPEED_SPAN), atol=1e-12)


def test_a_phase_is_shown_modulo_a_cycle(library):
    layout = library.get(library.runs[0]).run.layout
    (dial,) = phase_dials(layout, np.asarray(7.0))
    np.testing.assert_allclose((dial.angle, dial.amplitude), (7.0 - 2 * np.pi, 1.0))
