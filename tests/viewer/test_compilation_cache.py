"""The folder of compiled code: private, refused otherwise; and how long earlier starts have taken."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfnn_jax.viewer.page import compilation_cache
from pfnn_jax.viewer.page.compilation_cache import FIRST_SECONDS, KEPT_SHARE, StartTimes, private_folder
from tests.raising import assert_refused

POSIX = pytest.mark.skipif(os.name != "posix", reason="modes and owners of POSIX")


@POSIX
def test_a_new_folder_is_private_and_an_own_one_is_made_so(tmp_path: Path):
    folder = tmp_path / "new" / "compiled"
    assert private_folder(folder).stat().st_mode & 0o777 == 0o700
    folder.chmod(0o755)
    assert private_folder(folder).stat().st_mode & 0o777 == 0o700


@POSIX
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
def test_a_folder_that_others_can_write_to_is_refused(tmp_path: Path, mode: int):
    folder = tmp_path / "compiled"
    folder.mkdir()
    folder.chmod(mode)
    assert_refused(lambda: private_folder(folder), place="compilation cache", value=f"mode {mode:o}")
    assert folder.stat().st_mode & 0o777 == mode, "what may have been written into it is not trusted later"


@POSIX
def test_a_folder_that_others_can_replace_is_refused(tmp_path: Path):
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o777)
    assert_refused(lambda: private_folder(tmp_path / "open" / "compiled"), file=tmp_path / "open", value="mode 777")
    (tmp_path / "open").chmod(0o1777)  # as /tmp: only owners can rename their files
    private_folder(tmp_path / "open" / "compiled")


@POSIX
@pytest.mark.parametrize(
    ("mode", "own", "refused"), [(0o775, False, True), (0o775, True, False), (0o755, False, False)]
)
def test_a_folder_that_a_group_can_replace_is_refused(tmp_path: Path, monkeypatch, mode: int, own: bool, refused: bool):
    monkeypatch.setattr(compilation_cache, "_is_own_group", lambda number: own)
    above = tmp_path / "shared"
    above.mkdir()
    above.chmod(mode)
    if refused:
        assert_refused(lambda: private_folder(above / "compiled"), file=above, value=f"mode {mode:o}")
    else:
        private_folder(above / "compiled")


@POSIX
@pytest.mark.parametrize(
    ("name", "members", "own"),
    [("me", [], True), ("me", ["me"], True), ("me", ["me", "you"], False), ("staff", [], False)],
)
def test_a_group_is_the_users_alone_by_its_name_and_members(monkeypatch, name: str, members: list[str], own: bool):
    import grp
    import pwd

    monkeypatch.setattr(grp, "getgrgid", lambda number: SimpleNamespace(gr_name=name, gr_mem=members))
    monkeypatch.setattr(pwd, "getpwuid", lambda number: SimpleNamespace(pw_name="me", pw_gid=1000))
    assert compilation_cache._is_own_group(1000) == own


@POSIX
def test_folders_that_are_made_are_private_whatever_the_umask_is(tmp_path: Path):
    before = os.umask(0o002)
    try:
        private_folder(tmp_path / "cache" / "pfnn_jax" / "compiled")
    finally:
        os.umask(before)
    for folder in ("cache", "cache/pfnn_jax"):
        assert (tmp_path / folder).stat().st_mode & 0o777 == 0o700


@POSIX
def test_links_files_and_folders_of_others_are_refused(tmp_path: Path, monkeypatch):
    (tmp_path / "real").mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(tmp_path / "real")
    (tmp_path / "file").write_text("")
    for name in ("link", "file"):
        assert_refused(lambda name=name: private_folder(tmp_path / name), place="compilation cache")
    monkeypatch.setattr(compilation_cache.os, "geteuid", lambda: 12345)
    assert_refused(lambda: private_folder(tmp_path / "real"), place="compilation cache")


def config(folder: str | None, enabled: bool = True) -> Any:
    """Returns a stand-in for JAX's configuration, which keeps what is set."""
    values = SimpleNamespace(jax_enable_compilation_cache=enabled, jax_compilation_cache_dir=folder)
    values.update = lambda name, value: setattr(values, name, value)
    return values


def test_jax_keeps_compiled_code_unless_configured_otherwise(tmp_path: Path, monkeypatch):
    own = tmp_path / "cache" / "compiled"
    monkeypatch.setattr(compilation_cache, "cache_folder", lambda: own)
    for given, expected in (
        (config("/somewhere"), Path("/somewhere")),
        (config(None, enabled=False), None),
        (config(None), own),
    ):
        monkeypatch.setattr("jax.config", given)
        assert compilation_cache.use_private_cache() == expected
        assert given.jax_compilation_cache_dir == (None if expected is None else str(expected))


@pytest.mark.parametrize("keep", [True, False])
def test_the_seconds_of_a_start_are_kept_only_with_its_compiled_code(monkeypatch, keep: bool):
    pytest.importorskip("viser", reason="viser is not installed")
    from pfnn_jax.viewer.page import background, play

    class Library:
        runs = ()

        def warm_up(self) -> None: ...

        def empty_trash(self) -> None: ...

        @property
        def styles(self) -> None:
            raise KeyboardInterrupt  # as soon as the page is announced

    noted: list[float] = []
    page = SimpleNamespace(url="", begin=lambda library: None)
    times = SimpleNamespace(expected=1.0, note=noted.append)
    stubs = {"standing_body": None, "RunLibrary": Library(), "Page": contextlib.nullcontext(page), "StartTimes": times}
    for name, value in (stubs | {"check_finished": None, "cancel_learning": None, "_cache": None}).items():
        monkeypatch.setattr(play, name, lambda *_, value=value, **__: value)
    monkeypatch.setattr(background, "leave_work", lambda code: None)
    play.play(["run"], port=0, keep_compiled=keep)
    assert len(noted) == keep


def test_old_compiled_code_is_removed(tmp_path: Path, monkeypatch):
    old, new = tmp_path / "a-cache", tmp_path / "b-cache"
    for file in (old, new):
        file.write_bytes(b"code")
    os.utime(old, (0, 0))
    compilation_cache._remove_unused(tmp_path)
    assert not old.exists() and new.exists()


def test_a_start_is_expected_to_take_as_long_as_the_last(tmp_path: Path):
    file, kept = tmp_path / "times.json", tmp_path / "kept"
    kept.mkdir()
    assert StartTimes(["run"], kept, file).expected == FIRST_SECONDS
    StartTimes(["run"], kept, file).note(60.0)
    assert StartTimes(["run"], kept, file).expected == 60.0, "nothing was kept"
    (kept / "step-cache").write_bytes(b"code")
    assert StartTimes(["run"], kept, file).expected == pytest.approx(60.0 * KEPT_SHARE)
    StartTimes(["run"], kept, file).note(12.0)
    assert StartTimes(["run"], kept, file).expected == 12.0
    assert StartTimes(["run"], None, file).expected == 60.0
    assert StartTimes(["other"], kept, file).expected == FIRST_SECONDS


@pytest.mark.parametrize("text", ["", "[1]", '{"jax": 3}', "{"])
def test_a_damaged_file_of_times_is_as_none(tmp_path: Path, text: str):
    file = tmp_path / "times.json"
    file.write_text(text)
    times = StartTimes(["run"], None, file)
    assert times.expected == FIRST_SECONDS
    times.note(5.0)
    assert StartTimes(["run"], None, file).expected == 5.0
