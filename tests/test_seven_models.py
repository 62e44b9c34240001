"""The experiments on the seven models of Mason 2022 at tiny sizes: equal frames, measures, resuming, new styles."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from experiments import new_styles, one_step_error, table2_models
from experiments.common.new_style_methods import METHODS, Budget, by_content
from experiments.common.one_step_error_table import COLUMNS
from experiments.common.seven_measures import GROUPS
from experiments.common.seven_models import load_model
from experiments.common.seven_takes import GAP, LAYOUT_NAMES, Take, common_columns, load_takes, split_takes
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.models.presets import TABLE2
from tests.raising import assert_refused

LEARNED = ("lpn_film", "pfnn_resad")
TRIED = ("fine-tuned generator", "FiLM vector", "nearest known style", "nothing: mean style", "nothing, PFNN resad")


@pytest.fixture(scope="module")
def folder(mocap, tmp_path_factory):
    """Two styles of three straight walks each."""
    folder = tmp_path_factory.mktemp("takes")
    for style in ("elderly", "normal"):
        for file in sorted((mocap / "bandai-namco-2").glob(f"dataset-2_walk_{style}_*.bvh"))[:3]:
            (folder / file.name).symlink_to(file)
    return folder


@pytest.fixture(scope="module")
def takes(folder):
    return load_takes(str(folder), most=2)


@pytest.fixture(scope="module")
def config(folder, tmp_path_factory):
    """The tiny sizes on two takes of each style."""
    return one_step_error.Config(
        data=str(folder), out=tmp_path_factory.mktemp("result"), models=LEARNED, tiny=True, circle_seconds=2.5
    )


@pytest.fixture(scope="module")
def result(config):
    return one_step_error.main(config)


def test_all_models_see_the_same_frames(takes):
    for take in (*takes.train, *takes.test):
        for rows in (take.rows, take.mirrored):
            first = rows[LAYOUT_NAMES[0]]
            for name in LAYOUT_NAMES:
                layout = takes.layout(name)
                np.testing.assert_array_equal(rows[name].frames, first.frames)
                np.testing.assert_array_equal(rows[name].x, first.x)
                own = rows[name].y[:, common_columns(layout)]
                np.testing.assert_array_equal(own, first.y[:, common_columns(takes.layout(LAYOUT_NAMES[0]))])


def test_common_columns_are_trajectory_pose_and_contacts(takes):
    joints = takes.skeleton.num_joints
    assert {len(common_columns(takes.layout(name))) for name in LAYOUT_NAMES} == {24 + 12 * joints + 2}


def test_whole_takes_are_held_out(takes):
    assert {take.style for take in takes.test} == {"elderly", "normal"} == {take.style for take in takes.train}
    assert not {take.name for take in takes.test} & {take.name for take in takes.train}


def test_a_single_take_is_cut_in_time_with_a_gap(takes):
    (early,), (late,) = split_takes([takes.train[0]], 0.25)
    first, last = early.rows["mason2022"].frames, late.rows["mason2022"].frames
    assert first.max() + GAP <= last.min()
    assert early.clip.num_frames + GAP + late.clip.num_frames == takes.train[0].clip.num_frames


@pytest.mark.slow
def test_every_model_has_every_measure(config, result):
    assert set(result["models"]) == {f"{name}_0" for name in LEARNED}
    for entry in result["models"].values():
        assert {"mse", "bones", "bone_loss", *GROUPS} <= set(entry["test"])
        assert np.isfinite([entry["test"][name] for name in ("mse", "bones", *GROUPS)]).all()
        for path, _ in COLUMNS.values():
            assert path[-1] in (entry if len(path) == 1 else entry[path[0]])
    table = (config.out / "table.md").read_text().splitlines()
    assert len(table) == 2 + len(LEARNED) + 1 and len({line.count("|") for line in table}) == 1
    assert all((config.out / name).stat().st_size > 5000 for name in ("mse.png", "bones.png", "walks.png"))


@pytest.mark.slow
def test_finished_models_are_not_trained_again(config, result):
    assert one_step_error.main(config)["models"] == result["models"]


@pytest.mark.slow
def test_results_of_other_settings_are_refused(config, result):
    other = replace(config, tiny=False, hidden=16)
    assert_refused(lambda: one_step_error.main(other), place="steps", value=other.steps, rule_mentions="must be 4")


@pytest.mark.slow
def test_saved_models_are_loaded(config, result, folder):
    model = load_model(one_step_error.network_folder(config.out, "lpn_film", 0), load_takes(str(folder), most=2))
    assert model is not None and model.styles == ("elderly", "normal")
    assert model.config.adapter == TABLE2["lpn_film"].adapter and model.generator is not None
    style = model.style("normal")
    assert model.bank.scale.shape == (2, 2, 16) and isinstance(style, FiLMStyle) and style.shift.shape == (2, 16)


def test_unknown_model_is_refused(tmp_path):
    make = partial(one_step_error.Config, data="synthetic", out=tmp_path, models=("lpn",))
    assert_refused(make, place="models", value="lpn", rule_mentions="pfnn_one_hot")


@pytest.mark.slow
def test_methods_of_adding_a_style_give_every_measure(config, result, mocap, tmp_path):
    new = tmp_path / "new"
    new.mkdir()
    for name in ("walk_angry_001", "walk_angry_002", "walk-back_angry_001"):
        (new / f"dataset-1_{name}.bvh").symlink_to(mocap / "bandai-namco-1" / f"dataset-1_{name}.bvh")
    found = new_styles.main(
        new_styles.Config(
            pretrained=config.out,
            data=config.data,
            new=new,
            out=tmp_path / "out",
            styles=("angry",),
            methods=TRIED,
            takes=2,
            budget=Budget(eval_epochs=(1,), learning_rates=(1e-3,), tuning_steps=(1,)),
            circle_seconds=2.5,
            starts=1,
            classifier_epochs=1,
            windows=4,
        )
    )
    assert set(found["summary"]) == set(TRIED) <= set(METHODS)
    for method, row in found["summary"].items():
        assert {"walk", "back", "all"} <= set(row["mse"]) and np.isfinite(row["mse"]["all"]), method
    stored = {method: row["stored"] for method, row in found["summary"].items()}
    assert stored["FiLM vector"] == stored["fine-tuned generator"] == 4 * 16
    assert stored["nothing: mean style"] == 0
    assert set(found["map"]["after"]) == {"known", "new"}
    assert (tmp_path / "out" / "film_vectors.png").stat().st_size > 5000
    errors = {method: row["errors"]["all"]["mse"] for method, row in found["styles"]["angry"].items()}
    over = {str(line[0]): line[-1] for line in new_styles.ratios(found["styles"])}
    assert over["FiLM vector"] == pytest.approx(errors["FiLM vector"] / errors["nothing: mean style"])


def test_takes_are_grouped_by_motion(takes):
    some = [replace(takes.train[0], content=content) for content in ("walk-left", "walk-right", "dash", "walk-back")]
    groups: dict[str, list[Take]] = dict(by_content(some))
    assert {kind: len(own) for kind, own in groups.items()} == {"side": 2, "run": 1, "back": 1}


@pytest.mark.slow
def test_table2_models(tmp_path):
    config = table2_models.Config(tmp_path, num_joints=25, hidden=8, timed_frames=2, slices=4, repetitions=1)
    found = table2_models.main(config)
    for name, (synthesis, modulation, per_style, _) in table2_models.PAPER.items():
        row = found["rows"][name]
        assert (row["synthesis"], row["modulation as printed"], row["per style"]) == (synthesis, modulation, per_style)
        assert row["frame, ms"] > 0 and (row["frame by table, ms"] is None) == (not name.startswith("pfnn"))
    assert json.loads((tmp_path / "table2_models.json").read_text())["rows"] == found["rows"]
    assert len((tmp_path / "table2_models.md").read_text().splitlines()) == 2 + 2 * len(TABLE2)
