"""Listing folders of clips: the names, tables and corrections of each convention, and refusals that name the fault."""

from __future__ import annotations

from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.datasets.labelled import load_clip, read_cut_clip
from pfnn_jax.motion.datasets.sources import (
    ASYMMETRIC,
    ClipFile,
    check_style_name,
    find_kind,
    is_symmetric,
    list_clips,
    select_styles,
    style100_files,
)
from pfnn_jax.motion.datasets.style100 import CUTS as CUTS_FILE
from pfnn_jax.motion.datasets.style100 import read_tables
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.length_unit import CMU
from pfnn_jax.motion.skeleton import need_roles
from tests.motion.skeletons import body_clip
from tests.raising import assert_refused

CUTS = "STYLE_NAME,FW_START,FW_STOP,ID_START,ID_STOP\nAngry,2,6,3,200\nOld,0,4,N/A,N/A\n"
STYLES = "Style Name,Description,Stochastic,Symmetric,Notes\nAngry,x,No,Yes,\nOld,y,No,No,\n"


def fill(folder: Path, *names: str) -> Path:
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    return folder


def test_bandai_names_and_corrected_turns(tmp_path):
    fill(tmp_path, "dataset-2_walk-turn-left_masculine_006.bvh", "dataset-2_walk-turn-left_masculine_008.bvh")
    fill(tmp_path, "dataset-1_walk-back_old_001.bvh")
    clips = list_clips(tmp_path)
    assert find_kind(tmp_path) == "bandai"
    assert [(clip.style, clip.content) for clip in clips] == [
        ("old", "walk-back"),
        ("masculine", "walk-turn-right"),  # turns right, contrary to its name
        ("masculine", "walk-turn-left"),
    ]
    assert all(clip.symmetric and clip.unit == 0.01 and clip.stop is None for clip in clips)


def test_xia_names(tmp_path):
    clips = list_clips(fill(tmp_path, "angry_13_000.bvh", "sexy_05_001.bvh"))
    assert [(clip.style, clip.content, clip.unit) for clip in clips] == [("angry", "run", CMU), ("sexy", "05", CMU)]


def test_pfnn_lists_labelled_clips_without_their_mirror_images(tmp_path):
    fill(tmp_path, "Walk.bvh", "Walk.phase", "Walk_mirror.bvh", "Walk_mirror.phase", "rest.bvh")
    assert [(clip.path.name, clip.style, clip.content) for clip in list_clips(tmp_path)] == [
        ("Walk.bvh", "neutral", "Walk")
    ]


@pytest.mark.parametrize("inner", ["", "{style}/"])
def test_100style_cuts_and_symmetry(tmp_path, inner):
    (tmp_path / "Frame_Cuts.csv").write_text(CUTS)
    (tmp_path / "Dataset_List.csv").write_text(STYLES)
    fill(tmp_path, inner.format(style="Angry") + "Angry_FW.bvh", inner.format(style="Old") + "Old_FW.bvh")
    angry, old = list_clips(tmp_path)
    assert angry.cut_by == (tmp_path / "Frame_Cuts.csv", "line 2, style Angry, FW")
    assert (angry.style, angry.content, angry.symmetric, angry.start, angry.stop) == ("Angry", "walk", True, 2, 6)
    assert (old.symmetric, old.start, old.stop) == (False, 0, 4)
    (tmp_path / "Dataset_List.csv").unlink()
    assert [clip.symmetric for clip in list_clips(tmp_path)] == [True, False]  # by the paper's list


@pytest.mark.parametrize(
    ("cuts", "styles", "message"),
    [
        (None, STYLES, "Frame_Cuts.csv: file: absent; must be present"),
        ("STYLE_NAME,FW_START,FW_STOP\nOld,1,2\n", STYLES, "Frame_Cuts.csv: style Angry: no row; must"),
        ("STYLE_NAME,FW_START,FW_STOP\nAngry,N/A,N/A\n", STYLES, "style Angry: FW_START N/A, FW_STOP N/A; must"),
        ("STYLE_NAME,FW_START,FW_STOP\nAngry,9,2\n", STYLES, "style Angry: FW_START 9, FW_STOP 2; must"),
        ("STYLE_NAME,FW_START\nAngry,9\n", STYLES, "style Angry: FW_START 9, FW_STOP None; must"),
        ("NAME\nAngry\n", STYLES, "Frame_Cuts.csv: line 1: no column STYLE_NAME; must"),
        ("", STYLES, "Frame_Cuts.csv: line 1: no column STYLE_NAME; must"),
        (CUTS, "Style Name,Symmetric\nAngry,perhaps\n", "Dataset_List.csv: line 2: Symmetric perhaps; must"),
        ("STYLE_NAME\n" + "x" * 200_000, STYLES, "must be a table of comma-separated values"),
    ],
)
def test_faults_in_the_tables_of_100style_are_named(tmp_path, cuts, styles, message):
    fill(tmp_path, "Angry_FW.bvh")
    if cuts is not None:
        (tmp_path / "Frame_Cuts.csv").write_text(cuts)
    (tmp_path / "Dataset_List.csv").write_text(styles)
    with pytest.raises(InputError) as error:
        list_clips(tmp_path)
    assert message in str(error.value)


def test_one_folder_per_style(tmp_path):
    fill(tmp_path, "calm/a.bvh", "calm/b.BVH", "LeftHop/a.bvh", "limping/a.bvh", "notes/readme.txt")
    (tmp_path / "asymmetric.txt").write_text("Limping\n\n")
    clips = list_clips(tmp_path)
    assert find_kind(tmp_path) == "folders"
    assert [(clip.style, clip.content, clip.symmetric, clip.unit) for clip in clips] == [
        ("LeftHop", "a", True, None),  # not in asymmetric.txt, which replaces the papers' lists
        ("calm", "a", True, None),
        ("calm", "b", True, None),
        ("limping", "a", False, None),
    ]
    (tmp_path / "asymmetric.txt").unlink()
    assert [clip.style for clip in list_clips(tmp_path) if not clip.symmetric] == ["LeftHop"]  # by the papers' lists
    (tmp_path / "asymmetric.txt").write_text("hopping\n")
    call = partial(list_clips, tmp_path)
    assert_refused(call, file="asymmetric.txt", place="line", value="hopping", rule_mentions="style folder")
    (tmp_path / "asymmetric.txt").write_bytes(b"\xff\xfe\xff")
    assert_refused(call, file="asymmetric.txt", place="file", value="not text")


def test_a_single_file_is_listed_alone(tmp_path):
    fill(tmp_path, "sneaking.bvh", "dataset-1_run_old_001.bvh", "angry_13_000.bvh")
    assert list_clips(tmp_path / "sneaking.bvh") == [ClipFile(tmp_path / "sneaking.bvh", "sneaking")]
    assert list_clips(tmp_path / "dataset-1_run_old_001.bvh")[0].style == "old"
    assert list_clips(tmp_path / "angry_13_000.bvh")[0].content == "run"
    (tmp_path / "Frame_Cuts.csv").write_text(CUTS)
    assert list_clips(fill(tmp_path, "Old_FW.bvh") / "Old_FW.bvh")[0].stop == 4


def test_selecting_styles_refuses_an_unknown_one(tmp_path):
    for style in ("old", "normal"):
        fill(tmp_path / style, "a.bvh")
    clips = list_clips(tmp_path)
    assert [clip.style for clip in select_styles(clips, ["old"], tmp_path)] == ["old"]
    call = partial(select_styles, clips, ["old", "norml"], tmp_path)
    assert_refused(call, place="style", value="norml", rule_mentions="must be one of normal, old")


def test_folders_of_no_convention_are_refused(tmp_path):
    assert_refused(partial(list_clips, tmp_path / "none"), place="folder", value="absent")
    call = partial(list_clips, tmp_path)
    assert_refused(call, place="folder", value="no BVH or glTF files", rule_mentions="dataset-N")
    fill(tmp_path, "walk.bvh", "angry_13_000.bvh")
    assert_refused(call, place="folder", value="2 clips, such as angry_13_000", rule_mentions="dataset-N")
    assert_refused(partial(call, "xia"), place="file name", value="walk.bvh", rule_mentions="STYLE_CONTENT_TAKE.bvh")
    assert_refused(partial(call, "folders"), place="folder", value="no clips", rule_mentions="folders")
    kinds = "auto, bandai, 100style, xia, pfnn, folders"
    assert_refused(partial(call, "cmu"), place="kind", value="cmu", rule_mentions=kinds)


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", ".hidden", "a/b", "a\\b", "../up", "a\0b", "a\nb", " a", "a ", "a.", "a:b", "x" * 101, "老" * 67],
)
def test_style_names_that_are_not_valid_file_names_are_refused(name):
    assert_refused(partial(check_style_name, name, "run"), file="run", place="style name", rule_mentions="file name")


@pytest.mark.parametrize("name", ["angry", "Bouncy Left", "walk-2_b", "v1.5", "老人"])
def test_style_names_that_are_valid_file_names_are_accepted(name):
    assert check_style_name(name) == name


def test_styles_that_the_papers_did_not_mirror_are_asymmetric():
    assert not any(is_symmetric(name) for name in ("LeftHop", "Old", "WoundedLeg", "teapot"))
    assert is_symmetric("Angry") and is_symmetric("neutral")


def test_loading_cuts_and_resamples(tmp_path):
    path = tmp_path / "take.bvh"
    write_bvh(path, body_clip(frames=20, fps=30.0))
    clip = load_clip(ClipFile(path, "calm", "walk", start=5, stop=10))
    assert (clip.num_frames, clip.fps, clip.style, clip.content) == (9, 60.0, "calm", "walk")
    assert load_clip(ClipFile(path, "calm", start=5, stop=1000), fps=30.0).num_frames == 15  # a shortened file
    call = partial(load_clip, ClipFile(path, "calm", start=20, stop=30))
    assert_refused(call, file=path, place="cut", value="start 20", rule_mentions="20 frames of take.bvh")


def test_cuts_beyond_the_end_are_noted_or_refused_naming_the_table(tmp_path):
    write_bvh(tmp_path / "Angry_FW.bvh", body_clip(frames=20))
    (tmp_path / "Frame_Cuts.csv").write_text("STYLE_NAME,FW_START,FW_STOP\nOld,1,2\nAngry,5,90\n")
    take = read_cut_clip(list_clips(tmp_path)[0])
    assert (take.clip.num_frames, take.start, take.frames_in_file) == (15, 5, 20)
    assert take.note == "line 3, style Angry, FW: stop 90 lies beyond the clip's 20 frames, its end is used"
    assert not read_cut_clip(ClipFile(tmp_path / "Angry_FW.bvh", "angry", stop=20)).note
    (tmp_path / "Frame_Cuts.csv").write_text("STYLE_NAME,FW_START,FW_STOP\nAngry,25,90\n")
    call = partial(read_cut_clip, list_clips(tmp_path)[0])
    assert_refused(call, file=tmp_path / "Frame_Cuts.csv", place="line 2, style Angry, FW", value="start 25")


def test_the_published_tables_of_100style(mocap):
    """70 styles are symmetric; every clip has its frames or is marked as missing."""
    folder = mocap / "100style"
    symmetric = read_tables(folder).symmetric
    assert len(symmetric) == 100 and sum(symmetric.values()) == 70
    assert {style.lower() for style, value in symmetric.items() if not value} <= ASYMMETRIC
    styles = [line.split(",")[0] for line in (folder / CUTS_FILE).read_text().splitlines()[1:]]
    assert set(styles) == set(symmetric)
    listed = style100_files(folder, [folder / f"{style}_{gait}.bvh" for style in styles for gait in ("FW", "ID")])
    assert len(listed) == 200 and all(clip.stop is not None and clip.stop - clip.start > 240 for clip in listed)


COUNTS = {
    "bandai-namco-1": ("bandai", 56, 8, 30.0),
    "bandai-namco-2": ("bandai", 462, 7, 30.0),
    "100style": ("100style", 5, 2, 60.0),
    "xia": ("xia", 6, 4, 120.0),
    "pfnn": ("pfnn", 2, 1, 120.0),
}


@pytest.mark.parametrize("folder", COUNTS)
def test_real_folders_are_recognised_and_load(mocap, folder):
    kind, clips, styles, _ = COUNTS[folder]
    listed = list_clips(mocap / folder)
    assert (find_kind(mocap / folder), len(listed), len({clip.style for clip in listed})) == (kind, clips, styles)
    clip = load_clip(listed[0])
    roles = need_roles(clip.skeleton)
    assert clip.fps == 60.0 and clip.style == listed[0].style
    height = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0][:, roles.head, 1]
    assert 1.0 < np.median(height) < 1.9


def test_pretraining_styles_are_balanced(mocap):
    contents = Counter((clip.style, clip.content) for clip in list_clips(mocap / "bandai-namco-2"))
    assert len(contents) == 28 and contents[("active", "walk-turn-left")] == 18


def test_turns_go_in_the_direction_of_their_content(mocap):
    """Names of five Bandai-Namco turns are wrong: contents follow the change of the hips' heading."""
    for listed in list_clips(mocap / "bandai-namco-2"):
        if "turn" not in listed.content:
            continue
        clip = load_clip(listed, fps=15.0)
        roles = need_roles(clip.skeleton)
        joints = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]
        across = joints[:, roles.left_hip] - joints[:, roles.right_hip]
        heading = np.unwrap(np.arctan2(-across[:, 2], across[:, 0]))
        turned = np.degrees(heading[-1] - heading[0])
        assert 40 < abs(turned) < 300, listed.path.name
        assert ("left" in listed.content) == (turned > 0), listed.path.name
