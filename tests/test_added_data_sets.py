"""The experiment on added data sets: what every network is trained on, and its table."""

from __future__ import annotations

import numpy as np

from experiments.added_data_sets import ADDED, MIXES, ROWS, summary, training_rows
from experiments.common.style_takes import Take
from pfnn_jax.motion.features.encode import Features


def rows(count: int) -> Features:
    return Features(np.zeros((count, 2)), np.zeros((count, 3)), np.zeros(count), np.arange(count))


def test_the_held_out_style_is_in_no_mix_whatever_set_it_is_from():
    takes = [Take(style, "walk", style, rows(5), rows(5)) for style in ("feminine", "normal")]
    added = {name: {f"{name}_feminine": [rows(3)], f"{name}_old": [rows(3)]} for name in ADDED}
    for mix in MIXES.values():
        found = training_rows(takes, added, mix, "feminine")
        assert set(found) == {"normal", *(f"{name}_old" for name in mix)}
        assert len(found["normal"].x) == 10


def test_each_mix_contains_the_one_before():
    mixes = [set(mix) for mix in MIXES.values()]
    assert all(first < second for first, second in zip(mixes, mixes[1:], strict=False)) and mixes[-1] == set(ADDED)


def test_the_table_has_means_over_styles_and_a_column_for_each():
    def fold(style: str, error: float):
        kinds = {kind: {"pose_velocity": error} for kind in ("straight", "turning")}
        measures = {**kinds, "nearest_turning_pose": 0.03, "skating": 0.2}
        return {"mix": next(iter(MIXES)), "style": style, "rows": dict.fromkeys(ROWS, measures)}

    lines = summary([fold("elderly", 0.1), fold("youthful", 0.3)]).splitlines()
    assert len(lines) == 2 + len(ROWS)
    assert lines[2].split(" | ")[2:] == ["0.2", "0.2", "0.1", "0.3", "3", "20 |"]
