"""Files and folders that appear whole or not at all, also where the last step fails."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.io import files
from pfnn_jax.io.files import exchange, failure, refuse_existing, require_suffix, write_whole
from tests.raising import assert_refused


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("content", ["für\nalle\n", b"\r\n\xff"])
def test_what_is_written_is_read(tmp_path, content):
    path = tmp_path / "a"
    path.write_text("an older and longer file")
    write_whole(path, content)
    assert path.read_bytes() == (content.encode() if isinstance(content, str) else content)
    assert names(tmp_path) == ["a"]


def test_a_file_that_cannot_be_put_in_place_leaves_the_old_one(tmp_path, monkeypatch):
    def full(*paths):
        raise OSError(28, "No space left on device")

    path = tmp_path / "a"
    path.write_text("old")
    monkeypatch.setattr(os, "replace", full)
    assert_refused(lambda: write_whole(path, "new"), file="a", place="disk")
    assert path.read_text() == "old" and names(tmp_path) == ["a"]


def test_no_folder_to_write_to_is_one_line(tmp_path):
    assert_refused(
        lambda: write_whole(tmp_path / "absent" / "a", "text"), place="output", value="No such file or directory"
    )


@pytest.mark.parametrize("there", ["nothing", "folder", "file", "link"])
def test_a_finished_folder_takes_its_place(tmp_path, there):
    new, target = tmp_path / "new", tmp_path / "target"
    new.mkdir()
    (new / "a").write_text("new")
    if there == "folder":
        target.mkdir()
        (target / "b").write_text("old")
    elif there == "file":
        target.write_text("old")
    elif there == "link":
        (tmp_path / "far").mkdir()
        target.symlink_to(tmp_path / "far")
    exchange(new, target)
    assert names(target) == ["a"] and not target.is_symlink()
    assert names(tmp_path) == (["far", "target"] if there == "link" else ["target"])


def test_a_folder_that_cannot_take_its_place_leaves_the_old_one(tmp_path):
    target = tmp_path / "target"
    target.mkdir()
    (target / "b").write_text("old")
    with pytest.raises(OSError):
        exchange(tmp_path / "absent", target)
    assert names(target) == ["b"] and names(tmp_path) == ["target"]


@pytest.mark.parametrize("name", ["a.bvh", "A.BVH", "b.c.bvh"])
def test_a_name_of_the_kind_passes(name):
    require_suffix(Path(name), (".bvh",))


@pytest.mark.parametrize(
    ("name", "suffixes", "message"),
    [
        ("a.txt", (".bvh",), "a.txt: suffix: .txt; must be .bvh"),
        ("a", (".bvh",), "a: suffix: none; must be .bvh"),
        ("a.jpg", (".png", ".gif"), "a.jpg: suffix: .jpg; must be one of .png, .gif"),
    ],
)
def test_a_name_of_another_kind_is_refused(name, suffixes, message):
    with pytest.raises(InputError) as refused:
        require_suffix(Path(name), suffixes)
    assert str(refused.value) == message


def test_a_failure_is_one_line_without_the_path():
    assert failure(FileNotFoundError(2, "No such file or directory", "here/a")) == "No such file or directory"
    assert failure(ValueError("one\ntwo")) == "one" and failure(EOFError()) == "EOFError"


def test_a_temporary_of_a_dead_process_is_removed_and_that_of_a_living_one_stays(tmp_path):
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    dead, living = tmp_path / f".a.{process.pid}.new", tmp_path / f".a.{os.getppid()}.new"
    dead.mkdir()
    (dead / "half").write_text("half")
    living.write_text("half")
    write_whole(tmp_path / "a", "new")
    assert names(tmp_path) == [living.name, "a"]


def test_on_windows_no_signal_is_sent_to_find_out_whether_a_process_is_running(monkeypatch):
    monkeypatch.setattr(files.sys, "platform", "win32")
    monkeypatch.setattr(files.os, "kill", lambda pid, signal: pytest.fail("signal 0 is Ctrl-C there"))
    assert files.is_running(os.getppid())


def test_an_error_that_the_system_has_no_text_for_is_not_taken_for_a_full_disk():
    """As `EDQUOT` on Windows: its text would be found in any error without one."""
    assert files._reasons(errno.ENOSPC, 99_999) == ((errno.ENOSPC, os.strerror(errno.ENOSPC)),)


@pytest.mark.parametrize("there", ["file", "folder"])
def test_an_existing_output_is_refused_unless_it_may_be_replaced(tmp_path, there):
    path = tmp_path / "a"
    refuse_existing(path, overwrite=False)
    path.write_text("") if there == "file" else path.mkdir()
    assert_refused(lambda: refuse_existing(path, overwrite=False), place="output", rule_mentions="overwrite=True")
    refuse_existing(path, overwrite=True)
