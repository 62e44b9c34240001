"""One process writes a run at a time; what a killed process leaves behind holds nobody up."""

from __future__ import annotations

import errno
import os
import signal
import socket
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from pfnn_jax.io import locks
from pfnn_jax.io.locks import writer_of, writing
from tests.raising import assert_refused
from tests.writers import ROOT, another_writer


def test_a_second_process_is_refused_and_the_first_is_named(tmp_path):
    run = tmp_path / "run"
    with another_writer(run) as process:
        holder = f"process {process.pid} on {socket.gethostname()}"
        assert writer_of(run) == holder
        assert_refused(lambda: writing(run).__enter__(), file=run, place="run", value=f"is being written by {holder}")
    with writing(run):
        assert writer_of(tmp_path / "another") is None


def test_one_run_has_one_lock_by_whatever_path_it_is_named(tmp_path, monkeypatch):
    (tmp_path / "run").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    with another_writer(tmp_path / "run"):
        for path in ("run", "link", Path("run") / ".." / "run"):
            assert_refused(lambda path=path: writing(path).__enter__(), place="run")


def test_a_killed_process_holds_nothing(tmp_path):
    run = tmp_path / "run"
    with another_writer(run) as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert (tmp_path / ".run.lock").exists() and writer_of(run) is None
        with writing(run):
            assert str(os.getpid()) in (tmp_path / ".run.lock").read_text()
    assert not list(tmp_path.iterdir())


def test_blocks_of_one_process_are_nested_and_shared_by_threads(tmp_path):
    run, entered, leave = tmp_path / "run", threading.Event(), threading.Event()

    def work() -> None:
        with writing(run):
            entered.set()
            leave.wait()

    thread = threading.Thread(target=work)
    with writing(run), writing(run):
        assert writer_of(run) is None  # nobody else
        thread.start()
        assert entered.wait(10)
    assert (tmp_path / ".run.lock").exists()  # the thread is still writing
    leave.set()
    thread.join()
    assert not list(tmp_path.iterdir())


def test_a_block_that_fails_releases_the_run(tmp_path):
    with pytest.raises(ZeroDivisionError), writing(tmp_path / "run"):
        raise ZeroDivisionError
    with another_writer(tmp_path / "run"):
        pass


def test_the_lock_stays_while_the_run_is_replaced_or_removed(tmp_path):
    run = tmp_path / "run"
    run.mkdir()
    with another_writer(run):
        run.rename(tmp_path / "aside")
        assert writer_of(run) is not None
        run.mkdir()
        assert_refused(lambda: writing(run).__enter__(), place="run")


def test_a_run_in_a_folder_that_cannot_be_written_has_its_lock_inside(tmp_path, monkeypatch):
    """The superuser may write everywhere, so the refusal is simulated."""
    run, opens = tmp_path / "run", os.open
    run.mkdir()

    def read_only_folder(path, *args, **options):
        if Path(path).parent == tmp_path:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opens(path, *args, **options)

    monkeypatch.setattr(os, "open", read_only_folder)
    with writing(run):
        assert [path.name for path in run.iterdir()] == [".lock"]
        command = [sys.executable, "-c", f"from pfnn_jax.io.locks import writer_of; print(writer_of({str(run)!r}))"]
        found = subprocess.run(command, capture_output=True, text=True, cwd=ROOT).stdout
        assert found == f"process {os.getpid()} on {socket.gethostname()}\n"
    assert not list(run.iterdir())


def test_a_lock_of_another_user_excludes_too(tmp_path, monkeypatch):
    """Its file can be read but not written; the superuser may write everywhere, so that is simulated."""
    run, opens, refused = tmp_path / "run", os.open, os.O_RDWR
    run.mkdir()

    def of_another_user(path, flags, *args, **options):
        if Path(path) == tmp_path / ".run.lock" and flags & refused == refused:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return opens(path, flags, *args, **options)

    monkeypatch.setattr(os, "open", of_another_user)
    with another_writer(run) as process:
        holder = f"process {process.pid} on {socket.gethostname()}"
        assert writer_of(run) == holder
        assert_refused(lambda: writing(run).__enter__(), place="run", value=f"is being written by {holder}")
        process.kill()
        process.wait()
        with writing(run):
            assert not list(run.iterdir())
        (tmp_path / ".run.lock").touch()
        refused = 0  # not even read
        assert_refused(lambda: writing(run).__enter__(), file=run, place="folder", value="Permission denied")


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="the system opens no file without following links")
@pytest.mark.parametrize("target", ["thesis.tex", "absent.tex"])
def test_a_link_in_place_of_a_lock_is_refused_and_not_followed(tmp_path, target):
    (tmp_path / "thesis.tex").write_text("years of work")
    (tmp_path / ".run.lock").symlink_to(tmp_path / target)
    assert_refused(lambda: writing(tmp_path / "run").__enter__(), file=".run.lock", place="lock", value="is a link")
    assert writer_of(tmp_path / "run") is None
    assert (tmp_path / "thesis.tex").read_text() == "years of work" and not (tmp_path / "absent.tex").exists()


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP])
def test_nothing_is_locked_on_a_file_system_without_locks(tmp_path, monkeypatch, code):
    monkeypatch.setattr(locks, "_lock", lambda descriptor: failing(code))
    with writing(tmp_path / "run"):
        assert writer_of(tmp_path / "run") is None
    assert not list(tmp_path.iterdir())


def test_a_file_system_that_fails_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(locks, "_lock", lambda descriptor: failing(errno.EIO))
    assert_refused(lambda: writing(tmp_path / "run").__enter__(), file=".run.lock", place="lock")


def failing(code: int) -> bool:
    raise OSError(code, os.strerror(code))


def test_a_run_that_was_moved_aside_by_a_killed_process_is_moved_back(tmp_path):
    (tmp_path / ".run.old").mkdir()
    (tmp_path / ".run.old" / "config.json").write_text("{}")
    with writing(tmp_path / "run"):
        assert (tmp_path / "run" / "config.json").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    assert_refused(lambda: writing(tmp_path / "file" / "run").__enter__(), place="folder")
