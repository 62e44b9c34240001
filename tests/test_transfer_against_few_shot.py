"""The comparison of style transfer with few-shot learning: its judge, its tables, and a small run of it."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path

import jax
import numpy as np
import pytest

from experiments.common.style_walk_judge import Takes, judge_clip, make_judge
from experiments.common.transfer_against_few_shot_table import pairwise
from experiments.transfer_against_few_shot import CONTENTS, NEUTRAL, NO_STYLE, Config, main, styles_of
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.transfer.autoencoder import init_autoencoder
from pfnn_jax.transfer.autoencoder_training import fit_statistics
from pfnn_jax.transfer.clip_rows import encode_clip
from pfnn_jax.transfer.config import AutoencoderConfig
from pfnn_jax.transfer.layout import HOLDEN2017
from pfnn_jax.transfer.run import create_transfer_run
from tests.raising import assert_refused
from tests.trained import walking_run

STYLE = "elderly"
WALKS = [{"style": style, "clip": clip, "fault": ""} for style in ("old", "proud") for clip in ("1", "2", "3")]


def value(measures: dict[str, float | None], name: str) -> float:
    """Returns a measure that must not be absent."""
    found = measures[name]
    assert found is not None, name
    return found


def test_real_walk_of_a_style_is_nearer_to_the_style_than_another_walk():
    clips = {
        style: [one.clip for one in synthetic_clips(style, 24.0, clip_seconds=6.0)] for style in ("neutral", "old")
    }
    content = clips["neutral"][0].content
    known, test = ({(style, content): own[half::2] for style, own in clips.items()} for half in (0, 1))
    judge = make_judge(Takes(known, test), epochs=2)
    neutral, style = test["neutral", content][0], known["old", content][0]
    real = judge_clip(test["old", content][0], neutral, style, judge, without=0)
    other = judge_clip(neutral, neutral, style, judge)
    assert value(real, "distance") < value(other, "distance") and value(real, "trunk") < value(other, "trunk")
    assert value(real, "style probability") > value(other, "style probability")


def test_difference_is_first_minus_second_on_the_same_contents():
    rng = np.random.default_rng(0)
    second = [{**walk, "method": "optimisation", "distance": rng.uniform(2, 4)} for walk in WALKS]
    first = [{**row, "method": "few-shot", "distance": row["distance"] - 1} for row in second]
    (line,) = pairwise([*first, *second[::-1]])
    assert line[:2] == ["few-shot", "optimisation"] and line[3] == "-1" and line[4] == "-1 to -1"
    assert line[5] == f"{len(WALKS)}/{len(WALKS)}"


def test_walks_without_a_measure_are_left_out_of_differences():
    first = [{**walk, "method": "few-shot", "distance": None if i else 1.0} for i, walk in enumerate(WALKS)]
    second = [{**walk, "method": "optimisation", "distance": 2.0} for walk in WALKS]
    (line,) = pairwise([*first, *second])
    assert line[5] == "1/1"


def test_unknown_style_is_refused(mocap, tmp_path):
    files = list_clips(mocap / "bandai-namco-2")
    make = partial(styles_of, files, Config(tmp_path, mocap, styles=("sleepy",)))
    assert_refused(make, place="style", value="sleepy", rule_mentions=STYLE)


@pytest.fixture(scope="module")
def result(mocap, tmp_path_factory):
    """Two takes of each content of two styles, on a small run and a random autoencoder."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "bandai-namco-2").mkdir()
    for style in (NEUTRAL, STYLE):
        for content in CONTENTS:
            for number in (1, 2):
                name = f"dataset-2_{content}_{style}_{number:03d}.bvh"
                shutil.copy(mocap / "bandai-namco-2" / name, folder / "bandai-namco-2" / name)
    rows = encode_clip(synthetic_clips("neutral", 6.0, clip_seconds=6.0)[0].clip, HOLDEN2017)
    autoencoder = init_autoencoder(AutoencoderConfig(filters=8), HOLDEN2017.size, key=jax.random.key(0))
    create_transfer_run(
        folder / "autoencoder", HOLDEN2017, synthetic_skeleton(), fit_statistics(rows, HOLDEN2017), autoencoder, {}
    )
    config = Config(
        tmp_path_factory.mktemp("out"),
        folder,
        Path(walking_run(tmp_path_factory).path),
        folder / "autoencoder",
        takes=1,
        epochs=1,
        classifier_epochs=1,
    )
    return config, main(config)


@pytest.mark.slow
def test_every_content_has_a_row_of_every_method(result):
    _, found = result
    for content in CONTENTS:
        methods = [row["method"] for row in found["rows"] if row["content"] == content]
        assert methods == ["real", "real, retargeted", "content", "optimisation", "fast network", "few-shot", NO_STYLE]


@pytest.mark.slow
def test_report_is_written(result):
    config, found = result
    assert json.loads((config.out / "report.json").read_text())["rows"] == found["rows"]
    assert "few-shot" in (config.out / "table.md").read_text()


@pytest.mark.slow
def test_clips_are_not_made_again(result):
    config, found = result
    files = {path: path.stat().st_mtime_ns for path in (config.out / "clips").iterdir()}
    assert main(config)["rows"] == found["rows"]
    assert files == {path: path.stat().st_mtime_ns for path in (config.out / "clips").iterdir()}
