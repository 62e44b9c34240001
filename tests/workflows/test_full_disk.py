"""A disk that is full or cannot be written, and a folder that goes away: one line, code 2, and nothing half-written."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pfnn_jax.io import files
from pfnn_jax.io.files import copy_once, replacing
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.workflows.pretrain import pretrain_run
from tests.raising import assert_refused
from tests.two_styles import prepare_two_styles, write_two_styles
from tests.writers import ROOT

resource = pytest.importorskip("resource", reason="the system has no limits of the size of files")

LIMITED = """
import resource, sys
from pfnn_jax.cli import main
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]),) * 2)  # no file grows beyond this, as on a full disk
main(sys.argv[2:])
"""

TINY = PretrainConfig(hidden=8, steps=20, batch_size=16, steps_per_dispatch=5, save_every=5)


@pytest.fixture(scope="module")
def clips(tmp_path_factory):
    return write_two_styles(tmp_path_factory.mktemp("clips"), 120)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return prepare_two_styles(tmp_path_factory.mktemp("data") / "dataset")


def run_limited(limit: int, *words: str | Path) -> subprocess.CompletedProcess:
    # Compiled code that is cut off at the limit would stay in the cache of all tests.
    settings = {"COLUMNS": "400", "JAX_ENABLE_COMPILATION_CACHE": "0"}
    command = [sys.executable, "-c", LIMITED, str(limit), *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, env={**os.environ, **settings})


@pytest.mark.parametrize("limit", [200, 100_000])
def test_prepare_on_a_full_disk_is_one_line_and_leaves_nothing(clips, tmp_path, limit):
    out = tmp_path / "data"
    ended = run_limited(limit, "prepare", clips, "--out", out)
    assert ended.returncode == 2 and ended.stderr.splitlines()[-1].startswith(f"pfnn-jax: {out}: "), ended.stderr
    assert "Traceback" not in ended.stderr and not list(tmp_path.iterdir())


def test_pretrain_on_a_full_disk_is_one_line_and_keeps_what_was_saved(dataset, tmp_path):
    """The configuration fits into 20 kB, the state of training does not."""
    out = tmp_path / "run"
    names = ("hidden", "steps", "batch_size", "save_every", "steps_per_dispatch")
    options = [word for name in names for word in (f"--{name.replace('_', '-')}", str(getattr(TINY, name)))]
    ended = run_limited(20_000, "pretrain", dataset.path, "--out", out, *options)
    last = ended.stderr.splitlines()[-1]
    assert ended.returncode == 2 and last.startswith(f"pfnn-jax: {out}"), ended.stderr
    assert "File too large" in last and "Traceback" not in ended.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert not [path for path in out.rglob("*") if path.name.endswith(".new")]
    pretrain_run(dataset, out, TINY, resume=True)


def test_a_run_that_is_removed_while_it_is_trained_is_not_made_again(dataset, tmp_path):
    out = tmp_path / "run"

    def remove(progress):
        shutil.rmtree(out, ignore_errors=True)

    refused = assert_refused(lambda: pretrain_run(dataset, out, TINY, progress_callback=remove))
    assert refused.file.startswith(str(out)) and not list(tmp_path.iterdir())


def test_a_file_in_a_folder_that_cannot_be_written_is_one_line(tmp_path, monkeypatch):
    """The superuser may write everywhere, so the refusal is simulated."""

    def refuse(self, *args, **options):
        raise OSError(30, "Read-only file system", str(self))

    monkeypatch.setattr(Path, "write_text", refuse)
    with pytest.raises(files.InputError) as caught:
        files.write_json(tmp_path / "config.json", {})
    error = caught.value
    assert (error.file, error.place, error.value) == (str(tmp_path / "config.json"), "output", "Read-only file system")
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_removed_while_it_is_written_is_one_line(tmp_path):
    def write():
        with replacing(tmp_path / "folder" / "file") as new:
            shutil.rmtree(tmp_path / "folder")
            new.write_text("text")

    assert_refused(write, file="file", place="output", value="No such file or directory")
    assert not list(tmp_path.iterdir())


def test_errors_of_other_files_keep_their_names(tmp_path):
    def read():
        with replacing(tmp_path / "folder" / "file"):
            (tmp_path / "elsewhere" / "input").read_text()

    with pytest.raises(FileNotFoundError, match="input"):
        read()


@pytest.mark.parametrize("hours", [-1000.0, 1000.0])
def test_a_clock_that_jumps_loses_no_copy(tmp_path, monkeypatch, hours):
    """Another process, whose clock is ahead, takes the unfinished copy for an abandoned one."""
    source, real = tmp_path / "source", files.time.time
    source.mkdir()
    (source / "file").write_text("text")
    copies, times = files._copy_files, []

    def copy(source, new):
        copies(source, new)
        if not times:
            times.append(real())
            monkeypatch.setattr(files.time, "time", lambda: real() + 3600 * hours)
            files._remove_abandoned(tmp_path / "target")

    monkeypatch.setattr(files, "_copy_files", copy)
    assert copy_once(source, tmp_path / "target")
    assert (tmp_path / "target" / "file").read_text() == "text"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["source", "target"]
