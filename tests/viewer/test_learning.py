"""Uploads: what is refused leaves no trace, and what is learned is what few-shot learns."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import jax
import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.sources import ClipFile, check_style_name
from pfnn_jax.runtime import turning
from pfnn_jax.runtime.learn import learn_style
from pfnn_jax.training.few_shot import FewShotConfig
from pfnn_jax.training.run import load_run, load_style
from pfnn_jax.viewer import learning
from pfnn_jax.viewer.actor import Actor
from pfnn_jax.viewer.learning import (
    MOST_BYTES,
    GivenUp,
    check_upload,
    give_up,
    learn_upload,
    page_config,
    prepare_learning,
    style_name,
)
from pfnn_jax.viewer.stage import Stage

FRAME = 1.0 / 60.0
SMALL = FewShotConfig("cp", 4, learning_rates=(1e-3,), main_dropouts=(0.0,), stops=(1,))


@pytest.fixture(scope="module")
def run_path(played_run, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("learning") / "run"
    shutil.copytree(played_run, path)
    return path


@pytest.fixture(scope="module")
def stage(run_path) -> Stage:
    return Stage([run_path])


@pytest.fixture(autouse=True)
def quickly(monkeypatch):
    monkeypatch.setattr(turning, "SECONDS", 1.2)  # whether it is stable is not the question here
    monkeypatch.setattr(learning, "page_config", lambda run: SMALL)


def contents(folder: Path) -> dict[str, bytes | None]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def test_an_upload_becomes_a_style_as_few_shot_learns_it(stage, run_path, zombie_bvh, tmp_path):
    prepare_learning(stage, "run")
    told: list[tuple[float, str]] = []
    before = set(contents(run_path))
    name = learn_upload(stage, "run", "C:\\clips\\zombie walk.bvh", zombie_bvh.read_bytes(), lambda *t: told.append(t))
    assert name == "zombie walk" and ("run", name) in stage.styles
    assert all(new.startswith(("uploads", "styles/zombie walk")) for new in set(contents(run_path)) - before)
    assert (run_path / "uploads" / "zombie walk.bvh").read_bytes() == zombie_bvh.read_bytes()
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and shares[0] == 0.0 and told[-1] == (1.0, "done") and len(told) > 5

    again = tmp_path / "again"
    shutil.copytree(run_path, again)
    learn_style(load_run(again), ClipFile(zombie_bvh, "same"), SMALL)
    here, there = load_style(load_run(run_path), name), load_style(load_run(again), "same")
    jax.tree.map(np.testing.assert_array_equal, here, there)

    actor = Actor(stage, style="neutral")
    actor.set_stick(1.0, 0.0)
    actor.advance(0.0)
    actor.choose("run", name)
    views = [actor.advance(frame * FRAME) for frame in range(1, 121)]
    assert views[-1].style_weights == pytest.approx({name: 1.0}, abs=0.01)
    assert np.isfinite(views[-1].joints).all()

    assert learn_upload(stage, "run", "zombie walk.bvh", zombie_bvh.read_bytes()) == "zombie walk 2"


BAD = {
    "nothing": b"",
    "no text": b"HIERARCHY\0ROOT",
    "a pickle": b"\x80\x04\x95cposix\nsystem\n(S'true'\ntR.",
    "no motion": b"HIERARCHY\nROOT Hips\n{\n",
    "too large": b" " * (MOST_BYTES + 1),
    "too many joints": b"HIERARCHY\n" + b"JOINT a\n{\n" * 300,
    "too many frames": b"HIERARCHY\nMOTION\nFrames: 999999\nFrame Time: 0.0166\n",
    "too long": b"HIERARCHY\nMOTION\nFrames: 6000\nFrame Time: 0.0166\n",
}


@pytest.mark.parametrize("data", BAD.values(), ids=BAD)
def test_a_bad_upload_changes_nothing(stage, run_path, data):
    before, styles = contents(run_path), stage.styles
    with pytest.raises(InputError) as refused:
        learn_upload(stage, "run", "bad.bvh", data)
    assert str(run_path) not in str(refused.value)
    assert contents(run_path) == before and stage.styles == styles


def test_clips_that_read_well_but_cannot_be_learned_change_nothing(stage, run_path, zombie_bvh):
    before, text = contents(run_path), zombie_bvh.read_text()
    still = re.sub(r"(Frames:).*", r"\1 100", text.split("Frame Time")[0]) + "Frame Time: 0.0166667\n"
    row = text.split("Frame Time")[1].splitlines()[1]
    other = text.replace("LeftUpLeg", "LeftThigh").replace("JOINT Spine1", "JOINT Belly")
    for data in (still + (row + "\n") * 100, text.replace("0.01666", "0.0000166"), other):
        with pytest.raises(InputError) as refused:
            learn_upload(stage, "run", "walk.bvh", data.encode())
        assert str(run_path) not in str(refused.value)
        assert contents(run_path) == before
    with pytest.raises(InputError, match="must be one of run"):
        learn_upload(stage, "../run", "walk.bvh", text.encode())


def test_a_first_upload_that_fails_leaves_no_folder(played_run, tmp_path, monkeypatch):
    path = tmp_path / "run"
    shutil.copytree(played_run, path)
    before = contents(path)

    def broken(*_, **__):
        assert (path / "uploads" / "walk.bvh").is_file()
        raise MemoryError

    monkeypatch.setattr(learning, "learn_style", broken)
    with pytest.raises(MemoryError):
        learn_upload(Stage([path]), "run", "walk.bvh", b"HIERARCHY")
    assert contents(path) == before


def test_a_page_that_ends_leaves_no_trace_of_what_it_learns(played_run, zombie_bvh, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(played_run, path)
    before, ending = contents(path), Stage([path])

    def end(share: float, what: str) -> None:
        assert (path / "uploads" / "walk.bvh").is_file()
        give_up(ending, wait=0.0)
        assert contents(path) == before

    with pytest.raises(GivenUp):
        learn_upload(ending, "run", "walk.bvh", zombie_bvh.read_bytes(), end)
    assert contents(path) == before


def test_an_upload_never_leaves_the_run(stage, run_path, tmp_path):
    elsewhere, uploads = tmp_path / "elsewhere", run_path / "uploads"
    elsewhere.mkdir()
    kept = tmp_path / "kept"
    if uploads.exists():
        uploads.rename(kept)
    uploads.symlink_to(elsewhere, target_is_directory=True)
    try:
        with pytest.raises(InputError, match="must be a folder of the run itself"):
            learn_upload(stage, "run", "walk.bvh", b"HIERARCHY")
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
def test_names_are_harmless(filename, name):
    assert style_name(filename) == name == check_style_name(name)


@pytest.mark.parametrize("filename", ["", "walk", "walk.bvh.exe", "walk.npy", "bvh"])
def test_other_files_are_refused(filename):
    with pytest.raises(InputError, match="must end in .bvh"):
        style_name(filename)


def test_a_sound_clip_passes_the_limits(zombie_bvh):
    check_upload("walk", zombie_bvh.read_bytes())


def test_a_page_learns_styles_of_the_runs_kind(stage, monkeypatch):
    monkeypatch.undo()
    config = page_config(stage.cast("run").run)
    assert config == FewShotConfig("cp", 4)
    assert learning.QUICK_FILM.method == "film" and max(learning.QUICK_FILM.stops) <= 50
