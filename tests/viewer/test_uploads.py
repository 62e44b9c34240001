"""Uploads: refused files change nothing, and a learned style equals that of few-shot."""

from __future__ import annotations

import errno
import json
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest

from pfnn_jax.control import calibration, stability, stance
from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.datasets.sources import ClipFile, check_style_name
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.run import load_run, load_style
from pfnn_jax.run_config import list_styles
from pfnn_jax.training import few_shot_learning
from pfnn_jax.training.config import RESTYLED_FEW_SHOT, FewShotConfig
from pfnn_jax.viewer.page import uploads
from pfnn_jax.viewer.page.character import Character
from pfnn_jax.viewer.page.run_library import RunLibrary
from pfnn_jax.viewer.page.uploads import (
    LONGEST,
    MOST_BYTES,
    MOST_FRAMES,
    MOST_JOINTS,
    LearningCancelled,
    cancel_learning,
    check_upload,
    learn_upload,
    page_config,
    prepare_training,
    prepare_walks,
    style_name,
)
from pfnn_jax.workflows.learn import default_config, learn_style
from tests.raising import assert_refused
from tests.viewer.watching import contents

FRAME = 1.0 / 60.0
SMALL = FewShotConfig("cp", 4, (1e-3,), (0.0,), (0.3,), eval_epochs=(1,))


@pytest.fixture(scope="module")
def run_path(played_run, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("learning") / "run"
    shutil.copytree(played_run, path)
    return path


@pytest.fixture(scope="module")
def library(run_path) -> RunLibrary:
    return RunLibrary([run_path])


@pytest.fixture(autouse=True)
def quickly(monkeypatch):
    monkeypatch.setattr(stability, "SECONDS", 1.2)  # a short test: stability does not matter here
    monkeypatch.setattr(uploads, "page_config", lambda run: SMALL)


def compilations() -> list[int]:
    """Returns how often what learning needs has been compiled."""
    quick: tuple[Any, ...] = (
        stability._walk_now,
        stability._stability_now,
        calibration._measure_now,
        stance._walks_now,
    )
    training: tuple[Any, ...] = (few_shot_learning._train_many, few_shot_learning._row_errors)
    return [function._cache_size() for function in (*(each.compiled() for each in quick), *training)]


def test_an_upload_is_learned_as_by_few_shot(library, run_path, zombie_bvh, tmp_path):
    prepare_walks(library, "run")
    prepare_training(library, "run")
    calls: list[tuple[float, str]] = []
    before, compiled = set(contents(run_path)), compilations()
    name, notes, warnings = learn_upload(
        library, "run", "C:\\clips\\zombie walk.bvh", zombie_bvh.read_bytes(), lambda *t: calls.append(t)
    )
    assert name == "zombie walk" and ("run", name) in library.styles
    assert compilations() == compiled, "everything was prepared"
    assert all(new.startswith(("uploads", "styles/zombie walk")) for new in set(contents(run_path)) - before)
    assert (run_path / "uploads" / "zombie walk.bvh").read_bytes() == zombie_bvh.read_bytes()
    shares = [share for share, _ in calls]
    assert shares == sorted(shares) and shares[0] == 0.0 and calls[-1] == (1.0, "done") and len(calls) > 5

    again = tmp_path / "again"
    shutil.copytree(run_path, again)
    info = learn_style(load_run(again), ClipFile(zombie_bvh, "same"), SMALL)
    assert notes == () and list(warnings) == info["warnings"]
    assert not any("not a forward walk" in line for line in warnings)
    here, there = load_style(load_run(run_path), name), load_style(load_run(again), "same")
    jax.tree.map(np.testing.assert_array_equal, here, there)

    character = Character(library, style="neutral")
    character.set_stick(1.0, 0.0)
    character.advance(0.0)
    character.choose("run", name)
    views = [character.advance(frame * FRAME) for frame in range(1, 121)]
    assert views[-1].style_weights == pytest.approx({name: 1.0}, abs=0.01)
    assert np.isfinite(views[-1].joints).all()

    assert learn_upload(library, "run", "zombie walk.bvh", zombie_bvh.read_bytes()).style == "zombie walk 2"


def test_an_upload_of_another_skeleton_is_put_onto_the_runs(library, run_path, zombie_bvh):
    text = zombie_bvh.read_text().replace("UpLeg", "Thigh").replace("JOINT Spine1", "JOINT Belly")
    name, notes, _ = learn_upload(library, "run", "renamed.bvh", text.encode(), name="Größe")
    assert name == "Größe" and (run_path / "uploads" / "Größe.bvh").is_file()
    assert notes == ("retargeted from 21 to 21 joints, legs scaled by 1.00",)
    about = json.loads((run_path / "styles" / name / "style.json").read_text())
    assert about["info"]["notes"] == ["retargeted from 21 to 21 joints, legs scaled by 1.00"]
    learned = learn_upload(library, "run", "as it was.bvh", zombie_bvh.read_bytes()).style
    here, there = (load_style(load_run(run_path), style) for style in (name, learned))
    jax.tree.map(np.testing.assert_array_equal, here, there)


def test_an_upload_that_is_not_a_forward_walk_is_learned_with_warnings(library, run_path, tmp_path):
    clip, _ = synthesise("zombie", np.zeros(150), np.full(150, 0.9))
    reverse = replace(clip, root_positions=clip.root_positions[::-1], rotations=clip.rotations[::-1])
    write_bvh(tmp_path / "back.bvh", reverse)
    style, _, warnings = learn_upload(library, "run", "old.bvh", (tmp_path / "back.bvh").read_bytes())
    about = json.loads((run_path / "styles" / style / "style.json").read_text())["info"]
    assert any("it moves backwards" in line for line in warnings)
    assert list(warnings) == about["warnings"]


def test_the_clip_decides_on_mirroring_not_its_name(library, run_path, zombie_bvh):
    style = learn_upload(library, "run", "DragLeg.bvh", zombie_bvh.read_bytes()).style
    about = json.loads((run_path / "styles" / style / "style.json").read_text())["info"]
    assert about["mirrored"] and about["asymmetry"] < 0.1


BAD = {
    "nothing": (b"", "must be the text of a BVH file"),
    "no text": (b"HIERARCHY\0ROOT", "must be the text of a BVH file"),
    "a pickle": (b"\x80\x04\x95cposix\nsystem\n(S'true'\ntR.", "bad.bvh: line 1"),
    "no motion": (b"HIERARCHY\nROOT Hips\n{\n", "bad.bvh: "),
}


def chain(joints: int = 2, frames: int = 2, frame_time: float = 1 / 60, size: int = 0) -> bytes:
    """Returns a valid BVH file of a chain of joints, padded with spaces to `size` bytes."""
    opened = "".join(
        f"{'JOINT' if joint else 'ROOT'} a{joint}\n{{\nOFFSET 0 1 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n"
        for joint in range(joints)
    )
    head = f"HIERARCHY\n{opened}End Site\n{{\nOFFSET 0 1 0\n}}\n{'}' * joints}\nMOTION\n"
    rows = ("0 0 0 " * joints + "\n") * frames
    return f"{head}Frames: {frames}\nFrame Time: {frame_time:.7f}\n{rows}".encode().ljust(size)


LIMITS = {
    "bytes": (partial(chain, size=MOST_BYTES), partial(chain, size=MOST_BYTES + 1), "size"),
    "joints": (partial(chain, MOST_JOINTS), partial(chain, MOST_JOINTS + 1), "hierarchy"),
    "frames": (
        partial(chain, frames=MOST_FRAMES, frame_time=0.001),
        partial(chain, frames=MOST_FRAMES + 1, frame_time=0.001),
        "frames",
    ),
    "seconds": (
        partial(chain, frames=round(LONGEST), frame_time=1.0),
        partial(chain, frames=round(LONGEST) + 1, frame_time=1.0),
        "length",
    ),
}


@pytest.mark.parametrize(("within", "beyond", "place"), LIMITS.values(), ids=LIMITS)
def test_valid_clips_beyond_a_limit_are_refused(library, run_path, tmp_path, within, beyond, place):
    before = contents(run_path)
    check_upload("walk", within())
    assert_refused(lambda: learn_upload(library, "run", "walk.bvh", beyond()), file="walk.bvh", place=place)
    assert contents(run_path) == before
    path = tmp_path / "walk.bvh"
    path.write_bytes(beyond())
    assert read_bvh(path).num_frames > 1  # it is valid otherwise


@pytest.mark.parametrize(("data", "rule"), BAD.values(), ids=BAD)
def test_a_bad_upload_changes_nothing(library, run_path, data, rule):
    before, styles = contents(run_path), library.styles
    with pytest.raises(InputError, match=rule) as refused:
        learn_upload(library, "run", "bad.bvh", data)
    assert str(run_path) not in str(refused.value)
    assert contents(run_path) == before and library.styles == styles


def test_valid_clips_that_cannot_be_learned_change_nothing(library, run_path, zombie_bvh):
    before, text = contents(run_path), zombie_bvh.read_text()
    still = re.sub(r"(Frames:).*", r"\1 100", text.split("Frame Time")[0]) + "Frame Time: 0.0166667\n"
    row = text.split("Frame Time")[1].splitlines()[1]
    for data in (still + (row + "\n") * 100, text.replace("0.01666", "0.0000166")):
        with pytest.raises(InputError) as refused:
            learn_upload(library, "run", "walk.bvh", data.encode())
        assert str(run_path) not in str(refused.value)
        assert contents(run_path) == before
    for name in ("../walk", ".walk", "a:b"):
        assert_refused(lambda name=name: learn_upload(library, "run", "walk.bvh", text.encode(), name=name))
    assert contents(run_path) == before
    assert_refused(lambda: learn_upload(library, "../run", "walk.bvh", text.encode()), place="run")


def test_a_first_upload_that_fails_leaves_no_folder(played_run, tmp_path, monkeypatch):
    path = tmp_path / "run"
    shutil.copytree(played_run, path)
    before = contents(path)

    def broken(*_, **__):
        assert (path / "uploads" / "walk.bvh").is_file()
        raise MemoryError

    monkeypatch.setattr(uploads, "learn_style", broken)
    with pytest.raises(MemoryError):
        learn_upload(RunLibrary([path]), "run", "walk.bvh", b"HIERARCHY")
    assert contents(path) == before


def test_cancelled_learning_changes_nothing(played_run, zombie_bvh, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(played_run, path)
    before, ending = contents(path), RunLibrary([path])

    def end(share: float, what: str) -> None:
        assert (path / "uploads" / "walk.bvh").is_file()
        cancel_learning(ending, wait=0.0)
        assert contents(path) == before

    with pytest.raises(LearningCancelled):
        learn_upload(ending, "run", "walk.bvh", zombie_bvh.read_bytes(), end)
    assert contents(path) == before


def test_a_style_that_cannot_be_added_is_removed(library, run_path, zombie_bvh, monkeypatch):
    before, styles = contents(run_path), library.styles

    def refused(run: str, style: str) -> None:
        assert style in list_styles(run_path)
        raise InputError(run_path, "style", style, "must be of the kind of the run's other styles to be played")

    monkeypatch.setattr(library, "add_style", refused)
    with pytest.raises(InputError, match="must be of the kind"):
        learn_upload(library, "run", "odd.bvh", zombie_bvh.read_bytes())
    assert contents(run_path) == before and library.styles == styles


def test_a_saved_style_is_kept_when_the_page_ends(played_run, zombie_bvh, tmp_path, monkeypatch):
    path = tmp_path / "run"
    shutil.copytree(played_run, path)
    ending = RunLibrary([path])
    monkeypatch.setattr(ending, "add_style", lambda run, style: cancel_learning(ending, wait=0.0))
    assert learn_upload(ending, "run", "walk.bvh", zombie_bvh.read_bytes()).style == "walk"
    assert "walk" in list_styles(path) and (path / "uploads" / "walk.bvh").is_file()


def test_a_played_style_is_never_overwritten(played_run, zombie_bvh, tmp_path, monkeypatch):
    path = tmp_path / "bare"
    shutil.copytree(played_run, path)
    for style in list_styles(path):
        shutil.rmtree(path / "styles" / style)
    bare = RunLibrary([path])
    monkeypatch.setattr(bare, "add_style", lambda run, style: None)
    assert bare.styles == [("bare", "agnostic")]
    assert learn_upload(bare, "bare", "Agnostic.bvh", zombie_bvh.read_bytes()).style == "Agnostic 2"
    assert list_styles(path) == ("Agnostic 2",)


def test_errors_of_the_file_system_name_the_file(played_run, zombie_bvh, tmp_path, monkeypatch):
    path = tmp_path / "run"
    shutil.copytree(played_run, path)
    (path / "uploads").write_text("no folder")
    before, closed = contents(path), RunLibrary([path])
    upload = partial(learn_upload, closed, "run", "walk.bvh", zombie_bvh.read_bytes())
    assert_refused(upload, file="run/uploads", place="file", value="file exists")
    assert contents(path) == before

    def denied(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied", str(path / "styles" / ".walk.new"))

    (path / "uploads").unlink()
    before = contents(path)
    monkeypatch.setattr(uploads, "learn_style", denied)
    assert_refused(upload, file="run/styles/.walk.new", place="file", value="permission denied")
    assert contents(path) == before


def test_an_upload_never_leaves_the_run(library, run_path, tmp_path):
    elsewhere, uploads = tmp_path / "elsewhere", run_path / "uploads"
    elsewhere.mkdir()
    kept = tmp_path / "kept"
    if uploads.exists():
        uploads.rename(kept)
    uploads.symlink_to(elsewhere, target_is_directory=True)
    try:
        assert_refused(lambda: learn_upload(library, "run", "walk.bvh", b"HIERARCHY"), place="folder")
    finally:
        uploads.unlink()
        if kept.exists():
            kept.rename(uploads)
    assert not any(elsewhere.iterdir())


@pytest.mark.parametrize(
    ("filename", "name"),
    [
        ("Angry_FW.bvh", "Angry_FW"),
        ("../../etc/passwd.bvh", "passwd"),
        ("..\\..\\boot.BVH", "boot"),
        ("..bvh", "clip"),
        (".hidden.bvh", "hidden"),
        ("a<b>:\"|?*\n\x00 c'.bvh", "a_b_ c"),
        ("Übermut – π.bvh", "bermut"),
        (f"{'x' * 300}.bvh", "x" * 40),
    ],
)
def test_names_are_reduced_to_harmless_characters(filename, name):
    assert style_name(filename) == name == check_style_name(name)


@pytest.mark.parametrize("filename", ["", "walk", "walk.bvh.exe", "walk.npy", "bvh"])
def test_other_files_are_refused(filename):
    assert_refused(lambda: style_name(filename), file="upload", place="file name")


def test_a_valid_clip_is_within_the_limits(zombie_bvh):
    check_upload("walk", zombie_bvh.read_bytes())


def test_styles_are_learned_of_the_runs_kind(library, monkeypatch):
    monkeypatch.undo()
    run = library.get("run").run
    config = page_config(run)
    assert config == default_config(run) and (config.method, config.rank) == (RESTYLED_FEW_SHOT.method, 4)
    assert uploads.QUICK_FILM.method == "film" and max(uploads.QUICK_FILM.eval_epochs) <= 50
