"""Renaming, deleting and restoring learned styles: on disk, in the bank, and for characters that walk in them."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import chex
import jax
import numpy as np
import pytest

from pfnn_jax.control.abilities import can_strafe
from pfnn_jax.control.controller import Controller
from pfnn_jax.io.files import write_json
from pfnn_jax.run import load_run, load_style, save_style
from pfnn_jax.run_config import list_styles, style_note
from pfnn_jax.viewer.page import journal, run_library, style_files
from pfnn_jax.viewer.page.character import Character
from pfnn_jax.viewer.page.journal import JOURNAL, finish_moves
from pfnn_jax.viewer.page.run_library import LoadedRun, RunLibrary
from pfnn_jax.viewer.page.style_bank import StyleRow
from pfnn_jax.viewer.page.style_files import empty_trash, remove_unfinished, unfinished_mark
from tests.raising import assert_refused
from tests.viewer.banks import ROWS, row_of, without_spare_rows
from tests.viewer.watching import contents
from tests.writers import another_writer

FRAME = 1.0 / 60.0
SECONDS = 20.0  # on a loaded machine


@pytest.fixture
def library(trained_run, tmp_path) -> RunLibrary:
    """A run that has learned a style from an uploaded clip."""
    path = Path(shutil.copytree(trained_run, tmp_path / "run"))
    save_style(path, "mine", load_style(load_run(path), "proud"), {"speed": 1.0})
    (path / "uploads").mkdir()
    (path / "uploads" / "mine.bvh").write_text("a clip")
    return RunLibrary([path])


def path_of(library: RunLibrary) -> Path:
    return library.get("run").run.path


def shown(character: Character, seconds: float) -> set[str]:
    """Returns the styles that are shown when a character has walked until `seconds`."""
    for frame in range(6):
        view = character.advance(seconds + frame * FRAME)
    return set(view.style_weights)


def test_a_renamed_style_is_the_same_style_under_its_new_name(library):
    character = Character(library, style="mine")
    character.advance(0.0)
    before = np.asarray(library.get("run").controller.style_weights("mine"))
    library.rename_style("run", "mine", "My walk")
    assert shown(character, 0.1) == {"My walk"} and character.shares == {"My walk": 1.0}
    np.testing.assert_array_equal(library.get("run").controller.style_weights("My walk"), before)
    assert list_styles(path_of(library)) == ("My walk", "depressed", "neutral", "proud")
    assert style_note(path_of(library), "My walk")["name"] == "My walk"
    assert RunLibrary([path_of(library)]).get("run").first_style == "My walk"
    library.rename_style("run", "My walk", "again")
    assert shown(character, 1.0) == {"again"}, "a name that has changed twice"


def test_a_deleted_style_can_be_restored_and_is_gone_when_the_program_ends(library):
    character, run = Character(library, style="mine"), path_of(library)
    character.advance(0.0)
    library.delete_style("run", "mine")
    assert "mine" not in list_styles(run) and not (run / "uploads" / "mine.bvh").exists()
    assert "mine" not in library.get("run").styles and library.deleted_style("run") == "mine"
    shown(character, 0.1)
    assert character.shares == {"depressed": 1.0}, "its character walks on in another style"
    assert library.restore_style("run") == "mine" and library.deleted_style("run") is None
    assert (run / "uploads" / "mine.bvh").read_text() == "a clip"
    character.choose("run", "mine")
    shown(character, 1.0)
    library.delete_style("run", "mine")
    library.empty_trash()
    assert library.deleted_style("run") is None and not list(run.glob(".deleted*"))
    assert_refused(lambda: library.restore_style("run"), place="style")


@pytest.mark.parametrize("rows_are_left", [True, False])
def test_styles_of_one_name_are_restored_in_turn(library, rows_are_left, monkeypatch):
    """Each from its row of the bank without being read, or from its folder if another style has taken the row."""
    run = path_of(library)

    def row(name: str) -> list[np.ndarray]:
        controller = library.get("run").controller
        return [np.asarray(leaf)[controller.styles.index(name)] for leaf in jax.tree.leaves(controller.params.bank)]

    def learn(name: str, like: str) -> None:
        save_style(run, name, load_style(load_run(run), like), {"speed": 1.0})
        library.add_style("run", name)

    name = "mine"
    if rows_are_left:  # the row before it is free
        name = "other"
        learn(name, "neutral")
        library.delete_style("run", "mine")
    first = row(name)
    library.delete_style("run", name)
    learn(name, "depressed")
    library.delete_style("run", name)
    if rows_are_left:
        monkeypatch.setattr("pfnn_jax.viewer.page.run_library.load_style", None)
    assert library.restore_style("run") == name
    chex.assert_trees_all_equal(row(name), row("depressed"))
    library.rename_style("run", name, "second")
    assert library.restore_style("run") == name
    chex.assert_trees_all_equal(row(name), first)
    chex.assert_trees_all_equal(row("second"), row("depressed"))
    assert {name, "second"} <= set(list_styles(run))


def test_a_style_and_its_clip_stay_together(library):
    """A renamed style leaves no clip behind that a later style of the old name would take for its own."""
    run = path_of(library)
    save_style(run, "other", load_style(load_run(run), "neutral"), {"speed": 1.0})
    library.add_style("run", "other")
    library.rename_style("run", "mine", "first")
    library.rename_style("run", "other", "mine")
    assert [path.name for path in (run / "uploads").iterdir()] == ["first.bvh"]
    library.delete_style("run", "mine")
    assert (run / "uploads" / "first.bvh").is_file(), "the clip of another style"
    library.delete_style("run", "first")
    assert not list((run / "uploads").iterdir())
    (run / "uploads").rmdir()
    assert library.restore_style("run") == "first"
    assert (run / "uploads" / "first.bvh").read_text() == "a clip"


def test_a_name_can_change_to_other_letters_of_its_own_but_not_to_that_of_a_clip(library):
    library.rename_style("run", "mine", "Mine")
    assert (path_of(library) / "uploads" / "Mine.bvh").is_file() and "Mine" in list_styles(path_of(library))
    (path_of(library) / "uploads" / "walk.glb").write_bytes(b"")
    assert_refused(lambda: library.rename_style("run", "Mine", "Walk"), value="Walk", rule_mentions="taken")
    assert_refused(lambda: library.rename_style("run", "Mine", "../größe"), file="run", value=repr("../größe"))


@pytest.mark.parametrize("fails", ["note", "clip"])
def test_a_style_that_cannot_be_renamed_keeps_its_name(library, monkeypatch, fails):
    run, rename = path_of(library), Path.rename
    before = (run / "styles" / "mine" / "style.json").read_bytes()

    def refuse(path: Path, target: Path) -> Path:
        if path.suffix == ".bvh":
            raise PermissionError(13, "Permission denied")
        return rename(path, target)

    def broken(path: Path, _: object) -> None:
        raise OSError(28, "No space left on device")

    if fails == "note":
        monkeypatch.setattr(journal, "write_json", broken)
    else:
        monkeypatch.setattr(Path, "rename", refuse)
    assert_refused(lambda: library.rename_style("run", "mine", "other"), file="styles/mine", place="style")
    assert list_styles(run) == ("depressed", "mine", "neutral", "proud") and (run / "uploads" / "mine.bvh").is_file()
    assert (run / "styles" / "mine" / "style.json").read_bytes() == before
    if fails == "clip":
        assert_refused(lambda: library.delete_style("run", "mine"), file="styles/mine", place="style")
        assert "mine" in list_styles(run) and library.deleted_style("run") is None


KILLED = """
import os, sys
from pathlib import Path
from pfnn_jax.viewer.page import style_files

run, change, left = Path(sys.argv[1]), sys.argv[2], [int(sys.argv[3])]
deleted = style_files.delete_style(run, "mine") if change == "restore" else None
rename = Path.rename

def limited(path, target):
    if target.suffix != ".json":
        if not left[0]:
            os._exit(0)
        left[0] -= 1
    return rename(path, target)

Path.rename = limited
if change == "rename":
    style_files.rename_style(run, "mine", "other")
elif change == "delete":
    style_files.delete_style(run, "mine")
else:
    style_files.restore_style(run, deleted)
raise RuntimeError("was not killed")
"""


@pytest.mark.parametrize("moves", [0, 1])
@pytest.mark.parametrize(("change", "left"), [("rename", "other"), ("delete", None), ("restore", "mine")])
def test_what_a_kill_leaves_of_a_change_is_done_by_the_next_program(library, change, left, moves):
    """Killed before its first move, and between that of the style and that of its clip."""
    run = path_of(library)
    subprocess.run([sys.executable, "-c", KILLED, run, change, str(moves)], check=True)
    assert (run / JOURNAL).is_file()
    RunLibrary([run])
    assert sorted(path.name for path in (run / "uploads").iterdir()) == ([] if left is None else [f"{left}.bvh"])
    assert set(list_styles(run)) - {"depressed", "neutral", "proud"} == ({left} - {None})
    if left is not None:
        assert style_note(run, left)["name"] == left
    assert not list(run.glob(".[dm]*")), "neither a journal nor anything deleted"


def test_a_killed_restore_waits_while_another_process_writes_the_run(library):
    """What was deleted, and is to be restored, is not removed before."""
    run = path_of(library)
    subprocess.run([sys.executable, "-c", KILLED, run, "restore", "1"], check=True)
    with another_writer(run):
        RunLibrary([run])
        assert (run / JOURNAL).is_file() and not (run / "uploads" / "mine.bvh").exists()
    RunLibrary([run])
    assert (run / "uploads" / "mine.bvh").read_text() == "a clip" and "mine" in list_styles(run)


def test_moves_that_have_become_impossible_are_dropped_together(library):
    """Another style has taken the name meanwhile: the clip stays with its style."""
    run = path_of(library)
    save_style(run, "other", load_style(load_run(run), "neutral"), {"speed": 1.0})
    moves = [["styles/mine", "styles/other"], ["uploads/mine.bvh", "uploads/other.bvh"]]
    write_json(run / JOURNAL, {"moves": moves})
    finish_moves(run)
    assert (run / "uploads" / "mine.bvh").is_file() and {"mine", "other"} <= set(list_styles(run))
    assert not (run / JOURNAL).exists()


GOOD = ["styles/mine", "styles/other"]


@pytest.mark.parametrize(
    "moves",
    [
        [GOOD, ["uploads/mine.bvh", "../mine.bvh"]],
        [GOOD, ["uploads/mine.bvh", "linked/mine.bvh"]],
        [GOOD, ["OUTSIDE", "uploads/clip.bvh"]],
        [GOOD, ["uploads/mine.bvh", "c:\\mine.bvh"]],
        [GOOD, ["uploads/mine.bvh", "\0"]],
        [GOOD, ["styles/none", "styles/linked"]],
        [GOOD, 3],
        "a",
        None,
    ],
)
def test_a_journal_that_leads_out_of_the_run_moves_nothing(library, tmp_path, moves):
    run, outside = path_of(library), tmp_path / "outside"
    outside.mkdir()
    (outside / "clip.bvh").write_text("not of the run")
    (outside / "style.json").write_text('{"name": "not of the run"}')
    for link in (run / "linked", run / "styles" / "linked"):
        link.symlink_to(outside, target_is_directory=True)
    text = json.dumps({"moves": moves}).replace("OUTSIDE", str(outside / "clip.bvh"))
    (run / JOURNAL).write_text(text)
    before = contents(run), contents(outside)
    finish_moves(run)
    assert not (run / JOURNAL).exists()
    assert (contents(run), contents(outside)) == ({k: v for k, v in before[0].items() if k != JOURNAL}, before[1])


def test_a_full_disk_keeps_nobody_from_deleting(library, monkeypatch):
    run, write = path_of(library), Path.write_text

    def full(path: Path, *args: object, **options: object) -> int:
        if JOURNAL in path.name:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, *args, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(Path, "write_text", full)
    library.delete_style("run", "mine")
    assert "mine" not in list_styles(run) and not (run / "uploads" / "mine.bvh").exists()
    assert library.restore_style("run") == "mine"


def test_nothing_outside_the_run_is_moved(library, tmp_path):
    run, outside = path_of(library), tmp_path / "mocap"
    (run / "uploads").rename(outside)
    (run / "uploads").symlink_to(outside, target_is_directory=True)
    library.rename_style("run", "mine", "other")
    library.rename_style("run", "other", "mine")
    library.delete_style("run", "mine")
    library.empty_trash()
    assert (outside / "mine.bvh").read_text() == "a clip"
    (run / "styles").rename(tmp_path / "styles")
    (run / "styles").symlink_to(tmp_path / "styles", target_is_directory=True)
    for change in (lambda: style_files.delete_style(run, "proud"), lambda: style_files.rename_style(run, "proud", "a")):
        assert_refused(change, place="folder", value="is a link")
    assert (tmp_path / "styles" / "proud").is_dir()


def test_the_row_of_a_deleted_style_is_used_again_when_no_row_is_spare(library, monkeypatch):
    run, loaded = path_of(library), library.get("run")
    full = replace(loaded, controller=without_spare_rows(loaded.controller))
    monkeypatch.setattr(library, "_loaded", {"run": full})
    for number in range(3):
        library.delete_style("run", "mine")
        save_style(run, "mine", load_style(load_run(run), "neutral"), {"speed": 1.0 + number})
        library.add_style("run", "mine")
    controller = library.get("run").controller
    assert controller.capacity == len(controller.styles) == full.controller.capacity
    assert_refused(lambda: library.restore_style("run"), value="mine", rule_mentions="taken")


def test_a_style_is_restored_from_its_row_while_other_rows_are_spare(library, monkeypatch):
    run = path_of(library)
    before = row_of(library.get("run").controller, "mine")
    library.delete_style("run", "mine")
    save_style(run, "new", load_style(load_run(run), "proud"), {"speed": 1.0})
    library.add_style("run", "new")
    monkeypatch.delattr(LoadedRun, "calibrated_row")
    library.restore_style("run")
    jax.tree.map(np.testing.assert_array_equal, row_of(library.get("run").controller, "mine"), before)


def test_names_and_styles_that_cannot_be_used_are_refused(library):
    for name in ("", "a/b", ".hidden", "neutral", "NEUTRAL", "x" * 101):
        assert_refused(lambda name=name: library.rename_style("run", "mine", name))
    for style in ("proud", "unknown", "../mine"):
        assert_refused(lambda style=style: library.rename_style("run", style, "new"), place="style")
        assert_refused(lambda style=style: library.delete_style("run", style), place="style")
    assert list_styles(path_of(library)) == ("depressed", "mine", "neutral", "proud")


def test_what_ended_programs_have_deleted_is_removed(tmp_path):
    ended = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    running = os.getppid()
    for number in (ended.stdout.strip(), str(running)):
        (tmp_path / f".deleted.{number}" / "0").mkdir(parents=True)
    (tmp_path / ".deleted.notes").mkdir()
    empty_trash(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f".deleted.{running}", ".deleted.notes"]


def test_a_style_trained_on_walks_ahead_cannot_strafe(library):
    """The data of the run walks ahead and turns."""
    assert not can_strafe(library.get("run").controller, "neutral")
    assert not library.try_strafe("run", "neutral")
    assert library.strafes("run", "neutral") is False and library.strafes("run", "proud") is None
    library.rename_style("run", "mine", "other")
    assert library.strafes("run", "neutral") is None, "a name can be that of another style"


def test_an_upload_that_was_being_learned_when_the_page_was_killed_is_removed(library):
    """An upload whose style was saved stays, and so does one that nobody has marked."""
    run = path_of(library)
    for name in ("walk.bvh", "mine.bvh", "other.bvh"):
        (run / "uploads" / name).write_text("a clip")
        if name != "other.bvh":
            unfinished_mark(run / "uploads" / name).touch()
    RunLibrary([run])
    assert sorted(path.name for path in (run / "uploads").iterdir()) == ["mine.bvh", "other.bvh"]
    (run / "uploads" / "mine.bvh").unlink()
    (run / "uploads" / "other.bvh").unlink()
    unfinished_mark(run / "uploads" / "walk.bvh").touch()
    remove_unfinished(run)
    assert not (run / "uploads").exists()


def test_what_is_asked_of_a_style_that_was_deleted_meanwhile_is_asked_of_another(library):
    character = Character(library, style="mine")
    library.delete_style("run", "mine")
    character.reset()
    assert "mine" not in character.shares and len(shown(character, 0.0)) == 1
    assert_refused(lambda: library.try_strafe("run", "mine"), place="style", rule_mentions="neutral")


def test_nobody_waits_while_a_style_is_added(library, monkeypatch):
    """Adding one takes seconds, but once only, and a style that is renamed meanwhile keeps its new name."""
    calibrate, calls = LoadedRun.calibrated_row, []

    def slow(loaded: LoadedRun, style: str) -> StyleRow:
        calls.append(style)
        other = threading.Thread(target=library.rename_style, args=("run", "mine", "renamed"))
        other.start()
        other.join(SECONDS)
        assert not other.is_alive(), "it waits"
        return calibrate(loaded, style)

    run = path_of(library)
    save_style(run, "new", load_style(load_run(run), "proud"), {"speed": 1.0})
    monkeypatch.setattr(LoadedRun, "calibrated_row", slow)
    library.add_style("run", "new")
    assert calls == ["new"] and {"new", "renamed"} < set(library.get("run").styles)


def test_a_row_is_calibrated_independently_of_other_styles_and_of_its_place(library):
    """Therefore other tabs can change the styles while one is calibrated."""
    before, run = library.get("run"), path_of(library)
    save_style(run, "copy", load_style(load_run(run), "mine"), {"speed": 1.0})
    row = before.calibrated_row("mine")
    changed = before.without_style("neutral").with_style("other", before.calibrated_row("proud"))
    jax.tree.map(np.testing.assert_array_equal, row, changed.calibrated_row("copy"))
    added = changed.with_style("copy", row).controller
    assert added.styles.index("copy") != before.controller.styles.index("mine")
    expected = dict(zip(ROWS, (row.style, row.speed, row.speed_gain, row.stance, row.waiting), strict=True))
    jax.tree.map(np.testing.assert_array_equal, row_of(added, "copy"), expected)


def test_a_bank_that_grows_is_compiled_before_characters_have_it(library, monkeypatch):
    """The last row is free when a style is calibrated, and taken by another style when it is put in."""
    save_style(path_of(library), "new", load_style(load_run(path_of(library)), "proud"), {"speed": 1.0})
    library.delete_style("run", "mine")
    full = without_spare_rows(library.get("run").controller)
    monkeypatch.setattr(library, "_loaded", {"run": replace(library.get("run"), controller=full)})
    calibrate, compiled = LoadedRun.calibrated_row, []

    def restored_meanwhile(loaded: LoadedRun, style: str) -> StyleRow:
        library.restore_style("run")
        return calibrate(loaded, style)

    def compile_first(controller: Controller) -> None:
        compiled.append(controller.capacity)
        assert library.get("run").controller.capacity < controller.capacity

    monkeypatch.setattr(LoadedRun, "calibrated_row", restored_meanwhile)
    monkeypatch.setattr(run_library, "compile_character", compile_first)
    library.add_style("run", "new")
    assert {"mine", "new"} < set(library.get("run").styles)
    assert compiled == [library.get("run").controller.capacity]
