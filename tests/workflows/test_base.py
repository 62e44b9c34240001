"""The base network: shipped small and complete, copied whole into the user's data folder, and never lost or changed."""

from __future__ import annotations

import errno
import json
import os
import shutil
import stat
import subprocess
import sys
import time
from pathlib import Path

import jax
import pytest

from pfnn_jax.io import files
from pfnn_jax.motion.skeleton import need_roles, skeleton_from_json
from pfnn_jax.run import load_run, load_style, save_style
from pfnn_jax.run_config import list_styles, load_config, style_note
from pfnn_jax.training.log import read_metrics
from pfnn_jax.workflows import base
from pfnn_jax.workflows.base import BASE_NETWORK, DIGITS, base_run, open_base
from tests.raising import assert_refused

ROOT = Path(__file__).resolve().parents[2]

LARGEST = 6_000_000
"""Bytes of the run in the package."""

COPY = "from pfnn_jax.workflows import base_run; print(base_run())"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty data folder."""
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "home"))
    return tmp_path / "home" / "pfnn_jax"


def content(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def other_network(folder: Path) -> Path:
    """A base network of another version of the package: the same run with other shared parameters."""
    shutil.copytree(BASE_NETWORK, folder)
    note = json.loads((folder / "shared" / "shared.json").read_text())
    (folder / "shared" / "shared.json").write_text(json.dumps(note | {"fingerprint": "0" * 64}))
    return folder


def learn(run_path: Path, name: str) -> None:
    """Saves a style as few-shot learning does."""
    run = load_run(run_path)
    save_style(run_path, name, load_style(run, "neutral"), {"speed": 1.0})


# What the package holds


def test_the_shipped_network_is_a_small_finished_run():
    assert sum(map(len, content(BASE_NETWORK).values())) <= LARGEST
    assert {path.name for path in BASE_NETWORK.iterdir()} == {
        "CARD.md", "calibrations.safetensors", "config.json", "differences", "metrics.jsonl", "normaliser", "shared",
        "styles",
    }  # fmt: skip
    run = load_run(BASE_NETWORK)
    assert set(list_styles(BASE_NETWORK)) == set(run.config.styles) > {"neutral"}
    assert read_metrics(BASE_NETWORK)[-1]["loss"] < 1.0
    for name in run.config.styles:
        load_style(run, name)


def test_the_shipped_network_has_a_skeleton_with_roles_and_a_map():
    skeleton = skeleton_from_json(load_config(BASE_NETWORK).skeleton)
    need_roles(skeleton)
    assert skeleton.humanoid is not None


def test_the_shipped_network_names_no_path_of_the_machine_that_made_it():
    sources = [style_note(BASE_NETWORK, name)["info"]["source"] for name in list_styles(BASE_NETWORK)]
    assert not [path for path in (load_config(BASE_NETWORK).pretrain["dataset"], *sources) if Path(path).is_absolute()]
    text = b"".join(content(BASE_NETWORK).values())
    assert not [place for place in (b"/tmp/", b"/home/", b"/root/", bytes(ROOT)) if place in text]


def test_the_card_says_what_the_network_was_trained_on_and_its_licence():
    card = (BASE_NETWORK / "CARD.md").read_text(encoding="utf-8")
    assert "**Data**" in card and "**Licence**" in card


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_the_package_holds_every_file(kind: str):
    from hatchling.builders.sdist import SdistBuilder
    from hatchling.builders.wheel import WheelBuilder

    builder = {"wheel": WheelBuilder, "sdist": SdistBuilder}[kind](str(ROOT))
    packed = {file.distribution_path for file in builder.recurse_included_files()}
    assert {path.relative_to(ROOT).as_posix() for path in BASE_NETWORK.rglob("*") if path.is_file()} <= packed


# The copy


def test_the_copy_equals_the_network_of_the_package(home: Path):
    copy = base_run()
    assert copy.parent == home
    assert content(copy) == content(BASE_NETWORK)
    assert copy.name == f"base-{load_run(copy).fingerprint[:DIGITS]}"


def test_copying_twice_is_copying_once(home: Path):
    first = open_base()
    learn(first.path, "mine")
    before = content(first.path)
    second = open_base()
    assert (first.is_new, second.is_new) == (True, False)
    assert second.path == first.path and content(second.path) == before


def test_learning_leaves_the_package_unchanged(home: Path):
    before = content(BASE_NETWORK)
    learn(base_run(), "mine")
    assert content(BASE_NETWORK) == before


def test_the_copy_of_a_read_only_package_can_be_written(home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    package = tmp_path / "package"
    shutil.copytree(BASE_NETWORK, package)
    for path in (package, *package.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    monkeypatch.setattr(base, "BASE_NETWORK", package)
    copy = base_run()
    for path in (package, *package.rglob("*")):
        path.chmod(0o755)
    assert all(path.stat().st_mode & stat.S_IWUSR for path in (copy, *copy.rglob("*")))


def test_processes_that_copy_at_once_get_the_same_complete_folder(home: Path):
    programs = [subprocess.Popen([sys.executable, "-c", COPY], cwd=ROOT, stdout=subprocess.PIPE) for _ in range(4)]
    shown = {program.communicate(timeout=120)[0] for program in programs}
    assert [program.returncode for program in programs] == [0] * 4
    assert len(shown) == 1 and content(base_run()) == content(BASE_NETWORK)
    assert [path.name for path in home.iterdir()] == [base_run().name]


def test_a_style_learned_while_another_process_copies_is_kept(home: Path, monkeypatch: pytest.MonkeyPatch):
    copy_files = files._copy_files

    def slow(source: Path, new: Path) -> None:
        copy_files(source, new)
        monkeypatch.setattr(files, "_copy_files", copy_files)
        learn(base_run(), "mine")  # another process is faster

    monkeypatch.setattr(files, "_copy_files", slow)
    copy = open_base()
    assert not copy.is_new and "mine" in list_styles(copy.path)
    assert [path.name for path in home.iterdir()] == [copy.path.name]


def test_a_killed_copy_is_not_a_run_and_is_removed_when_it_is_old(home: Path, monkeypatch: pytest.MonkeyPatch):
    killed = "import os, shutil\nshutil.copyfile = lambda *_: os._exit(9)\n" + COPY
    assert subprocess.run([sys.executable, "-c", killed], cwd=ROOT, timeout=60).returncode == 9
    [left] = home.iterdir()
    assert left.name.startswith(".")
    old = time.time() - 2 * files.ABANDONED
    os.utime(left, (old, old))
    assert content(base_run()) == content(BASE_NETWORK)
    assert not left.exists()


def test_a_killed_copy_that_another_process_removes_meanwhile_stops_nobody(home: Path, monkeypatch: pytest.MonkeyPatch):
    left, remove = home / f".{open_base().path.name}.0.copy", files.remove
    shutil.rmtree(home)
    left.mkdir(parents=True)
    os.utime(left, (0, 0))

    def removed_already(path: Path) -> None:
        remove(path)
        if path == left:
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))

    monkeypatch.setattr(files, "remove", removed_already)
    assert content(base_run()) == content(BASE_NETWORK)
    assert not left.exists()


def test_a_full_disk_leaves_nothing(home: Path, monkeypatch: pytest.MonkeyPatch):
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.shutil, "copyfile", fail)
    assert_refused(base_run, place="disk", value="No space left on device")
    assert not list(home.iterdir())


def test_a_data_folder_that_cannot_be_made_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "file"))
    assert_refused(base_run, place="data folder", rule_mentions="must be writable")


@pytest.mark.parametrize("damage", ["truncated", "changed", "absent", "no configuration"])
def test_a_damaged_copy_is_refused_and_a_fresh_one_can_be_made(home: Path, damage: str):
    copy = base_run()
    file = max((copy / "shared").rglob("*"), key=lambda path: path.stat().st_size * path.is_file())
    data = file.read_bytes()
    if damage == "truncated":
        file.write_bytes(data[:-1])
    elif damage == "changed":
        file.write_bytes(bytes([data[0] ^ 1]) + data[1:])
    elif damage == "absent":
        file.unlink()
    else:
        (copy / "config.json").unlink()
    assert_refused(base_run, rule_mentions="remove the folder to get a fresh copy")
    shutil.rmtree(copy)
    assert content(base_run()) == content(BASE_NETWORK)


def test_another_network_has_another_folder_and_leaves_learned_styles_where_they_are(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    ours = open_base()
    learn(ours.path, "mine")
    monkeypatch.setattr(base, "BASE_NETWORK", other_network(tmp_path / "package"))
    newer = open_base()
    assert newer.path.name == f"base-{'0' * DIGITS}" and newer.is_new
    assert newer.earlier == (ours.path,) and "mine" in list_styles(ours.path)


def test_a_copy_that_an_earlier_version_made_is_taken(home: Path):
    """It lacks the files that state the types and shapes of arrays."""
    copy = base_run()
    stated = list(copy.rglob(files.ARRAYS))
    assert stated
    for file in stated:
        file.unlink()
    assert base_run() == copy
    assert load_run(copy).fingerprint == load_run(BASE_NETWORK).fingerprint


def test_an_earlier_copy_without_learned_styles_is_not_mentioned(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    base_run()
    monkeypatch.setattr(base, "BASE_NETWORK", other_network(tmp_path / "package"))
    assert open_base().earlier == ()


def test_finding_the_base_network_loads_no_jax(home: Path):
    program = f"{COPY}\nimport sys\nassert not {{'jax', 'flax', 'orbax'}} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True, timeout=60)


def test_parameters_of_the_copy_are_those_of_the_package(home: Path):
    copies = [load_run(path).shared for path in (BASE_NETWORK, base_run())]
    assert jax.tree.all(jax.tree.map(lambda a, b: bool((a == b).all()), *copies))
