"""Pretraining on disk: killed at any moment, it goes on as if nothing had happened."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
import pytest

from pfnn_jax.errors import TrainingError
from pfnn_jax.inference.rows import predict_rows
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.synthetic.walks import synthetic_clips
from pfnn_jax.run import load_generator, load_run, load_style, load_train_state
from pfnn_jax.run_config import list_styles, style_note, train_step
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.film_styles import mean_styles
from pfnn_jax.training.log import read_metrics
from pfnn_jax.training.loop import Progress
from pfnn_jax.training.order import order_of
from pfnn_jax.training.pretraining import init_state
from pfnn_jax.workflows.pretrain import pretrain_run
from tests.raising import assert_refused

CONFIG = PretrainConfig(
    adapter=AdapterConfig(rank=2), hidden=8, steps=60, batch_size=16, steps_per_dispatch=5, save_every=10
)

ERROR = 1e-4  # float32, in layout units and in normalised ones

ROOT = Path(__file__).resolve().parents[2]

KILLED = """
import sys, time
from pfnn_jax.motion.datasets.dataset import load_dataset
from pfnn_jax.workflows.pretrain import pretrain_run
from tests.workflows.test_pretrain import CONFIG
def progress_callback(progress):
    print(progress.step, flush=True)
    time.sleep(0.05)
pretrain_run(load_dataset(sys.argv[1]), sys.argv[2], CONFIG, progress_callback=progress_callback)
"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    clips = [clip for style in ("neutral", "old") for clip in synthetic_clips(style, 3.0)]
    return prepare(clips, tmp_path_factory.mktemp("data") / "dataset", PrepareConfig())


@pytest.fixture(scope="module")
def whole(dataset, tmp_path_factory):
    """A run that nothing interrupted."""
    return pretrain_run(dataset, tmp_path_factory.mktemp("whole") / "run", CONFIG)


def parameters(run):
    return [run.shared, *(load_style(run, style) for style in list_styles(run.path))]


def assert_bitwise_equal(a, b):
    for one, other in zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True):
        np.testing.assert_array_equal(np.asarray(one), np.asarray(other))


def test_a_run_holds_what_pretraining_learned(whole, dataset):
    assert list_styles(whole.path) == ("neutral", "old") == whole.config.styles
    assert {style_note(whole.path, style)["info"]["source"] for style in whole.config.styles} == {"dataset"}
    assert whole.layout.input_size == dataset.layout.input_size
    records = read_metrics(whole.path)
    assert [record["step"] for record in records] == list(range(5, 61, 5))
    assert records[-1]["loss"] < records[0]["loss"]


def test_each_style_keeps_its_error_on_rows_that_training_did_not_see(whole, dataset, tmp_path):
    """A dataset without validation rows leaves the training rows."""
    clips = [clip for style in ("neutral", "old") for clip in synthetic_clips(style, 3.0)]
    split = prepare(clips, tmp_path / "data", PrepareConfig(validation=0.2))
    for run, data, name in (
        (whole, dataset, "train"),
        (pretrain_run(split, tmp_path / "run", CONFIG), split, "validation"),
    ):
        for style in run.config.styles:
            info = style_note(run.path, style)["info"]
            x, y, phase = data.arrays(style, name)
            predicted = predict_rows(run, x, phase, style)
            off = (predicted - y) / run.normaliser.outputs.std
            assert info["error_split"] == name
            np.testing.assert_allclose(info["error"], np.mean(off**2), rtol=ERROR)


def test_killed_and_resumed_is_bit_for_bit_the_same(dataset, whole, tmp_path):
    out = tmp_path / "run"
    command = [sys.executable, "-c", KILLED, str(dataset.path), str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        while int(process.stdout.readline()) < 25:
            pass
        process.send_signal(signal.SIGKILL)
    saved = train_step(out)
    assert saved is not None and CONFIG.steps is not None and 0 < saved < CONFIG.steps
    assert_refused(lambda: load_run(out), place="shared", value="absent")
    resumed = pretrain_run(dataset, out, CONFIG, resume=True)
    assert_bitwise_equal(parameters(resumed), parameters(whole))
    assert [record["loss"] for record in read_metrics(out)] == [record["loss"] for record in read_metrics(whole.path)]


def test_a_run_killed_before_its_first_save_restarts(dataset, whole, tmp_path):
    out = tmp_path / "run"

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        pretrain_run(dataset, out, CONFIG, progress_callback=stop)
    assert train_step(out) is None
    assert_bitwise_equal(parameters(pretrain_run(dataset, out, CONFIG, resume=True)), parameters(whole))


def test_a_run_is_resumed_only_with_its_own_settings(dataset, whole):
    assert_refused(
        lambda: pretrain_run(dataset, whole.path, replace(CONFIG, learning_rate=1e-3), resume=True),
        place="pretrain",
        rule_mentions="started with",
    )


def test_a_run_from_before_precision_was_a_setting_is_resumed(dataset, whole, tmp_path):
    """On processors it was trained in float32, the default."""
    old = shutil.copytree(whole.path, tmp_path / "run")
    written = json.loads((old / "config.json").read_text())
    del written["pretrain"]["precision"]
    (old / "config.json").write_text(json.dumps(written))
    assert_bitwise_equal(parameters(pretrain_run(dataset, old, CONFIG, resume=True)), parameters(whole))
    assert_refused(
        lambda: pretrain_run(dataset, old, replace(CONFIG, precision="tf32"), resume=True),
        place="pretrain",
        value="precision float32 differs from the settings given now",
    )


def test_an_existing_run_is_refused_and_left_alone(dataset, whole):
    before = (whole.path / "config.json").read_bytes()
    assert_refused(lambda: pretrain_run(dataset, whole.path, CONFIG), place="output", value="exists")
    assert (whole.path / "config.json").read_bytes() == before


def test_training_a_finished_run_longer_is_training_it_once(dataset, whole, tmp_path):
    """20 steps are 10 steps and 10 more, also where the first training ended within a dispatch."""
    out = tmp_path / "run"
    short = pretrain_run(dataset, out, replace(CONFIG, steps=23))
    assert short.fingerprint != whole.fingerprint
    longer = pretrain_run(dataset, out, CONFIG, resume=True)
    assert_bitwise_equal(parameters(longer), parameters(whole))
    assert longer.config == whole.config
    assert_refused(
        lambda: pretrain_run(dataset, out, replace(CONFIG, steps=23), resume=True),
        place="steps",
        value=23,
    )


def test_an_unfinished_run_names_resuming_first(dataset, tmp_path):
    def stop(progress):
        if progress.step == 25:
            raise KeyboardInterrupt

    out = tmp_path / "run"
    with pytest.raises(KeyboardInterrupt):
        pretrain_run(dataset, out, CONFIG, progress_callback=stop)
    refused = assert_refused(
        lambda: pretrain_run(dataset, out, CONFIG), place="run", value="unfinished at step 20 of 60"
    )
    assert refused.rule.index("resume=True") < refused.rule.index("overwrite=True")


def test_a_style_with_fewer_rows_than_a_batch_is_refused_before_anything_is_written(dataset, tmp_path):
    large = replace(CONFIG, batch_size=10_000)
    assert_refused(lambda: pretrain_run(dataset, tmp_path / "run", large), rule_mentions="batch_size 10000")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("kind", [str, Path])
def test_a_dataset_may_be_given_by_its_folder(dataset, tmp_path, kind):
    absent = kind(tmp_path / "absent")
    assert_refused(lambda: pretrain_run(absent, tmp_path / "run"), file="dataset.json", place="file")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "sizes", [{"hidden": -4}, {"rank": 0}, {"gating_hidden": 0}, {"num_control_points": 0}, {"generator_filters": 0}]
)
def test_sizes_that_no_network_has_are_refused_with_the_settings(sizes):
    with pytest.raises(ValueError, match="must be at least 1, got"):
        PretrainConfig(**sizes)


def test_sizes_that_the_layout_cannot_have_are_refused_before_anything_is_written(dataset, tmp_path):
    assert PretrainConfig(num_control_points=3)  # experts of a gating network may be so few
    wrong = replace(CONFIG, num_control_points=3)
    refused = assert_refused(lambda: pretrain_run(dataset, tmp_path / "run", wrong), place="layout mason2018")
    assert "num_control_points" in str(refused.value)
    assert not (tmp_path / "run").exists()


def test_training_that_turns_non_finite_keeps_the_last_good_save(dataset, tmp_path):
    out, wild = tmp_path / "run", replace(CONFIG, learning_rate=1e30, save_every=1, steps_per_dispatch=1)
    with pytest.raises(TrainingError, match=r"step \d+, style (neutral|old): loss is (nan|inf)"):
        pretrain_run(dataset, out, wild)
    losses = [json.loads(line)["loss"] for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert np.isfinite(losses).all()
    assert train_step(out) == len(losses)


def test_rows_on_disk_are_those_in_memory(dataset):
    stored, memory = Rows.from_dataset(dataset, max_bytes=0), Rows.from_dataset(dataset)
    assert len(stored.parts) == 2 and len(memory.parts) == 1
    assert memory.nbytes == stored.nbytes
    draw = order_of(memory, 16, seed=0, num_clips=2).draw(0, 4)
    assert_bitwise_equal(stored.gather(draw), memory.gather(draw))


def test_a_film_run_from_disk_is_the_one_from_memory_and_holds_its_generator(dataset, tmp_path):
    config = replace(
        CONFIG,
        adapter=AdapterConfig("film"),
        steps=10,
        clips_per_batch=2,
        generator_filters=4,
        generator_width=5,
        generator_hidden=8,
    )
    memory = pretrain_run(dataset, tmp_path / "memory", config)
    disk = pretrain_run(dataset, tmp_path / "disk", replace(config, device_bytes=0))
    assert_bitwise_equal(parameters(memory), parameters(disk))
    sizes, generator = memory.config.generator, load_generator(memory)
    assert sizes is not None
    assert_bitwise_equal(generator, load_generator(disk))
    films = mean_styles(generator, Rows.from_dataset(dataset))
    for index, style in enumerate(dataset.styles):
        assert_bitwise_equal(load_style(memory, style), jax.tree.map(lambda leaf, i=index: leaf[i], films))


def test_data_that_is_removed_while_it_is_read_from_disk_is_named(dataset, tmp_path):
    """What was saved before stays, and loads."""
    path = shutil.copytree(dataset.path, tmp_path / "data")
    config = replace(CONFIG, steps=5000, steps_per_dispatch=5, save_every=5, device_bytes=0)

    def remove(progress: Progress) -> None:
        if progress.step == 10:
            shutil.rmtree(path / dataset.styles[0])

    refused = assert_refused(lambda: pretrain_run(path, tmp_path / "run", config, progress_callback=remove))
    assert refused.file.startswith(str(path / dataset.styles[0]))
    assert "prepare" in refused.rule
    data = Rows.from_dataset(dataset)
    state = jax.eval_shape(lambda: init_state(config, data.layout, len(dataset.styles)))
    assert train_step(tmp_path / "run") is not None and load_train_state(tmp_path / "run", state) is not None
