"""`pfnn-jax skeleton`: what it shows of a clip, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.humanoid.describe import rest_axes, rest_pose_kind
from pfnn_jax.motion.humanoid.find import find_humanoid
from pfnn_jax.motion.synthetic.walks import synthesise
from tests.motion.expected_maps import CHARACTERS, MOCAP
from tests.motion.rigs import character


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    path = tmp_path_factory.mktemp("walk") / "walk.bvh"
    write_bvh(path, synthesise("old", np.zeros(30), np.full(30, 1.0), seed=0)[0])
    return path


def show(*words: object) -> None:
    main(["skeleton", *map(str, words)])


def test_the_map_is_shown_and_written(walk, tmp_path, capsys):
    show(walk, "--json", tmp_path / "about.json")
    shown = capsys.readouterr().out
    about = json.loads((tmp_path / "about.json").read_text())
    assert about["map"]["left_shin"] == "LeftLeg" and about["map"]["spine"] == ["Spine", "Spine1"]
    assert (about["rest_pose"], about["up"], about["facing"], about["confidence"]) == ("T", "+Y", "+Z", 1.0)
    assert ["LeftHand", "RightHand"] in about["pairs"] and "Head" in about["midline"]
    assert about["leg_metres"] == pytest.approx(0.83, abs=0.01)
    lines = [line.split() for line in shown.splitlines()]
    assert ["shin", "LeftLeg", "RightLeg"] in lines and ["toe", "LeftToeBase", "RightToeBase"] in lines


def test_overrides_are_shown(walk, tmp_path, capsys):
    roles = tmp_path / "roles.json"
    roles.write_text(json.dumps({"head": "Neck", "neck": []}))
    show(walk, "--roles", roles)
    assert ["head", "Neck"] in [line.split() for line in capsys.readouterr().out.splitlines()]


def test_a_body_without_arms_is_shown(mocap, tmp_path):
    show(mocap / "field" / "slimevr_head_root.bvh", "--json", tmp_path / "about.json")
    about = json.loads((tmp_path / "about.json").read_text())
    assert about["map"] == MOCAP["field/slimevr_head_root.bvh"] and about["rest_pose"] == "standing"
    assert about["left_out"] == ["HMD"]


def test_a_wrong_override_is_one_line(walk, tmp_path, capsys):
    roles = tmp_path / "roles.json"
    roles.write_text(json.dumps({"left_shin": "Knee"}))
    with pytest.raises(SystemExit) as stopped:
        show(walk, "--roles", roles)
    shown = capsys.readouterr()
    assert stopped.value.code == 2 and shown.out == ""
    assert shown.err.count("\n") == 1 and "bone left_shin: 'Knee'" in shown.err


@pytest.mark.parametrize(
    ("name", "kind", "axes"),
    [
        ("cesiumman", "A", ("+Y", "+Z")),
        ("godot_platformer", "A", ("+Y", "-Z")),
        ("kaykit_mage", "T", ("+Y", "+Z")),
        ("metarig_malebase", "A", ("+Y", "+X")),
        ("sketchbook_boxman", "arms down", ("+Y", "+Z")),
        ("vrm0_godette", "T", ("+Y", "-Z")),
        ("rigify_lumberjack", "a frame of the motion", ("+Y", "+Z")),
    ],
)
def test_the_rest_pose_of_characters(characters, name, kind, axes):
    skeleton, poses, _ = character(characters, name)
    humanoid = find_humanoid(skeleton, poses=poses)
    assert humanoid.names(skeleton.names) == CHARACTERS[name]
    assert (rest_pose_kind(skeleton, humanoid), rest_axes(skeleton, humanoid)) == (kind, axes)


@pytest.mark.parametrize(
    ("file", "kind"),
    [
        ("bandai-namco-2/dataset-2_walk_normal_001.bvh", "none"),
        ("field/dfki_walk.bvh", "none"),
        ("field/sway.bvh", "T"),
    ],
)
def test_the_rest_pose_of_files(mocap, tmp_path, file, kind):
    show(mocap / file, "--json", tmp_path / "about.json")
    assert json.loads((tmp_path / "about.json").read_text())["rest_pose"] == kind
