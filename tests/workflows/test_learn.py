"""A style learned beside the released local-phase network: as a Film, from a real clip, without a trace of failure."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from pfnn_jax.control import stability as turning
from pfnn_jax.errors import InputError
from pfnn_jax.inference.mixture import load_choice
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.models.layers.film import FiLMStyle
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_clips
from pfnn_jax.run import load_run, load_style
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.few_shot_learning import FewShotConfig
from pfnn_jax.training.tuning import TuningConfig
from pfnn_jax.workflows.learn import learn_style, tune_style
from pfnn_jax.workflows.pretrain import pretrain_run


@pytest.fixture(scope="module")
def run(lpn_run, tmp_path_factory):
    path = tmp_path_factory.mktemp("learn") / "run"
    shutil.copytree(lpn_run.path, path)
    return load_run(path)


def angry(mocap, style="cross"):
    return ClipFile(mocap / "100style" / "Angry_FW.bvh", style, start=400, stop=640)


def test_a_film_is_learned_from_a_clip(run, mocap, monkeypatch):
    monkeypatch.setattr(turning, "SECONDS", 1.2)  # whether it is stable is not the question here
    config = FewShotConfig("film", learning_rates=(1e-3,), main_dropouts=(0.0,), eval_epochs=(1,), tolerance=0.0)
    info = learn_style(run, angry(mocap), config, mirror=False)
    film, start = load_style(run, "cross"), load_choice(run, None)
    assert isinstance(film, FiLMStyle) and isinstance(start, FiLMStyle)
    # Six steps of Adam move no number by more than the rate each.
    moved = np.abs(np.asarray(film.scale) - np.asarray(start.scale)).max()
    assert 0.0 < moved < 7.5 * 1e-3
    assert info["frames"] == 238 and 0.3 < info["speed"] < 3.0


def test_requests_that_cannot_be_met(run, mocap):
    with pytest.raises(InputError, match="adapter kind: cp; must be film"):
        learn_style(run, angry(mocap, "new"), FewShotConfig("cp"))
    with pytest.raises(InputError, match="generator: absent"):
        tune_style(run, angry(mocap, "new"), TuningConfig())


def test_a_generator_is_tuned_to_a_clip_and_kept_as_it_was(tmp_path):
    """The style is the Film of the tuned generator; the run's own generator and network do not change."""
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
    same = load_style(run, "same")
    assert isinstance(same, FiLMStyle) and np.abs(np.asarray(film.shift) - np.asarray(same.shift)).max() > 1e-4
