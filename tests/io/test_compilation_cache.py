"""The folder of compiled code: private, refused otherwise, bounded in size, and used by every command."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pfnn_jax.io import compilation_cache
from pfnn_jax.io.compilation_cache import LOG_LEVEL, REJECTED, VARIABLE, name_private_cache, private_folder
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
    monkeypatch.setattr(compilation_cache, "compiled_folder", lambda: own)
    for given, expected in (
        (config("/somewhere"), Path("/somewhere")),
        (config(None, enabled=False), None),
        (config(None), own),
    ):
        monkeypatch.setattr("jax.config", given)
        assert compilation_cache.use_private_cache() == expected
        assert given.jax_compilation_cache_dir == (None if expected is None else str(expected))


@pytest.fixture
def own(tmp_path: Path, monkeypatch) -> Path:
    """Returns the folder in which compiled code is kept, of an environment that says nothing about it."""
    named = ("JAX_ENABLE_COMPILATION_CACHE", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", LOG_LEVEL)
    for name in (VARIABLE, *named):
        # Both, so that what the test sets is removed afterwards.
        monkeypatch.setenv(name, "")
        monkeypatch.delenv(name)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    monkeypatch.setattr(compilation_cache, "cache_folder", lambda: tmp_path / "compiled")
    return compilation_cache.compiled_folder()


def test_a_command_names_a_private_folder_for_its_version_of_jax_and_its_processor(own: Path, monkeypatch):
    name_private_cache()
    assert os.environ[VARIABLE] == str(own) and own.is_dir() and os.environ[LOG_LEVEL] == "3"
    assert own.name.startswith(f"jax-{compilation_cache.jax_version()}-")
    monkeypatch.setattr(compilation_cache.platform, "machine", lambda: "another")
    assert compilation_cache.compiled_folder() != own


@pytest.mark.parametrize("variable", [VARIABLE, "JAX_ENABLE_COMPILATION_CACHE"])
def test_what_the_user_has_set_stays(own: Path, monkeypatch, variable: str):
    monkeypatch.setenv(variable, "0")
    name_private_cache()
    assert os.environ.get(VARIABLE) == ("0" if variable == VARIABLE else None) and not own.exists()


@pytest.mark.parametrize(
    ("value", "kept"), [("1", True), ("true", True), ("0", False), ("False", False), ("off", False)]
)
def test_the_cache_is_switched_off_by_the_value_of_its_variable(own: Path, monkeypatch, value: str, kept: bool):
    monkeypatch.setenv("JAX_ENABLE_COMPILATION_CACHE", value)
    name_private_cache()
    assert (VARIABLE in os.environ) == own.exists() == kept


@POSIX
def test_a_refused_folder_stops_no_command(own: Path):
    own.parent.mkdir(mode=0o700)
    own.parent.chmod(0o777)
    name_private_cache()
    assert VARIABLE not in os.environ and not own.exists()


def test_unreadable_code_is_no_warning_and_a_processor_that_rejects_its_own_code_keeps_none(own: Path, recwarn):
    name_private_cache()
    for text in ("Target machine feature +prefer-no-gather is not supported", "Error -3 while decompressing data"):
        warnings.showwarning(f"Error reading persistent compilation cache entry for 'f': {text}", UserWarning, "", 0)
        assert (own / REJECTED).exists()
    assert not recwarn.list
    del os.environ[VARIABLE]
    name_private_cache()
    assert VARIABLE not in os.environ


def test_a_damaged_entry_alone_does_not_switch_the_cache_off(own: Path):
    name_private_cache()
    warnings.showwarning("Error reading persistent compilation cache entry for 'f': Error -3", UserWarning, "", 0)
    assert not (own / REJECTED).exists()


def test_old_compiled_code_and_what_exceeds_the_bound_is_removed(tmp_path: Path, monkeypatch):
    monkeypatch.setattr(compilation_cache, "MOST_BYTES", 10)
    (tmp_path / "jax").mkdir()
    files = [tmp_path / "jax" / f"{name}-cache" for name in ("old", "first", "second", "third")]
    for age, file in zip((10**9, 300, 200, 100), files, strict=True):
        file.write_bytes(b"code")
        written = compilation_cache.time.time() - age
        os.utime(file, (written, written))
    compilation_cache._remove_unused(tmp_path)
    assert [file.exists() for file in files] == [False, False, True, True]


def test_a_command_keeps_what_it_compiles(tmp_path: Path):
    """In a program of its own, since JAX reads the variables once, and with the user's folder elsewhere."""
    code = (
        "import sys; from pfnn_jax.cli import command_line, main\n"
        "class Compile:\n"
        "    json = None\n"
        "    def ending(self):\n        import contextlib; return contextlib.nullcontext()\n"
        "    def run(self):\n        import jax; print(jax.jit(lambda x: 2 * x)(3.0))\n"
        "command_line.parse = lambda words: Compile()\n"
        "main()\n"
    )
    home = {"XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path)}
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE} | home
    environment["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"
    for name in ("TF_CPP_MIN_LOG_LEVEL", "XLA_FLAGS"):
        environment.pop(name, None)
    for _ in range(2):  # what the first keeps the second loads, of which XLA would report features of the processor
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == "6.0" and not done.stderr
        assert list(tmp_path.rglob("compiled/jax-*/*-cache"))
