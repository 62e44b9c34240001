"""A style learned beside the released local-phase network: as a Film, from a real clip, without a trace of failure."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.models.film import Film
from pfnn_jax.motion.sources import ClipFile
from pfnn_jax.runtime import turning
from pfnn_jax.runtime.learn import learn_style, tune_style
from pfnn_jax.runtime.mixture import load_choice
from pfnn_jax.training.few_shot import FewShotConfig
from pfnn_jax.training.generator_tuning import TuningConfig
from pfnn_jax.training.run import load_run, load_style


@pytest.fixture(scope="module")
def run(lpn_run, tmp_path_factory):
    path = tmp_path_factory.mktemp("learn") / "run"
    shutil.copytree(lpn_run.path, path)
    return load_run(path)


def angry(mocap, style="cross"):
    return ClipFile(mocap / "100style" / "Angry_FW.bvh", style, start=400, stop=640)


def test_a_film_is_learned_from_a_clip(run, mocap, monkeypatch):
    monkeypatch.setattr(turning, "SECONDS", 1.2)  # whether it is stable is not the question here
    config = FewShotConfig("film", learning_rates=(1e-3,), main_dropouts=(0.0,), stops=(1,), tolerance=0.0)
    info = learn_style(run, angry(mocap), config, mirror=False)
    film, start = load_style(run, "cross"), load_choice(run, None)
    assert isinstance(film, Film) and isinstance(start, Film)
    # Six steps of Adam move no number by more than the rate each.
    moved = np.abs(np.asarray(film.scale) - np.asarray(start.scale)).max()
    assert 0.0 < moved < 7.5 * 1e-3
    assert info["frames"] == 238 and 0.5 < info["speed"] < 3.0


def test_requests_that_cannot_be_met(run, mocap):
    with pytest.raises(InputError, match="adapter kind: cp; must be film"):
        learn_style(run, angry(mocap, "new"), FewShotConfig("cp"))
    with pytest.raises(InputError, match="generator: absent"):
        tune_style(run, angry(mocap, "new"), TuningConfig())
