"""Motion onto characters and rigs from the command line: every kind of file, and bad input as one line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.motion.bvh import read_bvh, read_whole, write_bvh
from pfnn_jax.motion.clip_files import read_any_skeleton, read_clip
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.reading import ReadOptions
from pfnn_jax.motion.synthetic.samples import SAMPLES, make_sample
from pfnn_jax.motion.synthetic.walks import synthesise

STAYS = 0.35  # metres that hips sway on the spot
TRAVELS = 2.0  # metres
STILL = 0.02  # quaternion components; rotations of BVH files have six decimals
ARM = ("upper_arm", "lower_arm", "hand")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A walk, our own body as a character, and a rig in metres."""
    folder = tmp_path_factory.mktemp("retarget")
    frames = np.zeros(180)
    write_bvh(folder / "walk.bvh", synthesise("proud", frames, frames + 1.2)[0])
    write_bvh(folder / "rig.bvh", make_sample(SAMPLES["soldier"]), unit=1.0)
    run("retarget", folder / "walk.bvh", "--out", folder / "character.glb", "--name", "first")
    return folder


def run(*words: object) -> None:
    main([str(word) for word in words])


def travel_of(path: Path, clip_name: str | None = None) -> float:
    """Returns how far the hips get from where they begin, in metres."""
    places = read_clip(path, travel="keep", clip_name=clip_name).root_positions[:, [0, 2]]
    return float(np.linalg.norm(places - places[0], axis=-1).max())


def test_a_character_gets_one_more_clip_in_place(folder):
    run("retarget", folder / "walk.bvh", "--onto", folder / "character.glb", "--out", folder / "more.glb", "--loop")
    assert travel_of(folder / "more.glb", clip_name="first") < STAYS
    assert travel_of(folder / "more.glb", clip_name="walk") < STAYS


def test_a_clip_whose_name_is_taken_is_given_another_and_says_so(folder, capsys):
    onto = ("--onto", folder / "character.glb", "--out", folder / "second.glb")
    run("retarget", folder / "walk.bvh", *onto, "--name", "first")
    assert "called 'first_2'" in capsys.readouterr().out
    assert travel_of(folder / "second.glb", clip_name="first_2") < STAYS


def test_root_motion_travels(folder):
    run("retarget", folder / "walk.bvh", "--out", folder / "travels.glb", "--root-motion")
    assert travel_of(folder / "travels.glb") > TRAVELS


def test_a_rig_becomes_a_bvh_file_in_its_own_unit(folder):
    run("retarget", folder / "walk.bvh", "--onto", folder / "rig.bvh", "--out", folder / "onto.bvh")
    clip, rig = read_bvh(folder / "onto.bvh"), read_bvh(folder / "rig.bvh")
    assert clip.skeleton.names == rig.skeleton.names
    raw = [read_whole(folder / name, ReadOptions(unit=1.0)).skeleton.offsets for name in ("onto.bvh", "rig.bvh")]
    np.testing.assert_allclose(raw[0], raw[1], atol=1e-5)  # six decimals


def test_a_mannequin_is_grown_on_a_rig(folder):
    run("retarget", folder / "walk.bvh", "--onto", folder / "rig.bvh", "--out", folder / "grown.glb")
    assert set(read_bvh(folder / "rig.bvh").skeleton.names) <= set(read_clip(folder / "grown.glb").skeleton.names)


def test_a_character_gives_its_skeleton_to_a_bvh_file(folder):
    run("retarget", folder / "walk.bvh", "--onto", folder / "character.glb", "--out", folder / "onto_character.bvh")
    names = read_clip(folder / "character.glb").skeleton.names
    assert {*names} <= {*read_bvh(folder / "onto_character.bvh").skeleton.names}
    assert travel_of(folder / "onto_character.bvh") > TRAVELS


@pytest.mark.parametrize(("target", "suffix"), [("character.glb", ".glb"), ("rig.bvh", ".bvh"), ("rig.bvh", ".glb")])
def test_joints_of_a_character_or_rig_can_be_named(folder, target, suffix):
    """Without a left arm in its map, the left arm keeps its pose."""
    (folder / "armless.json").write_text(json.dumps({f"left_{part}": None for part in ARM}))
    out = folder / f"armless_{target}{suffix}"
    options = ("--onto", folder / target, "--onto-roles", folder / "armless.json")
    run("retarget", folder / "walk.bvh", *options, "--out", out, "--name", "armless")
    clip = read_clip(out, clip_name="armless" if suffix == ".glb" else None, travel="keep")
    body = need_humanoid(clip.skeleton)
    swing = [np.ptp(clip.rotations[:, joint], axis=0).max() for joint in (body.left_upper_arm, body.right_upper_arm)]
    assert swing[0] < STILL < swing[1]


def test_notes_on_a_rig_name_its_own_options(folder, capsys):
    """Legs of 6.4 units are 0.64 m in decimetres, and 0.36 m in CMU's unit."""
    clip = make_sample(SAMPLES["soldier"])
    leg = leg_length_of(clip.skeleton, need_humanoid(clip.skeleton))
    write_bvh(folder / "doubtful.bvh", clip, unit=leg / 6.4)
    words = ("retarget", folder / "walk.bvh", "--onto", folder / "doubtful.bvh", "--out", folder / "onto_doubtful.bvh")
    run(*words)
    (note,) = (line for line in capsys.readouterr().out.splitlines() if "unit" in line)
    assert "`--onto-unit`" in note
    run(*words, "--onto-unit", "decimetre", "--overwrite")
    assert "unit" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("target", "option", "value"),
    [
        ("character.glb", "--onto-unit", 1000),
        ("rig.bvh", "--onto-unit", 1000),
        ("character.glb", "--onto-roles", "footless.json"),
        ("rig.bvh", "--onto-roles", "footless.json"),
    ],
)
def test_a_refused_character_names_its_own_options(folder, capsys, monkeypatch, target, option, value):
    monkeypatch.chdir(folder)
    Path("footless.json").write_text(json.dumps({"left_foot": None, "left_toe": None}))
    with pytest.raises(SystemExit) as stopped:
        run("retarget", "walk.bvh", "--onto", target, option, value, "--out", "refused.glb")
    assert stopped.value.code == 2 and not Path("refused.glb").exists()
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"pfnn-jax: {target}: ") and option in line


def test_feet_stand_at_the_heights_that_the_motion_of_a_rig_shows(folder):
    from pfnn_jax.workflows.characters import put_onto_rig

    moved, _ = put_onto_rig(read_clip(folder / "walk.bvh"), folder / "rig.bvh")
    shown = read_any_skeleton(folder / "rig.bvh").resting_heights
    assert shown is not None and moved.skeleton.resting_heights is not None
    np.testing.assert_array_equal(moved.skeleton.resting_heights, shown)


def test_a_vrm_animation_is_written_without_a_character(folder):
    run("retarget", folder / "walk.bvh", "--out", folder / "walk.vrma")
    assert travel_of(folder / "walk.vrma") < STAYS


@pytest.mark.parametrize(
    ("words", "place"),
    [
        (("--out", "walk.fbx"), "suffix"),
        (("--out", "absent/walk.glb"), "folder"),
        (("--out", "character.glb"), "output"),
        (("--out", "new.vrm"), "suffix"),
        (("--out", "new.vrm", "--onto", "character.glb"), "suffix"),
        (("--out", "new.vrma", "--onto", "character.glb"), "onto"),
        (("--out", "new.bvh", "--root-motion"), "root-motion"),
        (("--out", "new.bvh", "--onto", "rig.bvh", "--root-motion"), "root-motion"),
        (("--out", "new.glb", "--onto-unit", "0.01"), "onto-unit"),
        (("--out", "new.glb", "--onto-roles", "roles.json"), "onto-roles"),
        (("--out", "new.glb", "--onto", "character.glb", "--onto-unit", "-1"), "unit"),
        (("--out", "new.glb", "--onto", "character.glb", "--onto-roles", "absent.json"), "file"),
        (("--out", "new.glb", "--onto", "absent.glb"), "file"),
        (("--out", "new.glb", "--onto", "walk.txt"), "suffix"),
        (("--out", "new.glb", "--onto", "cut.glb"), "header"),
    ],
)
def test_bad_input_ends_in_one_line_and_writes_nothing(folder, capsys, monkeypatch, words, place):
    monkeypatch.chdir(folder)
    Path("cut.glb").write_bytes(Path("character.glb").read_bytes()[:1000])
    before = sorted(folder.iterdir())
    with pytest.raises(SystemExit) as stopped:
        run("retarget", "walk.bvh", *words)
    assert stopped.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and f": {place}: " in lines[0], lines
    assert sorted(folder.iterdir()) == before
