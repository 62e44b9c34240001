"""A run that one process writes is refused to every other command that would write it, and stays as it is."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pfnn_jax.run_config import check_new_run
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.viewer.page.style_files import delete_style, rename_style, restore_style
from pfnn_jax.workflows.base import BASE_NETWORK
from pfnn_jax.workflows.learn import learn_style, tune_style
from pfnn_jax.workflows.pretrain import pretrain_run
from pfnn_jax.workflows.runs import import_released
from pfnn_jax.workflows.share_style import export_style, import_style
from pfnn_jax.workflows.transfer_training import train_transfer
from tests.raising import assert_refused
from tests.two_styles import prepare_two_styles, write_two_styles
from tests.writers import another_writer


def files(folder: Path) -> dict[str, tuple[int, int]]:
    """Returns size and time of every file of a folder."""
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(path): (path.stat().st_size, path.stat().st_mtime_ns) for path in found}


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    return write_two_styles(tmp_path_factory.mktemp("clips"), 180)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return prepare_two_styles(tmp_path_factory.mktemp("data") / "dataset")


def test_what_another_process_writes_is_refused_by_name(clips, dataset, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(BASE_NETWORK, run)
    export_style(run, "neutral", tmp_path / "neutral.safetensors")
    deleted = delete_style(run, "neutral")
    before = files(run)
    tiny = PretrainConfig(hidden=8, steps=2, batch_size=16)
    writers = {
        "pretrain": lambda: pretrain_run(dataset, run, tiny, overwrite=True),
        "resume": lambda: pretrain_run(dataset, run, tiny, resume=True),
        "few-shot": lambda: learn_style(run, clips / "old" / "walk.bvh"),
        "tune": lambda: tune_style(run, clips / "old" / "walk.bvh"),
        "style import": lambda: import_style(run, tmp_path / "neutral.safetensors"),
        "train-transfer": lambda: train_transfer(clips, "old", run),
        "import-released": lambda: import_released("lpn", tmp_path, run, overwrite=True),
        "rename": lambda: rename_style(run, "old", "another"),
        "delete": lambda: delete_style(run, "old"),
        "restore": lambda: restore_style(run, deleted),
    }
    with another_writer(run) as process:
        for write in writers.values():
            refused = assert_refused(write, file=run, place="run", rule_mentions="one process at a time")
            assert f"process {process.pid} on " in str(refused.value)
    assert files(run) == before


def test_a_run_that_is_being_trained_is_not_offered_to_be_resumed(tmp_path):
    run = tmp_path / "run"
    shutil.copytree(BASE_NETWORK, run)
    shutil.rmtree(run / "shared")
    with another_writer(run) as process:
        refused = assert_refused(lambda: check_new_run(run), place="run", rule_mentions="wait")
        assert f"process {process.pid} on " in str(refused.value)
    assert_refused(lambda: check_new_run(run), place="run", rule_mentions="resume=True")
