"""Runs on stage: their names, and how a new style joins one without disturbing the others."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from pfnn_jax.control.calibration import settle
from pfnn_jax.control.controller import Controller, make_controller, step
from pfnn_jax.errors import InputError
from pfnn_jax.run import load_run, load_style, save_style
from pfnn_jax.viewer.page.actor import Actor, fitted
from pfnn_jax.viewer.page.stage import SPARE, Cast, Stage, joined, rehearse_walks
from pfnn_jax.viewer.page.view import View

FRAME = 1.0 / 60.0
SHARE = 1e-5
"""Relative: both are float32 quotients of the same numbers."""

HIPS = 1e-6
"""Metres: the same float32 numbers."""


@pytest.fixture(scope="module")
def two_runs(played_run, tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("stage")
    paths = folder / "one" / "run", folder / "two" / "run"
    for path in paths:
        shutil.copytree(played_run, path)
    return paths


@pytest.fixture(scope="module")
def stage(two_runs) -> Stage:
    return Stage(two_runs)


def walked(stage: Stage, style: str, frames: int = 20) -> np.ndarray:
    actor = Actor(stage, stage.runs[0], style)
    actor.set_stick(1.0, 0.0)
    actor.advance(0.0)
    return np.stack([actor.advance(frame * FRAME).joints for frame in range(1, frames)])


def compilations() -> list[int]:
    """How often a step, and a trial of walks, have been compiled."""
    return [getattr(function, "_cache_size")() for function in (step, settle)]  # noqa: B009 - under no public name


def test_runs_are_named_as_shortly_as_they_differ(stage, two_runs):
    assert stage.runs == ("one/run", "two/run")
    assert stage.cast("two/run").run.path == two_runs[1]
    assert stage.styles[:3] == [("one/run", name) for name in ("depressed", "neutral", "proud")]


def test_what_cannot_be_played_is_refused(two_runs, tmp_path):
    for paths in ([], [tmp_path], [two_runs[0], two_runs[0]]):
        with pytest.raises(InputError):
            Stage(paths)


def test_a_character_of_another_run_stands_where_the_last_one_was(stage):
    actor = Actor(stage, "one/run")
    actor.set_stick(1.0, 0.0, turn=0.3)
    for frame in range(90):
        actor.advance(frame * FRAME)
    before = actor.advance(90 * FRAME)
    actor.choose("two/run", "proud")
    after = actor.advance(90 * FRAME)
    assert after.run == "two/run" and after.style_weights == {"proud": 1.0}
    assert np.linalg.norm(before.root) > 0.05
    assert np.linalg.norm(after.root - before.root) < 0.1
    assert after.heading == before.heading
    assert float(after.facing @ before.facing) > np.cos(np.radians(3.0))


def test_a_recording_ends_with_its_run_for_good(stage):
    actor, now = Actor(stage, "one/run"), 0.0
    actor.set_stick(1.0, 0.0)
    actor.advance(now)
    actor.start_recording()

    def walk(frames: int) -> list[View]:
        nonlocal now
        views = []
        for _ in range(frames):
            now += FRAME
            views.append(actor.advance(now))
        return views

    views = walk(30)
    assert views[-1].recording and views[-1].recorded_seconds == pytest.approx(0.5)
    actor.choose("two/run", "proud")
    later = walk(60)
    actor.choose("one/run", "proud")
    later += walk(30)
    assert not any(view.recording for view in later)
    assert {view.recorded_seconds for view in later} == {views[-1].recorded_seconds}
    clip = actor.stop_recording()
    assert clip is not None and clip.num_frames == 30
    np.testing.assert_allclose(clip.root_positions, [view.joints[0] for view in views], atol=HIPS)
    assert actor.advance(now).recorded_seconds is None and actor.stop_recording() is None


def test_a_style_joins_and_disturbs_no_other(stage, two_runs):
    version, before = stage.version, walked(stage, "neutral")
    rehearse_walks(stage.cast("one/run").controller)
    compiled = compilations()
    learned = load_style(stage.cast("one/run").run, "proud")
    assert learned is not None
    save_style(two_runs[0], "joined", learned, {"speed": 0.7})
    stage.add_style("one/run", "joined")
    assert stage.version == version + 1 and ("one/run", "joined") in stage.styles
    assert ("two/run", "joined") not in stage.styles
    cast = stage.cast("one/run")
    assert cast.speeds["joined"] == pytest.approx(0.7)
    assert float(cast.controller.params.speeds[cast.styles.index("joined")]) == pytest.approx(0.7)
    np.testing.assert_array_equal(walked(stage, "neutral"), before)
    assert np.abs(walked(stage, "joined") - before).max() > 1e-4
    assert compilations() == compiled
    fresh = make_controller(load_run(two_runs[0]), ["joined"]).params
    index = cast.styles.index("joined")
    assert float(cast.controller.params.shares[index]) == pytest.approx(float(fresh.shares[0]), rel=SHARE)


def filled(controller: Controller) -> Controller:
    """The controller without its spare rows."""
    rows, params = len(controller.styles), controller.params
    bank = jax.tree.map(lambda leaf: leaf[:rows], params.bank)
    return replace(
        controller,
        params=replace(params, bank=bank, speeds=params.speeds[:rows], shares=params.shares[:rows]),
    )


def test_a_full_bank_grows(stage):
    cast = stage.cast("two/run")
    styles = [style for name in cast.styles if (style := load_style(cast.run, name)) is not None]
    save_style(cast.run.path, "more", styles[0], {"speed": 1.0})
    rows, full = len(cast.styles), filled(cast.controller)
    grown = joined(cast.run, full, "more", styles[0])
    assert grown.styles == (*cast.styles, "more") and grown.capacity == rows + 1 + SPARE
    for index, style in enumerate([*styles, styles[0]]):
        rows_of = jax.tree.map(lambda leaf, i=index: leaf[i], grown.params.bank)
        jax.tree.map(np.testing.assert_array_equal, rows_of, style)


def test_a_character_lives_on_when_its_bank_grows(stage):
    cast = stage.cast("two/run")
    state = cast.controller.start(style="proud")
    grown = fitted(state, cast.controller.capacity + 3)
    assert fitted(state, cast.controller.capacity) is state
    expected = np.zeros(cast.controller.capacity + 3)
    expected[cast.styles.index("proud")] = 1.0
    np.testing.assert_array_equal(grown.style, expected)


def test_a_run_without_styles_takes_as_many_as_come(played_run, tmp_path, monkeypatch):
    path, saved = tmp_path / "bare", load_run(played_run)
    shutil.copytree(played_run, path)
    for style in ("depressed", "neutral", "proud"):
        shutil.rmtree(path / "styles" / style)
    bare = Stage([path])
    actor, now = Actor(bare), 0.0
    assert bare.styles == [("bare", "agnostic")]
    actor.advance(now)

    def after(seconds: float) -> View:
        nonlocal now
        for _ in range(round(seconds * 60)):
            now += FRAME
            view = actor.advance(now)
        return view

    def join(style: str, spare: int) -> Cast:
        """The full cast with one more style in the 11 rows of the other stage, for which the step has been compiled."""
        before, cast = after(FRAME), bare.cast("bare")
        if cast.controller.params.bank is not None:
            monkeypatch.setattr(bare, "_casts", {"bare": replace(cast, controller=filled(cast.controller))})
        learned = load_style(saved, style)
        assert learned is not None
        monkeypatch.setattr("pfnn_jax.viewer.page.stage.SPARE", spare)
        save_style(path, style, learned, {"speed": 0.7})
        bare.add_style("bare", style)
        assert np.abs(after(FRAME).joints - before.joints).max() < 0.05
        return bare.cast("bare")

    first = join("proud", 9)
    assert first.styles == ("agnostic", "proud") and first.controller.capacity == 11
    assert first.speeds["proud"] == pytest.approx(0.7) and first.speeds["agnostic"] > 0.0
    actor.choose("bare", "proud")
    assert after(1.5).style_weights["proud"] == pytest.approx(1.0, abs=0.01)

    full = join("neutral", 8)
    assert full.styles == ("agnostic", "proud", "neutral") and full.controller.capacity == 11
    for name, walk in first.speeds.items():
        assert full.speeds[name] == walk
    np.testing.assert_array_equal(full.controller.params.shares[:2], first.controller.params.shares[:2])
    np.testing.assert_array_equal(full.controller.params.shares[3:], 1.0)
    for index, name in enumerate(full.styles[1:], start=1):
        rows = jax.tree.map(lambda leaf, index=index: leaf[index], full.controller.params.bank)
        jax.tree.map(np.testing.assert_array_equal, rows, load_style(saved, name))
    for leaf in jax.tree.leaves(full.controller.params.bank):
        assert not np.any(leaf[0]) and not np.any(leaf[3:])
    actor.choose("bare", "neutral")
    assert after(1.5).style_weights["neutral"] == pytest.approx(1.0, abs=0.01)


def test_a_style_of_another_kind_cannot_join(stage):
    cast = stage.cast("one/run")
    with pytest.raises(InputError, match="must be of the kind"):
        joined(cast.run, cast.controller, "new", np.zeros(3))
