"""Folders of different skeletons in one dataset: names of styles, the one skeleton, and what is refused."""

from __future__ import annotations

import dataclasses
import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.cli import main
from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import read_bvh, write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.datasets.clip_rows import labelled_features, load_for_layout, match_skeleton
from pfnn_jax.motion.datasets.data_sets import list_data_sets
from pfnn_jax.motion.datasets.dataset import Dataset
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.shared_unit import share_units
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.features.layout import block_columns, mason2018
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.length_unit import CENTIMETRE, INCH
from pfnn_jax.motion.skeleton import Skeleton, need_roles, skeleton_to_json
from pfnn_jax.motion.synthetic.skeleton import synthetic_skeleton
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_clips
from tests.motion.retargeting import known_heights, measured_heights
from tests.motion.rigs import quadruped
from tests.raising import assert_refused

BONES = 1e-6  # metres: rows are float32
RESTING = 0.005  # metres
SCALES = 0.005  # notes round the ratio of legs to two decimals
BANDAI = ("dataset-1_walk_angry_001", "dataset-1_walk_old_001")
XIA = ("angry_13_000", "neutral_01_000")
FOLDERS = ("bandai-namco-1", "xia", "walkers")
STYLES = ("bandai-namco-1_angry", "bandai-namco-1_old", "neutral", "proud", "walkers_old", "xia_angry")
LOCAL = PrepareConfig(layout="mason2022", validation=0.1)


def walk(scale: float = 1.0, style: str = "proud") -> MotionClip:
    clip, _ = synthesise(style, np.zeros(150), np.full(150, 1.2))
    skeleton = dataclasses.replace(clip.skeleton, offsets=clip.skeleton.offsets * scale)
    return dataclasses.replace(clip, skeleton=skeleton, root_positions=clip.root_positions * scale)


def save(path: Path, clip: MotionClip, unit: float = CENTIMETRE) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bvh(path, clip, unit=unit)
    return path


def save_style(folder: Path, style: str) -> Path:
    return save(folder / style / "take.bvh", walk())


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def rest_leg(skeleton: Skeleton) -> float:
    return leg_length_of(skeleton, need_humanoid(skeleton))


@pytest.fixture(scope="module")
def root(mocap, tmp_path_factory) -> Path:
    """A folder of three data sets: two of 60 and 120 frames per second, and the procedural walkers at 30."""
    root = tmp_path_factory.mktemp("several")
    for name, stems in (("bandai-namco-1", BANDAI), ("xia", XIA)):
        (root / name).mkdir()
        for stem in stems:
            shutil.copy(mocap / name / f"{stem}.bvh", root / name)
    for style in ("old", "proud"):
        (clip,) = synthetic_clips(style, 4.0, fps=30.0, clip_seconds=4.0)
        save(root / "walkers" / style / "mixed.bvh", clip.clip)
    return root


@pytest.fixture(scope="module")
def clips(root) -> list[ClipFile]:
    return list_data_sets([root / name for name in FOLDERS])


@pytest.fixture(scope="module")
def onto_walkers(clips, tmp_path_factory) -> Dataset:
    return prepare(clips, tmp_path_factory.mktemp("data") / "set", skeleton=synthetic_skeleton())


@pytest.fixture(scope="module")
def onto_bandai(clips, root, tmp_path_factory) -> Dataset:
    file = root / "bandai-namco-1" / f"{BANDAI[1]}.bvh"
    return prepare(clips, tmp_path_factory.mktemp("data") / "set", LOCAL, skeleton=file)


def bones_of_rows(dataset: Dataset, style: str) -> np.ndarray:
    """Returns the lengths [N, J - 1] of all bones below the root in metres, from the positions in the rows."""
    y, layout, skeleton = dataset.arrays(style)[1], dataset.layout, dataset.skeleton
    place = block_columns(layout.outputs)["joint_position"]
    positions = np.asarray(y, np.float64)[:, place].reshape(len(y), -1, 3) * layout.length_unit
    return np.linalg.norm(positions[:, 1:] - positions[:, skeleton.parents[1:]], axis=-1)


# one skeleton


@pytest.mark.parametrize("name", ["onto_walkers", "onto_bandai"])
def test_all_rows_are_of_one_skeleton(name, root, request):
    dataset: Dataset = request.getfixturevalue(name)
    bandai = read_bvh(root / "bandai-namco-1" / f"{BANDAI[1]}.bvh").skeleton
    wanted = synthetic_skeleton() if name == "onto_walkers" else bandai
    assert dataset.styles == STYLES and dataset.skeleton.names == wanted.names
    np.testing.assert_array_equal(dataset.skeleton.offsets, wanted.offsets)
    assert dataset.skeleton.roles == wanted.roles and dataset.skeleton.humanoid == wanted.humanoid
    for style in STYLES:
        assert all(np.isfinite(array).all() for array in dataset.arrays(style))
        own_bones = style.startswith("bandai") and name == "onto_bandai"  # another take may have other lengths
        if not own_bones:
            lengths = np.linalg.norm(wanted.offsets[1:], axis=-1)
            assert np.abs(bones_of_rows(dataset, style) - lengths).max() < BONES, style


@pytest.mark.parametrize("name", ["onto_walkers", "onto_bandai"])
def test_each_retargeted_clip_has_a_note_with_the_scale_of_its_legs(name, root, request):
    dataset: Dataset = request.getfixturevalue(name)
    own = "walkers" if name == "onto_walkers" else "bandai-namco-1"
    files = sorted(path for path in root.rglob("*.bvh") if own not in path.parts)
    stored = json.loads((dataset.path / "dataset.json").read_text())["notes"]
    noted = {note["file"]: note["note"] for note in stored if "retargeted" in note["note"]}
    assert len(stored) >= len(noted) and sorted(noted) == list(map(str, files))
    for path in files:
        source = read_bvh(path).skeleton
        text = noted[str(path)]
        assert f"retargeted from {source.num_joints} to {dataset.skeleton.num_joints} joints" in text
        scale = float(text.rpartition(" by ")[2])
        assert abs(scale - rest_leg(dataset.skeleton) / rest_leg(source)) <= SCALES


def test_rows_and_mirror_images_are_those_of_the_retargeted_clips(onto_walkers, clips):
    layout = mason2018(21)
    for clip in clips:
        moved = match_skeleton(load_for_layout(clip, layout), synthetic_skeleton())
        entries = [index for index, entry in enumerate(onto_walkers.clips) if entry["file"] == str(clip.path)]
        parts = labelled_features(moved, layout, mirror=clip.symmetric)
        assert [onto_walkers.clips[index]["mirrored"] for index in entries] == [False, True][: len(parts)]
        rows, _ = onto_walkers.sources(clip.style)
        for index, part in zip(entries, parts, strict=True):
            for found, wanted in zip(onto_walkers.arrays(clip.style), (part.x, part.y, part.phase), strict=True):
                np.testing.assert_array_equal(found[rows == index], wanted.astype(np.float32))


def test_clips_of_the_skeleton_itself_are_used_as_they_are(onto_bandai, root, tmp_path):
    alone = prepare(root / "bandai-namco-1", tmp_path / "set", LOCAL)
    assert alone.styles == ("angry", "old")
    onto_itself = prepare(root / "bandai-namco-1", tmp_path / "same", LOCAL, skeleton=alone.skeleton)
    assert not onto_itself.notes
    for style in alone.styles:
        for found, wanted in zip(onto_itself.arrays(style), alone.arrays(style), strict=True):
            np.testing.assert_array_equal(found, wanted)
        assert len(onto_bandai.arrays(f"bandai-namco-1_{style}")[0]) == len(alone.arrays(style)[0])


def test_hand_ends_are_joints_if_the_skeleton_has_them(clips, onto_bandai, tmp_path):
    assert onto_bandai.skeleton.num_joints == 21  # End Sites at the wrists
    dataset = prepare(clips, tmp_path / "set", LOCAL, skeleton=synthetic_skeleton())
    roles = need_roles(dataset.skeleton)
    assert dataset.skeleton.num_joints == 23 and dataset.skeleton.names[roles.left_hand] == "LeftHandSite"
    assert not [note for note in dataset.notes if "walkers" in note["file"]]
    again = prepare(clips[:2], tmp_path / "again", LOCAL, skeleton=dataset.skeleton)
    assert skeleton_to_json(again.skeleton) == skeleton_to_json(dataset.skeleton)


def test_clips_in_memory_and_on_disk_are_put_onto_one_skeleton(clips, tmp_path):
    walkers = synthetic_clips("proud", 4.0)
    files = [clip for clip in clips if clip.data_set == "xia"]
    dataset = prepare([*files, *walkers], tmp_path / "set", skeleton=files[0])
    assert dataset.skeleton.num_joints == 31 and dataset.styles == ("neutral", "proud", "xia_angry")
    assert {note["style"] for note in dataset.notes} == {"proud"}


def test_neither_order_nor_processes_change_a_byte(clips, onto_walkers, tmp_path):
    prepare(clips[::-1], tmp_path / "set", skeleton=synthetic_skeleton(), workers=2)
    assert files_of(tmp_path / "set") == files_of(onto_walkers.path)


def test_folders_of_one_skeleton_need_no_other(mocap, tmp_path):
    for name in ("bandai-namco-1", "bandai-namco-2"):
        (tmp_path / name).mkdir()
        for path in sorted((mocap / name).glob("*walk*_normal_001.bvh"))[:2]:
            shutil.copy(path, tmp_path / name)
    dataset = prepare(list_data_sets([tmp_path / "bandai-namco-1", tmp_path / "bandai-namco-2"]), tmp_path / "set")
    assert dataset.styles == ("bandai-namco-1_normal", "bandai-namco-2_normal")
    assert not [note for note in dataset.notes if "retargeted" in note["note"]]


def test_a_data_set_keeps_the_median_of_its_clips_resting_heights(root, tmp_path, onto_walkers):
    dataset = prepare(root / "xia", tmp_path / "set")
    heights = []
    for entry in dataset.clips:
        own = read_bvh(entry["file"]).skeleton.resting_heights
        assert own is not None
        heights.append(own[::-1] if entry["mirrored"] else own)
    np.testing.assert_array_equal(dataset.skeleton.resting_heights, np.median(heights, axis=0))
    np.testing.assert_array_equal(onto_walkers.skeleton.resting_heights, synthetic_skeleton().resting_heights)


def test_a_clip_of_the_same_joints_on_another_floor_is_put_onto_the_skeletons(mocap):
    layout = mason2018(31)
    pfnn = load_for_layout(list_clips(mocap / "pfnn" / "NewCaptures10_000.bvh")[0], layout)
    xia = read_bvh(mocap / "xia" / f"{XIA[0]}.bvh").skeleton
    labelled = match_skeleton(pfnn, xia)
    assert "retargeted from 31 to 31 joints" in labelled.note
    found = measured_heights(labelled.clip)
    np.testing.assert_allclose(found, known_heights(xia), atol=RESTING)
    own = load_for_layout(list_clips(mocap / "xia" / f"{XIA[1]}.bvh")[0], layout)
    assert match_skeleton(own, xia) is own


def test_a_folder_gives_the_same_bytes_listed_alone_or_as_a_data_set(root, tmp_path):
    prepare(root / "xia", tmp_path / "one")
    prepare(list_data_sets([root / "xia"]), tmp_path / "other")
    assert files_of(tmp_path / "one") == files_of(tmp_path / "other")


# names and units


def test_only_styles_of_the_same_name_get_the_name_of_their_folder(tmp_path):
    for folder, style in (("a", "old"), ("a", "proud"), ("b", "Old"), ("b", "sneaky"), ("c", "angry")):
        save_style(tmp_path / folder, style)
    clips = list_data_sets([tmp_path / name for name in "abc"])
    assert [clip.style for clip in clips] == ["a_old", "proud", "b_Old", "sneaky", "angry"]
    assert [clip.data_set for clip in clips] == ["a", "a", "b", "b", "c"]
    assert [clip.symmetric for clip in clips] == [False, True, False, True, True]  # by the name in the folder
    (alone, _) = list_data_sets([tmp_path / "a"])
    assert alone.style == "old"


def test_folders_of_the_same_name_are_told_apart_by_those_above(tmp_path):
    for folder in ("mine/bvh", "yours/bvh", "theirs"):
        save_style(tmp_path / folder, "old")
    clips = list_data_sets([tmp_path / name for name in ("mine/bvh", "yours/bvh", "theirs")])
    assert [clip.style for clip in clips] == ["mine_bvh_old", "yours_bvh_old", "theirs_old"]


def test_files_belong_to_the_folder_that_they_lie_in(tmp_path):
    names = ("a/dataset-1_walk_old_001", "a/dataset-1_walk_old_002", "b/dataset-1_run_old_001")
    paths = [save(tmp_path / f"{name}.bvh", walk()) for name in names]
    assert [clip.style for clip in list_data_sets(paths)] == ["a_old", "a_old", "b_old"]
    assert [clip.style for clip in list_data_sets(paths[:2])] == ["old", "old"]


def test_files_of_each_data_set_share_a_unit(tmp_path):
    """A child's legs may be those of an adult in another unit; only files of the same folder settle it."""
    for name, unit in (("inches", INCH), ("centimetres", CENTIMETRE)):
        save(tmp_path / name / "walk" / "child.bvh", walk(0.56), unit)
        save(tmp_path / name / "walk" / "man.bvh", walk(), unit)
    clips = share_units(list_data_sets([tmp_path / "inches", tmp_path / "centimetres"]))
    legs = [rest_leg(read_bvh(clip.path, unit=clip.read_options.unit).skeleton) for clip in clips]
    full = rest_leg(synthetic_skeleton())
    np.testing.assert_allclose(legs, [0.56 * full, full] * 2, rtol=1e-4)


# refusals


def test_different_skeletons_are_refused_with_advice(clips, root, tmp_path):
    call = partial(prepare, clips, tmp_path / "set")
    assert_refused(call, file=f"{XIA[0]}.bvh", place="skeleton", value="31 joints", rule_mentions="--skeleton")
    mixed = [*list_clips(root / "xia"), *synthetic_clips("proud", 4.0)]
    assert_refused(partial(prepare, mixed, tmp_path / "set"), place="skeleton", rule_mentions="--skeleton")
    assert not (tmp_path / "set").exists()


def test_a_skeleton_that_is_no_humanoid_is_refused(clips, tmp_path):
    animal = quadruped(0.5, 0.6, named=True)
    call = partial(prepare, clips, tmp_path / "set")
    assert_refused(partial(call, skeleton=animal), file="skeleton")
    still = dataclasses.replace(walk(), skeleton=animal, rotations=np.tile([1.0, 0, 0, 0], (150, animal.num_joints, 1)))
    path = save(tmp_path / "dog.bvh", still)
    assert_refused(partial(call, skeleton=path), file="dog.bvh")
    chain = Skeleton(("a", "b"), np.array([-1, 0]), np.ones((2, 3)), (), np.arange(2))
    assert_refused(partial(call, skeleton=chain), file="skeleton")
    assert not (tmp_path / "set").exists()


def test_a_clip_that_is_no_humanoid_is_a_bad_file(root, tmp_path):
    animal = quadruped(0.5, 0.6, named=True)
    still = dataclasses.replace(walk(), skeleton=animal, rotations=np.tile([1.0, 0, 0, 0], (150, animal.num_joints, 1)))
    save(tmp_path / "walkers" / "dog" / "still.bvh", still)
    save_style(tmp_path / "walkers", "proud")
    clips = list_data_sets([tmp_path / "walkers", root / "xia"])
    call = partial(prepare, clips, tmp_path / "set", skeleton=synthetic_skeleton())
    assert_refused(call, file="still.bvh")
    with pytest.raises(InputError, match="no usable clips"):
        call(skip_bad=True)


@pytest.mark.parametrize(
    ("skeleton", "value"), [(7, "int"), ("folder", "a folder"), ("absent.bvh", "absent")], ids=["type", "dir", "absent"]
)
def test_what_holds_no_skeleton_is_refused(clips, tmp_path, skeleton, value):
    (tmp_path / "folder").mkdir()
    given = tmp_path / skeleton if isinstance(skeleton, str) else skeleton
    assert_refused(partial(prepare, clips, tmp_path / "set", skeleton=given), value=value)


def test_folders_are_named_once(tmp_path):
    save_style(tmp_path / "a", "old")
    assert_refused(partial(list_data_sets, [tmp_path / "a", tmp_path / "a"]), file="take.bvh", value="listed twice")
    assert_refused(partial(list_data_sets, []), place="folders", value="none")
    save_style(tmp_path / "b", "old")
    save_style(tmp_path / "c", "a_old")
    call = partial(list_data_sets, [tmp_path / name for name in "abc"])
    assert_refused(call, place="style", value="a_old", rule_mentions="rename")


# the command


def command(*words) -> None:
    main([str(word) for word in words])


def test_the_command_takes_several_folders_and_a_skeleton(root, onto_walkers, tmp_path, capsys, monkeypatch):
    folders = [root / name for name in FOLDERS]
    command("prepare", *folders, "--out", tmp_path / "set", "--skeleton", "synthetic")
    assert files_of(tmp_path / "set") == files_of(onto_walkers.path)
    shown = capsys.readouterr().out
    assert "(and 1 more): retargeted from 31 to 21 joints" in shown
    for name in ("xia", root / "xia", root / "xia" / f"{XIA[0]}.bvh"):
        words = ("--styles", "proud", "--skeleton", name, "--json", tmp_path / "result.json")
        command("prepare", *folders, "--out", tmp_path / "set", "--overwrite", *words)
        result = json.loads((tmp_path / "result.json").read_text())
        assert result["styles"] == ["proud"] and "to 31 joints" in result["notes"][0]["note"]


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (
            ("--skeleton", "smpl"),
            "must be a BVH or glTF file, synthetic, or one of the folders: bandai-namco-1, xia, walkers",
        ),
        ((), "or put all clips onto one skeleton (--skeleton)"),
        (("--styles", "old"), "must be one of bandai-namco-1_angry, bandai-namco-1_old"),
    ],
    ids=["unknown", "none", "style"],
)
def test_the_command_refuses_in_one_line(root, tmp_path, capsys, words, rule):
    with pytest.raises(SystemExit) as stopped:
        command("prepare", *(root / name for name in FOLDERS), "--out", tmp_path / "set", *words)
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert stopped.value.code == 2 and rule in line
