"""Loaded runs: their names, and how a new style is added without changing the others."""

from __future__ import annotations

import os
import shutil
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from pfnn_jax.control import calibration
from pfnn_jax.control import controller as controlling
from pfnn_jax.control.controller import Controller, make_controller
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import in_parts
from pfnn_jax.models.style import StyleSum
from pfnn_jax.run import load_run, load_style, save_style
from pfnn_jax.viewer.page.character import Character, with_capacity
from pfnn_jax.viewer.page.run_library import (
    LoadedRun,
    RunLibrary,
    compile_calibration,
    compile_character,
)
from pfnn_jax.viewer.page.style_bank import bank_rows, calibrated_row, with_row
from pfnn_jax.viewer.page.view import View
from pfnn_jax.workflows.base import open_base
from tests.raising import assert_refused
from tests.viewer.banks import without_spare_rows
from tests.viewer.watching import until

FRAME = 1.0 / 60.0
SHARE = 1e-5
"""Relative: both are float32 quotients of the same numbers."""

HIPS = 1e-6
"""Metres: the same float32 numbers."""


@pytest.fixture(scope="module")
def two_runs(played_run, tmp_path_factory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("library")
    paths = folder / "one" / "run", folder / "two" / "run"
    for path in paths:
        shutil.copytree(played_run, path)
    return paths


@pytest.fixture(scope="module")
def library(two_runs) -> RunLibrary:
    return RunLibrary(two_runs)


def walked(library: RunLibrary, style: str, frames: int = 20) -> np.ndarray:
    character = Character(library, library.runs[0], style)
    character.set_stick(1.0, 0.0)
    character.advance(0.0)
    return np.stack([character.advance(frame * FRAME).joints for frame in range(1, frames)])


def compilations() -> list[int]:
    """Returns how often a step, and a calibration, have been compiled."""
    quick: tuple[Any, ...] = (controlling._step_now, calibration._measure_now)
    return [function.compiled()._cache_size() for function in quick]


def test_names_of_runs_are_short_and_distinct(library, two_runs):
    assert library.runs == ("one/run", "two/run")
    assert library.get("two/run").run.path == two_runs[1]
    assert library.styles[:3] == [("one/run", name) for name in ("depressed", "neutral", "proud")]


def test_the_base_network_is_called_base(monkeypatch, tmp_path):
    monkeypatch.setattr("pfnn_jax.workflows.base.data_folder", lambda: tmp_path / "data")
    copy = open_base().path
    assert RunLibrary([copy]).runs == ("base",)
    own = shutil.copytree(copy, tmp_path / "own" / "base")
    assert RunLibrary([copy, own]).runs == ("base", "own/base")


def test_a_character_begins_in_the_style_learned_last(played_run, tmp_path):
    path = Path(shutil.copytree(played_run, tmp_path / "run"))
    run = load_run(path)
    assert Character(RunLibrary([path])).shares == {min(run.config.styles): 1.0}
    for seconds, style in enumerate(("zz", "mine", "aa")):
        save_style(path, style, load_style(run, run.config.styles[0]), {"speed": 1.0})
        os.utime(path / "styles" / style / "style.json", (seconds, 10.0 - seconds))
    assert Character(RunLibrary([path])).shares == {"zz": 1.0}


def test_missing_and_repeated_runs_are_refused(two_runs, tmp_path):
    for paths in ([], [tmp_path], [two_runs[0], two_runs[0]]):
        with pytest.raises(InputError):
            RunLibrary(paths)


def test_a_character_of_another_run_stands_at_the_same_place(library):
    character = Character(library, "one/run")
    character.set_stick(1.0, 0.0, turn=0.3)
    for frame in range(90):
        character.advance(frame * FRAME)
    before = character.advance(90 * FRAME)
    character.choose("two/run", "proud")
    after = character.advance(90 * FRAME)
    assert after.run == "two/run" and after.style_weights == {"proud": 1.0}
    assert np.linalg.norm(before.root) > 0.05
    assert np.linalg.norm(after.root - before.root) < 0.1
    assert after.heading == before.heading
    assert float(after.facing @ before.facing) > np.cos(np.radians(3.0))


def test_a_change_of_run_ends_a_recording(library):
    character, now = Character(library, "one/run"), 0.0
    character.set_stick(1.0, 0.0)
    character.advance(now)
    character.start_recording()

    def walk(frames: int) -> list[View]:
        nonlocal now
        views = []
        for _ in range(frames):
            now += FRAME
            views.append(character.advance(now))
        return views

    views = walk(30)
    assert views[-1].recording and views[-1].recorded_seconds == pytest.approx(0.5)
    character.choose("two/run", "proud")
    later = walk(60)
    character.choose("one/run", "proud")
    later += walk(30)
    assert not any(view.recording for view in later)
    assert {view.recorded_seconds for view in later} == {views[-1].recorded_seconds}
    clip = character.stop_recording()
    assert clip is not None and clip.num_frames == 30
    np.testing.assert_allclose(clip.root_positions, [view.joints[0] for view in views], atol=HIPS)
    assert character.advance(now).recorded_seconds is None and character.stop_recording() is None


def test_a_character_compiles_nothing_after_the_warm_up(library):
    """The step is compiled from zeros before a character has been started."""
    prepared: list[str] = []
    library.warm_up(prepared.append)
    quick: tuple[Any, ...] = (controlling._start_now, controlling._step_now)
    before = [function.compiled()._cache_size() for function in quick]
    walked(library, "neutral")
    assert [function.compiled()._cache_size() for function in quick] == before
    assert until(lambda: set(prepared) == set(library.runs))


def test_an_error_of_the_start_of_a_character_is_raised(library, monkeypatch):
    def broken(self: Controller) -> Any:
        if threading.current_thread() is not threading.main_thread():
            raise MemoryError("no room")
        return start(self)

    start = Controller.start
    monkeypatch.setattr(Controller, "start", broken)
    with pytest.raises(MemoryError, match="no room"):
        compile_character(library.get(library.runs[0]).controller)


def test_adding_a_style_changes_no_other(library, two_runs):
    version, before = library.version, walked(library, "neutral")
    compile_calibration(library.get("one/run").controller)
    compiled = compilations()
    learned = load_style(library.get("one/run").run, "proud")
    assert learned is not None
    save_style(two_runs[0], "joined", learned, {"speed": 0.7})
    library.add_style("one/run", "joined")
    assert library.version == version + 1 and ("one/run", "joined") in library.styles
    assert ("two/run", "joined") not in library.styles
    loaded = library.get("one/run")
    assert loaded.speeds["joined"] == pytest.approx(0.7)
    assert float(loaded.controller.params.speeds[loaded.styles.index("joined")]) == pytest.approx(0.7)
    np.testing.assert_array_equal(walked(library, "neutral"), before)
    assert np.abs(walked(library, "joined") - before).max() > 1e-4
    assert compilations() == compiled
    fresh = make_controller(load_run(two_runs[0]), ["joined"]).params
    index = loaded.styles.index("joined")
    assert float(loaded.controller.params.speed_gains[index]) == pytest.approx(float(fresh.speed_gains[0]), rel=SHARE)


def test_a_full_bank_grows(library):
    loaded = library.get("two/run")
    styles = [style for name in loaded.styles if (style := load_style(loaded.run, name)) is not None]
    save_style(loaded.run.path, "more", styles[0], {"speed": 1.0})
    rows, full = len(loaded.styles), without_spare_rows(loaded.controller)
    grown = with_row(full, "more", calibrated_row(loaded.run, full, "more", styles[0]))
    assert grown.styles == (*loaded.styles, "more") and grown.capacity == bank_rows(rows + 1)
    for index, style in enumerate([*styles, styles[0]]):
        rows_of = jax.tree.map(lambda leaf, i=index: leaf[i], grown.params.bank)
        wanted = in_parts(style, rows_of) if isinstance(rows_of, StyleSum) else style
        jax.tree.map(np.testing.assert_array_equal, rows_of, wanted)


def test_style_weights_keep_their_rows_when_a_bank_grows(library):
    loaded = library.get("two/run")
    state = loaded.controller.start(style="proud")
    grown = with_capacity(state, loaded.controller.capacity + 3)
    assert with_capacity(state, loaded.controller.capacity) is state
    expected = np.zeros(loaded.controller.capacity + 3)
    expected[loaded.styles.index("proud")] = 1.0
    np.testing.assert_array_equal(grown.style, expected)


def test_styles_can_be_added_to_a_run_without_styles(played_run, tmp_path, monkeypatch):
    path, saved = tmp_path / "bare", load_run(played_run)
    shutil.copytree(played_run, path)
    for style in ("depressed", "neutral", "proud"):
        shutil.rmtree(path / "styles" / style)
    bare = RunLibrary([path])
    character, now = Character(bare), 0.0
    assert bare.styles == [("bare", "agnostic")]
    character.advance(now)

    def after(seconds: float) -> View:
        nonlocal now
        for _ in range(round(seconds * 60)):
            now += FRAME
            view = character.advance(now)
        return view

    def join(style: str, spare: int) -> LoadedRun:
        """Adds a style to the run in a bank of 16 rows, for which the step has been compiled already."""
        before, loaded = after(FRAME), bare.get("bare")
        if loaded.controller.params.bank is not None:
            monkeypatch.setattr(
                bare, "_loaded", {"bare": replace(loaded, controller=without_spare_rows(loaded.controller))}
            )
        learned = load_style(saved, style)
        assert learned is not None
        monkeypatch.setattr("pfnn_jax.viewer.page.style_bank.SPARE", spare)
        save_style(path, style, learned, {"speed": 0.7})
        bare.add_style("bare", style)
        assert np.abs(after(FRAME).joints - before.joints).max() < 0.05
        return bare.get("bare")

    first = join("proud", 8)
    assert first.styles == ("agnostic", "proud") and first.controller.capacity == 16
    assert first.speeds["proud"] == pytest.approx(0.7) and first.speeds["agnostic"] > 0.0
    character.choose("bare", "proud")
    assert after(1.5).style_weights["proud"] == pytest.approx(1.0, abs=0.01)

    full = join("neutral", 8)
    assert full.styles == ("agnostic", "proud", "neutral") and full.controller.capacity == 16
    for name, walk in first.speeds.items():
        assert full.speeds[name] == walk
    np.testing.assert_array_equal(full.controller.params.speed_gains[:2], first.controller.params.speed_gains[:2])
    np.testing.assert_array_equal(full.controller.params.speed_gains[3:], 1.0)
    for index, name in enumerate(full.styles[1:], start=1):
        rows = jax.tree.map(lambda leaf, index=index: leaf[index], full.controller.params.bank)
        jax.tree.map(np.testing.assert_array_equal, rows, load_style(saved, name))
    for leaf in jax.tree.leaves(full.controller.params.bank):
        assert not np.any(leaf[0]) and not np.any(leaf[3:])
    character.choose("bare", "neutral")
    assert after(1.5).style_weights["neutral"] == pytest.approx(1.0, abs=0.01)


def test_a_style_of_another_kind_is_refused(library):
    loaded = library.get("one/run")
    other: Any = np.zeros(3)
    assert_refused(lambda: calibrated_row(loaded.run, loaded.controller, "new", other), place="style", value="new")
