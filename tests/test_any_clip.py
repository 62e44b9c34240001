"""The any-clip experiment: what it learns from and judges on, and a small run of it."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from experiments.any_clip import Config, choose_trials, main, row_file
from experiments.common.any_clip_report import SUMMARY, summary
from experiments.common.any_clip_takes import (
    GAP_SECONDS,
    LEARNED_SECONDS,
    OTHER_TAKE,
    SAME_FRAMES,
    SAME_TAKE,
    SOURCES,
    SPEED_RATIO,
    Trial,
    find_trial,
    list_styles_of,
)
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.raising import assert_refused
from tests.trained import walking_run

SOURCE = {source.name: source for source in SOURCES}
ROUNDING = 0.02  # seconds: a frame


def long_walk(folder: Path, seconds: float) -> ClipFile:
    frames = round(60 * seconds)
    path = folder / f"walk_{frames}.bvh"
    write_bvh(path, synthesise("neutral", np.zeros(frames), np.ones(frames))[0])
    return ClipFile(path, "neutral")


@pytest.mark.parametrize(
    ("seconds", "learned", "how"), [(15.0, 5.0, SAME_TAKE), (8.0, 4.0, SAME_TAKE), (3.0, 3.0, SAME_FRAMES)]
)
def test_single_take_is_judged_2_s_away_where_it_is_long_enough(tmp_path, seconds, learned, how):
    trial = find_trial(SOURCE["field"], "neutral", [long_walk(tmp_path, seconds)])
    assert isinstance(trial, Trial) and trial.how == how
    assert trial.learned.seconds == pytest.approx(learned, abs=ROUNDING)
    if how == SAME_TAKE:
        assert trial.judged[0].begin >= trial.learned.begin + trial.learned.seconds + GAP_SECONDS - ROUNDING


def test_standing_and_short_takes_are_skipped_with_a_reason(tmp_path):
    assert "only 1.0 s" in str(find_trial(SOURCE["field"], "neutral", [long_walk(tmp_path, 1.0)]))
    clip, _ = synthesise("neutral", np.zeros(300), np.zeros(300))
    write_bvh(tmp_path / "still.bvh", clip)
    found = find_trial(SOURCE["field"], "still", [ClipFile(tmp_path / "still.bvh", "still")])
    assert isinstance(found, str) and found


@pytest.mark.parametrize("source", ["bandai-namco-1", "bandai-namco-2"])
def test_styles_with_several_takes_are_judged_on_others(mocap, tmp_path, source):
    for style, files in list(list_styles_of(SOURCE[source], mocap, tmp_path).items())[:2]:
        trial = find_trial(SOURCE[source], style, files)
        assert isinstance(trial, Trial) and trial.learned.seconds <= LEARNED_SECONDS
        if trial.how == OTHER_TAKE:
            assert all(part.file.path != trial.learned.file.path for part in trial.judged)
        ratios = [part.speed / trial.learned.speed for part in trial.judged]
        assert all(1 / SPEED_RATIO <= ratio <= SPEED_RATIO for ratio in ratios)


def test_skipped_styles_do_not_count(mocap, tmp_path):
    config = Config(("a=b",), tmp_path, mocap, field=1)
    trials, skipped = choose_trials(SOURCE["field"], config)
    assert len(trials) == 1 and all(style < trials[0].style for style in skipped)


@pytest.mark.parametrize(
    ("wrong", "place", "rule"),
    [
        ({"sources": ("xsens",)}, "sources", "must be one of"),
        ({"bases": ("demo",)}, "bases", "NAME=DIRECTORY"),
        ({"seen": ("demo:xia",)}, "seen", "BASE:SOURCE"),
        ({"paper": ("demo",)}, "paper", "names of the bases"),
    ],
)
def test_bad_settings_are_refused(tmp_path, wrong, place, rule):
    make = partial(Config, **{"bases": ("run=runs/demo",), "out": tmp_path, **wrong})
    (value,) = next(iter(wrong.values()))
    assert_refused(make, place=place, value=value, rule_mentions=rule)


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    run, out = walking_run(tmp_path_factory), tmp_path_factory.mktemp("any_clip")
    config = Config((f"small={run.path}",), out, sources=("procedural",), only=("zombie",))
    return config, main(config)


@pytest.mark.slow
def test_row_holds_measures_of_all_walks_and_a_picture(result):
    config, found = result
    (row,) = found["rows"]
    assert (row["base"], row["source"], row["style"], row["how"]) == ("small", "procedural", "zombie", OTHER_TAKE)
    (take,) = row["judged"]
    assert set(take["walks"]) == {"learned", "without", "own"}
    assert all(np.isfinite(walk["one_step"]) for walk in take["walks"].values())
    assert (config.out / "pictures" / take["picture"]).stat().st_size > 1000


@pytest.mark.slow
def test_report_is_written(result):
    config, found = result
    assert json.loads((config.out / "report.json").read_text())["rows"] == found["rows"]
    assert "zombie" in (config.out / "report.html").read_text()
    assert len(summary(found["rows"])[0]) == len(SUMMARY)


@pytest.mark.slow
def test_run_that_is_given_learns_nothing(result):
    config, _ = result
    assert not any("learned" in path.name for path in config.runs["small"].rglob("*"))


@pytest.mark.slow
def test_finished_rows_are_not_repeated(result):
    config, found = result
    trial = choose_trials(SOURCE["procedural"], config)[0][0]
    file = row_file(config.out, "small", trial)
    written = file.stat().st_mtime_ns
    assert main(config)["rows"] == found["rows"] and file.stat().st_mtime_ns == written
