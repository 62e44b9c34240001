"""The experiments on data that nothing was chosen on: what is learned, what it is judged on, and the tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from experiments.common.style_takes import TrainedNetwork
from experiments.common.turning_judged import WAYS, JudgedWalks
from experiments.few_shot import other_data
from experiments.few_shot.other_data import (
    NONE,
    OWN_TURNS,
    PAPER,
    SIDE_STEPS,
    STRAIGHT,
    TURNS,
    Config,
    Networks,
    Trial,
    judge_own_turns,
    straight_trial,
    table,
    turning_trial,
)
from experiments.few_shot.walk_to_run import runs_of
from pfnn_jax.evaluation.turning_judge import MEASURES, STYLE_MEASURES
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.features.layout import mason2018
from pfnn_jax.motion.synthetic.walks import synthesise

FPS = 60.0


def labelled(rate: np.ndarray, content: str) -> LabelledClip:
    clip, labels = synthesise("neutral", rate, np.full(len(rate), 1.2))
    return LabelledClip(replace(clip, content=content, source=content), labels)


def straight(seconds: float, content: str) -> LabelledClip:
    return labelled(np.zeros(round(seconds * FPS)), content)


@pytest.fixture(scope="module")
def networks() -> Networks:
    skeleton = straight(1.0, "walk").clip.skeleton
    none = cast(Any, None)
    network = TrainedNetwork(none, none, none, 0.0)
    return Networks(mason2018(skeleton.num_joints), skeleton, network, network, none)


@pytest.fixture(scope="module")
def turning(networks) -> tuple[np.ndarray, Trial]:
    """Returns the learned frames and the trial of a take with four turns."""
    turn, ahead = [np.full(round(2 * FPS), np.deg2rad(45.0) * side) for side in (1, -1)], np.zeros(round(4 * FPS))
    whole = labelled(np.concatenate([ahead, turn[0], ahead, turn[1], ahead, turn[0], ahead, turn[1], ahead]), "walk")
    learned = np.arange(round(3 * FPS))
    return learned, turning_trial("walk", whole, learned, networks)


def test_first_walk_is_learned_and_the_others_are_judged(networks):
    own = [straight(seconds, "walk") for seconds in (4.0, 3.0)]
    own += [straight(3.0, content) for content in ("walk-left", "walk-right", "walk-back")]
    trial = straight_trial("neutral", own, networks, 2.0)
    assert {kind: [take.name for take in takes] for kind, takes in trial.judged.items()} == {
        STRAIGHT: ["walk"],
        SIDE_STEPS: ["walk-left", "walk-right"],
    }
    assert len(trial.clip) == 2
    assert all(rows.frames.max() < 2.0 * FPS for rows in trial.clip)


def test_learned_frames_and_judged_turns_are_disjoint(turning):
    learned, trial = turning
    assert len(trial.judged[TURNS]) == len(trial.turns) == 4
    assert set(trial.clip[0].frames) <= set(learned)
    assert not any(np.isin(rows.frames, learned).any() for rows in trial.turns)


def test_bound_learns_from_no_frame_that_it_is_judged_on(turning, networks, monkeypatch):
    _, trial = turning
    seen: list[tuple[set[int], list[str]]] = []

    def learn(parts, network, networks, recipe, config):
        assert not recipe.restyled
        seen.append(({int(frame) for rows in parts[len(trial.clip) :] for frame in rows.frames}, []))

    def judge(trial, network, style, networks):
        takes = trial.judged[TURNS]
        seen[-1][1].extend(take.name for take in takes)
        return {TURNS: {way: measured(1.0, len(takes)) for way in WAYS}}

    monkeypatch.setattr(other_data, "learn", learn)
    monkeypatch.setattr(other_data, "judge", judge)
    found = judge_own_turns(trial, networks.noisy, networks, Config(Path(), Path()))
    names = [take.name for take in trial.judged[TURNS]]
    assert sorted(name for _, judged in seen for name in judged) == sorted(names)
    for frames, judged in seen:
        tested = [rows.frames for rows, name in zip(trial.turns, names, strict=True) if name in judged]
        assert frames and not frames & set(np.concatenate(tested).tolist())
    assert all(len(found[TURNS][way].takes) == len(names) for way in WAYS)


def measured(distance: float, takes: int = 2) -> JudgedWalks:
    judged = dict.fromkeys(MEASURES, np.nan) | {"distance": distance}
    return JudgedWalks([judged] * takes, dict.fromkeys(STYLE_MEASURES, np.nan))


def test_table_has_the_mean_of_the_cases_that_are_judged_alike():
    def found(none: float, paper: float):
        return {name: {str(way): measured(value) for way in WAYS} for name, value in ((NONE, none), (PAPER, paper))}

    lines = table({"a, turns": found(4.0, 3.0), "b, turns": found(6.0, 3.5), "c, walk": found(9.0, 9.0)}).splitlines()
    assert lines[-1].startswith("| mean, turns | 5.00 / 5.00 | 3.25 / 3.25 | –")
    assert len(lines) == 2 + 3 + 1 and OWN_TURNS in lines[0]


def test_runs_of_the_bound_are_not_judged():
    own = [SimpleNamespace(content=content, name=str(number)) for number, content in enumerate(["walk", *["run"] * 5])]
    learned, judged = runs_of(cast(Any, SimpleNamespace(own=own)))
    assert [take.name for take in learned] == ["1", "3", "5"] and [take.name for take in judged] == ["2", "4"]
