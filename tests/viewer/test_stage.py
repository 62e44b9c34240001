"""Runs on stage: their names, and how a new style joins one without disturbing the others."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.runtime.controller import make_controller, step
from pfnn_jax.runtime.standing import settle
from pfnn_jax.training.run import load_run, load_style, save_style
from pfnn_jax.viewer.actor import Actor, fitted
from pfnn_jax.viewer.stage import SPARE, Stage, joined, rehearse_walks

FRAME = 1.0 / 60.0
SHARE = 1e-5
"""Relative: both are float32 quotients of the same numbers."""


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
    actor.start_recording()
    before = actor.advance(90 * FRAME)
    actor.choose("two/run", "proud")
    after = actor.advance(90 * FRAME)
    assert after.run == "two/run" and after.style_weights == {"proud": 1.0}
    assert np.linalg.norm(before.root) > 0.05
    assert np.linalg.norm(after.root - before.root) < 0.1
    assert after.heading == before.heading
    assert float(after.facing @ before.facing) > np.cos(np.radians(3.0))
    actor.advance(91 * FRAME)
    clip = actor.stop_recording()
    assert clip is not None and clip.num_frames == 1  # a recording ends with its run


def test_a_style_joins_and_disturbs_no_other(stage, two_runs):
    version, before = stage.version, walked(stage, "neutral")
    rehearse_walks(stage.cast("one/run").controller)
    compiled = step._cache_size(), settle._cache_size()
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
    assert (step._cache_size(), settle._cache_size()) == compiled
    fresh = make_controller(load_run(two_runs[0]), ["joined"]).params
    index = cast.styles.index("joined")
    assert float(cast.controller.params.shares[index]) == pytest.approx(float(fresh.shares[0]), rel=SHARE)


def test_a_full_bank_grows(stage):
    cast = stage.cast("two/run")
    styles = [style for name in cast.styles if (style := load_style(cast.run, name)) is not None]
    save_style(cast.run.path, "more", styles[0], {"speed": 1.0})
    rows = len(cast.styles)
    full = replace(
        cast.controller,
        params=replace(
            cast.controller.params,
            bank=jax.tree.map(lambda leaf: leaf[:rows], cast.controller.params.bank),
            speeds=cast.controller.params.speeds[:rows],
        ),
    )
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


def test_a_run_without_styles_takes_its_first(stage, played_run, tmp_path):
    learned, path = load_style(stage.cast("one/run").run, "proud"), tmp_path / "bare"
    shutil.copytree(played_run, path)
    for style in ("depressed", "neutral", "proud"):
        shutil.rmtree(path / "styles" / style)
    bare = Stage([path])
    actor = Actor(bare)
    actor.advance(0.0)
    before = actor.advance(FRAME)
    assert bare.styles == [("bare", "agnostic")]
    assert learned is not None
    save_style(path, "proud", learned, {"speed": 0.7})
    bare.add_style("bare", "proud")
    cast = bare.cast("bare")
    assert cast.styles == ("agnostic", "proud") and cast.controller.capacity == 1 + SPARE
    assert cast.speeds["proud"] == pytest.approx(0.7) and cast.speeds["agnostic"] > 0.0
    np.testing.assert_allclose(cast.controller.params.speeds[:2], [cast.speeds["agnostic"], 0.7])
    after = actor.advance(2 * FRAME)
    assert np.abs(after.joints - before.joints).max() < 0.05
    actor.choose("bare", "proud")
    for frame in range(3, 93):
        after = actor.advance(frame * FRAME)
    assert after.style_weights["proud"] == pytest.approx(1.0, abs=0.01)


def test_a_style_of_another_kind_cannot_join(stage):
    cast = stage.cast("one/run")
    with pytest.raises(InputError, match="must be of the kind"):
        joined(cast.run, cast.controller, "new", np.zeros(3))
