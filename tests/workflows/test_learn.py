"""Learning a FiLM style for the released local-phase network from a real clip, and what is refused before training."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.control import stability as turning
from pfnn_jax.inference.mixture import load_choice
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.kinematics import quat_from_euler, quat_multiply
from pfnn_jax.motion.synthetic.walks import STYLES, synthesise, synthetic_clips
from pfnn_jax.run import load_run, load_style
from pfnn_jax.run_config import style_note
from pfnn_jax.training.config import (
    FILM_FEW_SHOT,
    MASON2018_FEW_SHOT,
    RESTYLED_FEW_SHOT,
    FewShotConfig,
    PretrainConfig,
    TuningConfig,
)
from pfnn_jax.workflows.learn import default_config, learn_style, tune_style
from pfnn_jax.workflows.pretrain import pretrain_run
from tests.raising import assert_refused
from tests.trained import walking_run


@pytest.fixture(scope="module")
def run(lpn_run, tmp_path_factory):
    path = tmp_path_factory.mktemp("learn") / "run"
    shutil.copytree(lpn_run.path, path)
    return load_run(path)


def angry(mocap, style="cross"):
    return ClipFile(mocap / "100style" / "Angry_FW.bvh", style, start=400, stop=640)


def test_a_film_is_learned_from_a_clip(run, mocap, monkeypatch):
    monkeypatch.setattr(turning, "SECONDS", 1.2)  # whether it is stable is not the question here
    config = replace(FILM_FEW_SHOT, learning_rates=(1e-3,), eval_epochs=(1,), tolerance=0.0)
    info = learn_style(run, angry(mocap), config, mirror=False)
    film, start = load_style(run, "cross"), load_choice(run, None)
    assert isinstance(film, FiLMStyle) and isinstance(start, FiLMStyle)
    # Six steps of Adam move no number by more than the rate each.
    moved = np.abs(np.asarray(film.scale) - np.asarray(start.scale)).max()
    assert 0.0 < moved < 7.5 * 1e-3
    assert info["frames"] == 238 and 0.3 < info["speed"] < 3.0
    assert info["warnings"] == style_note(run.path, "cross")["info"]["warnings"]
    assert not any("not a forward walk" in line or "mirror" in line for line in info["warnings"])


def test_a_side_step_is_learned_with_warnings(run, mocap, monkeypatch):
    monkeypatch.setattr(turning, "SECONDS", 1.2)
    config = replace(FILM_FEW_SHOT, learning_rates=(1e-3,), eval_epochs=(1,), tolerance=0.0)
    clip = ClipFile(mocap / "bandai-namco-1" / "dataset-1_walk-left_tired_001.bvh", "sideways")
    info = learn_style(run, clip, config)
    assert any("to the left of where the body faces" in line for line in info["warnings"])
    assert not info["mirrored"] and any(
        line.startswith("learned without the mirror image") for line in info["warnings"]
    )


def test_a_plain_walk_has_no_warning_and_one_whose_joints_shake_has_one(tmp_path_factory, tmp_path):
    shutil.copytree(walking_run(tmp_path_factory).path, tmp_path / "run")
    config = FewShotConfig("cp", 30, (1e-3,), (0.0,), (0.3,), eval_epochs=(10,))
    clip, _ = synthesise("proud", np.zeros(240), np.full(240, STYLES["proud"].speed), seed=9)
    write_bvh(tmp_path / "plain.bvh", clip)
    shaken, shake = clip.rotations.copy(), np.random.default_rng(0).normal(scale=0.5, size=(240, 12, 3))
    shaken[:, 1:13] = quat_multiply(shaken[:, 1:13], quat_from_euler(shake, "ZYX"))  # all joints above the hips
    write_bvh(tmp_path / "shaken.bvh", replace(clip, rotations=shaken))
    plain, bad = (learn_style(tmp_path / "run", tmp_path / f"{name}.bvh", config) for name in ("plain", "shaken"))
    assert plain["warnings"] == []
    assert any("held-out error" in line for line in bad["warnings"])


def test_a_run_with_differences_teaches_turns_and_one_without_takes_the_papers_recipe(tmp_path_factory, tmp_path):
    shutil.copytree(walking_run(tmp_path_factory).path, tmp_path / "run")
    with_differences = load_run(tmp_path / "run")
    assert default_config(with_differences) == RESTYLED_FEW_SHOT
    write_bvh(tmp_path / "mine.bvh", synthesise("old", np.zeros(200), np.ones(200))[0])
    shutil.rmtree(tmp_path / "run" / "differences")
    assert default_config(with_differences) == MASON2018_FEW_SHOT
    assert_refused(
        lambda: learn_style(with_differences, tmp_path / "mine.bvh", RESTYLED_FEW_SHOT),
        place="differences",
        value="absent",
    )


def test_a_clip_shorter_than_a_minibatch_is_learned_from_restyled_rows_too(tmp_path_factory, tmp_path):
    shutil.copytree(walking_run(tmp_path_factory).path, tmp_path / "run")
    write_bvh(tmp_path / "short.bvh", synthesise("old", np.zeros(100), np.ones(100), seed=3)[0])
    config = replace(RESTYLED_FEW_SHOT, eval_epochs=(2,))
    info = learn_style(tmp_path / "run", tmp_path / "short.bvh", config, mirror=False)
    assert info["frames"] < config.batch_size
    assert load_style(load_run(tmp_path / "run"), "short").config.kind == config.method


def test_a_style_that_does_not_fit_the_run_is_refused(run, mocap):
    assert_refused(
        lambda: learn_style(run, angry(mocap, "new"), FewShotConfig("cp")),
        place="adapter kind",
        value="cp",
    )
    assert_refused(lambda: tune_style(run, angry(mocap, "new"), TuningConfig()), place="generator", value="absent")


def test_paths_are_accepted_or_refused_before_any_work(run, tmp_path):
    absent = tmp_path / "absent.bvh"
    for path in (str(absent), absent):
        assert_refused(lambda clip=path: learn_style(run, clip), file="absent.bvh")
    assert_refused(lambda: learn_style(str(tmp_path / "none"), absent), rule_mentions="run directory")
    assert_refused(lambda: learn_style(run, 3), place="argument", value="int")  # type: ignore[arg-type]


def test_a_generator_is_tuned_to_a_clip_and_kept_as_it_was(tmp_path):
    """The style is what the tuned generator predicts; the run's own generator and network do not change."""
    clips = [clip for style in ("neutral", "proud") for clip in synthetic_clips(style, 8)]
    dataset = prepare(clips, tmp_path / "data", PrepareConfig(layout="mason2022"))
    small = PretrainConfig(
        AdapterConfig("film"), hidden=8, generator_filters=2, generator_width=3, generator_hidden=4, steps=2
    )
    run = pretrain_run(dataset, tmp_path / "run", small)
    write_bvh(tmp_path / "old.bvh", synthesise("old", np.zeros(200), np.ones(200))[0])
    files = {path: path.read_bytes() for path in (tmp_path / "run" / "generator").rglob("*") if path.is_file()}
    tuning = TuningConfig(steps=2, learning_rate=1e-2)
    info = tune_style(run, ClipFile(tmp_path / "old.bvh", "old"), tuning)
    film = load_style(run, "old")
    assert isinstance(film, FiLMStyle) and np.isfinite(film.scale).all() and info["frames"] > 150 and info["mirrored"]
    assert all(path.read_bytes() == content for path, content in files.items())
    untuned = tune_style(run, ClipFile(tmp_path / "old.bvh", "same"), replace(tuning, learning_rate=1e-12))
    assert untuned["loss"] != info["loss"]
    # At this rate nothing is learned: the style stays the generator's, near the mean of the run's styles.
    assert 0 < info["held_out_error"] != untuned["held_out_error"] and info["error_without_style"] > 0
    assert any("held-out error" in line for line in info["warnings"]) and isinstance(info["stable_on_turns"], bool)
    same = load_style(run, "same")
    assert isinstance(same, FiLMStyle) and np.abs(np.asarray(film.shift) - np.asarray(same.shift)).max() > 1e-4
