"""Training by commands in two processes: one is killed, the other says so, and both resume the run."""

from __future__ import annotations

import json
import signal
import subprocess
import time
from pathlib import Path

import jax
import numpy as np
import pytest

from pfnn_jax.cli.command_line import TRY_AGAIN, in_options
from pfnn_jax.cli.several_hosts import HostsConfig, how_it_ended
from pfnn_jax.errors import InputError, LostProcessError
from pfnn_jax.models.config import AdapterConfig
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_clips
from pfnn_jax.run import load_run, load_style
from pfnn_jax.run_config import train_step
from pfnn_jax.training.config import PretrainConfig, TuningConfig
from pfnn_jax.training.log import read_metrics
from pfnn_jax.workflows.learn import tune_style
from pfnn_jax.workflows.pretrain import pretrain_run
from tests.training.processes import LONGEST, free_port, outputs, start

PROGRAM = "from pfnn_jax.cli import main; main()"
ENDLESS = 1_000_000  # steps
SUMS = 1e-5  # relative, of losses of some hundred steps: devices are summed in another order
SETTINGS = "--adapter.rank 2 --hidden 8 --batch-size 16 --steps-per-dispatch 5 --save-every 10".split()


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    clips = [clip for style in ("neutral", "old") for clip in synthetic_clips(style, 3.0)]
    return prepare(clips, tmp_path_factory.mktemp("data") / "dataset", PrepareConfig())


def config(steps: int) -> PretrainConfig:
    return PretrainConfig(
        AdapterConfig(rank=2), hidden=8, batch_size=16, steps_per_dispatch=5, save_every=10, steps=steps
    )


def pretraining(number: int, port: int, steps: int, *words: object) -> subprocess.Popen[str]:
    """Starts `pretrain` in one of two processes."""
    hosts = ("--coordinator", f"127.0.0.1:{port}", "--process-id", number, "--processes", 2)
    return start("-c", PROGRAM, "pretrain", *words, *SETTINGS, "--steps", steps, *hosts)


def resume(dataset: Path, out: Path, steps: int, result: Path) -> None:
    """Resumes a run in two processes, by the same command line but for their numbers."""
    words, port = (dataset, "--out", out, "--resume", "--json", result), free_port()
    outputs([pretraining(number, port, steps, *words) for number in range(2)])


def test_when_one_process_is_killed_the_other_ends_and_the_run_resumes(dataset, tmp_path):
    out, port, deadline = tmp_path / "run", free_port(), time.monotonic() + LONGEST
    first = pretraining(0, port, ENDLESS, dataset.path, "--out", out)
    other = pretraining(1, port, ENDLESS, dataset.path, "--out", tmp_path / "elsewhere")
    try:
        while len(read_metrics(out)) < 5 or train_step(out) is None:
            assert first.poll() is None and other.poll() is None and time.monotonic() < deadline
            time.sleep(0.1)
        first.send_signal(signal.SIGKILL)
        output, errors = other.communicate(timeout=LONGEST)
    finally:
        for process in (first, other):
            process.kill()
            process.communicate()  # closes its pipes
    assert (other.returncode, output) == (TRY_AGAIN, "")
    assert len(errors.splitlines()) == 1
    assert errors.startswith("pfnn-jax: training: another process is lost: ")
    assert not (tmp_path / "elsewhere").exists()

    saved = train_step(out)
    assert saved is not None
    resume(dataset.path, out, saved + 10, result := tmp_path / "result.json")
    assert json.loads(result.read_text())["styles"] == ["neutral", "old"]
    pretrain_run(dataset, tmp_path / "whole", config(saved + 10))
    losses = [[record["loss"] for record in read_metrics(run)] for run in (out, tmp_path / "whole")]
    np.testing.assert_allclose(*losses, rtol=SUMS)


def test_two_processes_tune_a_generator_as_one(tmp_path):
    """Process 0 saves the style; both have the run and the clip."""
    clips = [clip for style in ("neutral", "proud") for clip in synthetic_clips(style, 8)]
    data = prepare(clips, tmp_path / "data", PrepareConfig(layout="mason2022"))
    small = PretrainConfig(
        AdapterConfig("film"), hidden=8, generator_filters=2, generator_width=3, generator_hidden=4, steps=2
    )
    run = pretrain_run(data, tmp_path / "run", small).path
    clip, port = tmp_path / "old.bvh", free_port()
    write_bvh(clip, synthesise("old", np.zeros(200), np.ones(200))[0])
    words = ("few-shot", run, clip, "--name", "both", "--recipe", "generator", "--tuning.steps", 4)
    hosts = ("--coordinator", f"127.0.0.1:{port}", "--processes", 2, "--process-id")
    outputs([start("-c", PROGRAM, *words, *hosts, number) for number in range(2)])
    info = tune_style(run, ClipFile(clip, "one"), TuningConfig(steps=4))
    found, expected = (load_style(load_run(run), name) for name in ("both", "one"))
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=SUMS), found, expected)
    saved = json.loads((run / "styles" / "both" / "style.json").read_text())["info"]
    assert saved["loss"] == pytest.approx(info["loss"], rel=SUMS)


ABORTED = "F1129 client.h:80] Terminating process because the JAX distributed service detected fatal errors. "
SILENT = "absl::Status: UNAVAILABLE: The following tasks are unhealthy (stopped sending heartbeats):\n1\nThe tasks have"
GONE = "absl::Status: UNAVAILABLE: Failed to send RPC to coordination service."
NEVER_MET = "absl::Status: DEADLINE_EXCEEDED: Deadline Exceeded\n\nRPC: /xla.CoordinationService/RegisterTask"
HOSTS = HostsConfig("node0:1234", 1, 2)


@pytest.mark.parametrize(
    ("code", "messages", "kind", "said"),
    [
        (-6, ABORTED + SILENT, LostProcessError, "no sign of life from process 1;"),
        (-6, ABORTED + GONE, LostProcessError, "process 0 has ended, or cannot be reached any more;"),
        (-6, ABORTED + NEVER_MET, InputError, "no answer from node0:1234;"),
        (-9, "", InputError, "was ended by SIGKILL;"),
        (1, "", SystemExit, "1"),
    ],
)
def test_the_end_of_a_process_is_said_in_one_line(code, messages, kind, said):
    error = how_it_ended(code, messages, HOSTS)
    assert type(error) is kind
    assert said in str(error) and "\n" not in str(error)


def test_a_lost_process_is_answered_by_resuming():
    assert in_options(str(LostProcessError("process 1"))).endswith(
        "start all processes again, a pretraining with --resume"
    )


@pytest.mark.parametrize(
    "options",
    [
        {"process_id": 0},
        {"coordinator": "auto", "processes": 2},
        {"coordinator": "node0"},
        {"coordinator": "node0:1234"},
        {"coordinator": "node0:1234", "process_id": 2, "processes": 2},
        {"coordinator": "node0:70000", "process_id": 0, "processes": 2},
    ],
)
def test_options_that_connect_nobody_are_refused(options):
    with pytest.raises(ValueError, match="HostsConfig"):
        HostsConfig(**options)
