"""The end of `play`: at once, even while something is compiled, without error output, with the right exit code."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from pfnn_jax.cli import main
from pfnn_jax.errors import InputError
from pfnn_jax.viewer.page import background, play

AT_ONCE = 15.0  # seconds, on a loaded machine; compiling takes longer
TIMEOUT_SECONDS = 120.0  # seconds until it compiles
PROGRAM = "from pfnn_jax.cli import main; main()"
FAILING = """
import threading, time
from pfnn_jax.viewer.page import background
threading.Thread(target=background.do, args=(lambda: time.sleep(600),), daemon=True).start()
while not background._working:
    time.sleep(0.01)
background.leave_work({left})
with background.ends_with():
    raise SystemExit({ended})
"""


@pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals")
def test_a_signal_ends_the_page_while_it_compiles(played_run, tmp_path: Path):
    pytest.importorskip("viser", reason="viser is not installed")
    result = tmp_path / "result.json"
    command = [sys.executable, "-c", PROGRAM, "play", str(played_run), "--port", "0", "--json", str(result)]
    with (
        open(tmp_path / "errors", "w+") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as program,
    ):
        too_late = threading.Timer(TIMEOUT_SECONDS, program.kill)
        too_late.start()
        assert program.stdout is not None
        assert any("compiling" in line for line in iter(program.stdout.readline, "")), "it announces compiling"
        too_late.cancel()
        time.sleep(0.5)
        program.send_signal(signal.SIGTERM)
        rest, _ = program.communicate(timeout=AT_ONCE)
        errors.seek(0)
        complaints = [line for line in errors if any(word in line for word in ("Traceback", "FATAL", "terminate"))]
    assert (program.returncode, complaints) == (0, [])
    assert rest.endswith("Ended.\n")
    assert json.loads(result.read_text()) == {"runs": [str(played_run)]}


@pytest.mark.parametrize(("left", "ended"), [(2, 2), (0, 2), (0, 0)])
def test_a_failure_keeps_its_code_while_something_compiles(left, ended):
    """The code of the page, or of a later failure such as a result that cannot be written."""
    program = [sys.executable, "-c", FAILING.format(left=left, ended=ended)]
    process = subprocess.run(program, capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    assert (process.returncode, process.stderr) == (ended, "")


HOLDING = """
import threading, time
from pfnn_jax.viewer.page import background
def hold():
    with background.temporary_folder() as folder:
        print(folder, flush=True)
        background.do(lambda: time.sleep(600))
threading.Thread(target=hold, daemon=True).start()
while not background._working:
    time.sleep(0.01)
background.leave_work(0)
"""


def test_temporary_files_of_work_that_is_left_are_removed():
    process = subprocess.run([sys.executable, "-c", HOLDING], capture_output=True, text=True, timeout=TIMEOUT_SECONDS)
    assert process.returncode == 0 and process.stdout and not Path(process.stdout.strip()).exists()


def test_a_result_that_cannot_be_written_sets_the_exit_code(monkeypatch, played_run, tmp_path: Path):
    """The page ends while it compiles, and the file of the result is in a folder that does not exist."""
    codes = []
    monkeypatch.setattr(background, "leave_work", codes.append)
    monkeypatch.setattr(background, "_left", True)
    monkeypatch.setattr(play, "play", lambda *_, **__: background.leave_work(0))
    with pytest.raises(SystemExit):
        main(["play", str(played_run), "--json", str(tmp_path / "nowhere" / "result.json")])
    assert codes == [0, 2]


def test_the_port_is_taken_before_anything_is_loaded(monkeypatch, capsys):
    """No other program can take it meanwhile, and the address is printed with the progress."""
    pytest.importorskip("viser", reason="viser is not installed")
    monkeypatch.setattr(background, "leave_work", lambda code: None)
    answers = []

    def load(*_: object) -> None:
        found = re.search(r"compiling; the page is open at http://127.0.0.1:(\d+):", capsys.readouterr().out)
        assert found is not None
        with socket.create_connection(("127.0.0.1", int(found[1])), timeout=AT_ONCE):
            answers.append(found[1])
        with pytest.raises(InputError, match="port"):
            play.check_address("127.0.0.1", int(found[1]))
        raise InputError("run", "config", "none", "must be there")

    monkeypatch.setattr(play, "standing_body", lambda *_: None)
    monkeypatch.setattr(play, "RunLibrary", load)
    monkeypatch.setattr(play, "check_finished", lambda _: None)
    with pytest.raises(InputError, match="config"):
        play.play(["run"], port=0, keep_compiled=False)
    assert len(answers) == 1


@pytest.mark.parametrize(("error", "code"), [(InputError("page", "port", 1, "is taken"), 2), (MemoryError(), 1)])
def test_a_page_that_cannot_start_lets_the_program_end(monkeypatch, error, code):
    """A port that is taken, or a failure while a step is compiled."""
    pytest.importorskip("viser", reason="viser is not installed")
    codes = []

    def fail(**_: object) -> None:
        raise error

    monkeypatch.setattr(play, "standing_body", lambda *_: None)
    monkeypatch.setattr(play, "RunLibrary", lambda *_: SimpleNamespace(runs=(), styles=(), warm_up=lambda: None))
    monkeypatch.setattr(play, "Page", fail)
    monkeypatch.setattr(play, "check_finished", lambda _: None)
    monkeypatch.setattr(background, "leave_work", codes.append)
    with pytest.raises(type(error)):
        play.play(["run"], port=0, keep_compiled=False)
    assert codes == [code]


def test_without_viser_nothing_is_loaded(monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    monkeypatch.setattr(background, "leave_work", lambda code: None)
    with pytest.raises(InputError, match=r"viser: not installed; .*pfnn-jax\[viewer\]"):
        play.play(["no such run"], port=0, keep_compiled=False)


def test_a_folder_that_is_not_a_run_is_refused_before_anything_is_announced(monkeypatch, tmp_path: Path, capsys):
    pytest.importorskip("viser", reason="viser is not installed")
    monkeypatch.setattr(background, "leave_work", lambda code: None)
    with pytest.raises(InputError) as caught:
        play.play([tmp_path], port=0, keep_compiled=False)
    assert str(tmp_path) in caught.value.file
    assert capsys.readouterr().out == ""
