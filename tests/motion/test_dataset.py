"""Prepared datasets: all rows of all styles, mirrored in pairs, written completely or not at all, and read back."""

from __future__ import annotations

import dataclasses
import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip, cut, mirror_clip
from pfnn_jax.motion.datasets import preparation
from pfnn_jax.motion.datasets.dataset import Dataset, load_dataset
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.datasets.preparation import PrepareConfig, prepare
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.features.encode import clip_features
from pfnn_jax.motion.features.normaliser import fit_normaliser
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.skeleton import skeleton_from_json, skeleton_to_json
from pfnn_jax.motion.synthetic.walks import mixed_schedule, synthesise
from tests.raising import assert_refused

FLOAT32 = 1e-5  # a few ulp of values of order 10


def take(style: str, seconds: float, seed: int = 0, symmetric: bool = True) -> LabelledClip:
    clip, labels = synthesise(style, *mixed_schedule(style, seconds, seed), seed=seed)
    return LabelledClip(clip, labels, None, symmetric)


def still(clip: MotionClip) -> MotionClip:
    index = np.zeros(clip.num_frames, int)
    return dataclasses.replace(clip, root_positions=clip.root_positions[index], rotations=clip.rotations[index])


@pytest.fixture(scope="module")
def takes() -> list[LabelledClip]:
    """Two symmetric styles and an asymmetric one, of different lengths."""
    return [take("proud", 4), take("angry", 3, 1), take("proud", 2, 2), take("old", 6, 3, symmetric=False)]


@pytest.fixture(scope="module")
def dataset(takes, tmp_path_factory) -> Dataset:
    return prepare(takes, tmp_path_factory.mktemp("data") / "set", PrepareConfig())


def test_styles_keep_all_rows_with_the_columns_of_the_layout(dataset):
    assert dataset.styles == ("angry", "old", "proud")
    # a clip's first and last frame have no row; symmetric styles are mirrored
    assert dataset.frames == {"angry": 2 * 178, "old": 358, "proud": 2 * (238 + 118)}
    assert dataset.frames_per_style == 356 and set(dataset.rows) == {"train"}
    for style, rows in dataset.frames.items():
        x, y, phase = dataset.arrays(style)
        assert x.shape == (rows, dataset.layout.input_size)
        assert y.shape == (rows, dataset.layout.output_size)
        assert phase.shape == (rows,)
        assert x.dtype == y.dtype == phase.dtype == np.float32
        assert isinstance(x, np.memmap) and not x.flags.writeable


def test_clips_are_in_time_order_each_before_its_mirror_image(dataset):
    for style in dataset.styles:
        clips, frames = dataset.sources(style)
        assert (np.diff(clips) >= 0).all() and (np.diff(frames)[np.diff(clips) == 0] == 1).all()
        for index in np.unique(clips)[1:]:
            entry, before = dataset.clips[index], dataset.clips[index - 1]
            assert entry["mirrored"] == (entry["file"] == before["file"])
            if entry["mirrored"]:
                _, _, phase = dataset.arrays(style)
                np.testing.assert_array_equal(frames[clips == index], frames[clips == index - 1])
                turned = wrap_angle(phase[clips == index] - phase[clips == index - 1] - np.pi)
                np.testing.assert_allclose(wrap_angle(turned), 0.0, atol=1e-5)


def test_without_mirroring_no_clip_is_mirrored(takes, tmp_path):
    dataset = prepare(takes, tmp_path / "set", PrepareConfig(mirror=False))
    assert dataset.frames["proud"] == 238 + 118 and not any(clip["mirrored"] for clip in dataset.clips)


@pytest.mark.parametrize("grouped", [False, True])
def test_statistics_merged_clip_by_clip_are_those_of_all_training_rows(takes, tmp_path, grouped):
    dataset = prepare(takes, tmp_path / "set", PrepareConfig(validation=0.2, grouped_std=grouped))
    rows = [np.concatenate([dataset.arrays(style)[k] for style in dataset.styles]) for k in (0, 1)]
    whole = fit_normaliser(rows[0], rows[1], dataset.layout, grouped)
    for side in ("inputs", "outputs"):
        found, wanted = getattr(dataset.normaliser, side), getattr(whole, side)
        np.testing.assert_allclose(found.mean, wanted.mean, atol=FLOAT32)
        np.testing.assert_allclose(found.std, wanted.std, rtol=FLOAT32, atol=FLOAT32)


def test_rows_equal_the_features_of_their_clip_and_frame(dataset, takes):
    for style in dataset.styles:
        x, y, phase = dataset.arrays(style)
        clips, frames = dataset.sources(style)
        for index in np.unique(clips):
            entry = dataset.clips[index]
            source = next(t for t in takes if t.clip.source == entry["file"])
            clip, labels = source.clip, source.labels
            if entry["mirrored"]:
                clip, labels = mirror_clip(clip), mirror_phase(labels)
            features = clip_features(clip, dataset.layout, labels)
            rows = np.searchsorted(features.frames, frames[clips == index])
            np.testing.assert_array_equal(x[clips == index], features.x[rows])
            np.testing.assert_array_equal(y[clips == index], features.y[rows])
            np.testing.assert_array_equal(phase[clips == index], features.phase[rows])


def test_by_default_statistics_share_one_deviation_per_block(dataset):
    at = dataset.layout.input_slice("joint_position")
    assert len(set(dataset.normaliser.inputs.std[at].tolist())) == 1


def test_loading_returns_the_same_dataset(dataset):
    loaded = load_dataset(dataset.path)
    assert loaded.layout == dataset.layout and loaded.styles == dataset.styles
    assert loaded.clips == dataset.clips and loaded.rows == dataset.rows
    assert loaded.takes_without_window == {"train": {"angry": 2, "old": 0, "proud": 4}}
    assert skeleton_to_json(loaded.skeleton) == skeleton_to_json(dataset.skeleton)
    data = json.loads((dataset.path / "dataset.json").read_text())
    assert set(data["versions"]) == {"pfnn_jax", "numpy"} and data["config"]["seed"] == 0


def test_clips_without_steps_are_skipped_and_named(takes, tmp_path):
    walk = takes[0].clip
    path = tmp_path / "standing.bvh"
    write_bvh(path, still(walk))
    dataset = prepare([*takes, ClipFile(path, "proud")], tmp_path / "set", PrepareConfig())
    assert [(entry["file"], entry["style"]) for entry in dataset.skipped] == [(str(path), "proud")]
    assert "no steps" in dataset.skipped[0]["reason"]


def test_a_clip_too_short_for_a_window_is_skipped(takes, tmp_path):
    short = dataclasses.replace(takes[0], clip=dataclasses.replace(cut(takes[0].clip, 0, 20), source="short"))
    dataset = prepare([*takes, short], tmp_path / "set", PrepareConfig())
    assert dataset.skipped[0]["reason"] == "20; must be at least 30, one trajectory window"


def test_a_style_without_usable_clips_is_refused(takes, tmp_path):
    path = tmp_path / "standing.bvh"
    write_bvh(path, still(takes[0].clip))
    call = partial(prepare, [*takes, ClipFile(path, "sad")], tmp_path / "set")
    assert_refused(call, file=path, place="style sad", value="no usable clips (1 skipped)", rule_mentions="no steps")
    assert [p.name for p in tmp_path.iterdir()] == ["standing.bvh"]


def test_a_real_folder_is_prepared_with_progress(mocap, tmp_path):
    files = list_clips(mocap / "bandai-namco-2")[::30]
    seen = []
    dataset = prepare(files, tmp_path / "set", PrepareConfig(), progress_callback=lambda *event: seen.append(event))
    assert dataset.layout.input_size == 174 and len(dataset.styles) == 7 and not dataset.skipped
    assert [event[:2] for event in seen] == [(i + 1, len(files)) for i in range(len(files))]
    for style in dataset.styles:
        assert all(np.isfinite(array).all() for array in dataset.arrays(style))


def test_skeletons_that_differ_are_refused(takes, mocap, tmp_path):
    other = ClipFile(mocap / "xia" / "neutral_01_000.bvh", "xia")
    call = partial(prepare, [*takes, other], tmp_path / "set")
    assert_refused(call, file="neutral_01_000.bvh", place="skeleton", rule_mentions="21 joints")
    skeleton = takes[0].clip.skeleton
    renamed = dataclasses.replace(skeleton, names=(*skeleton.names[:-1], "Tail"))
    clip = dataclasses.replace(takes[0].clip, skeleton=renamed, source="tail.bvh", style="zz")
    call = partial(prepare, [*takes, dataclasses.replace(takes[0], clip=clip)], tmp_path / "set")
    error = assert_refused(call, file="tail.bvh", place="joint 20", rule_mentions="RightToeBase")
    assert str(error.value).startswith("Tail")
    assert not list(tmp_path.iterdir())


def test_an_existing_folder_is_replaced_only_when_asked(takes, tmp_path):
    out = tmp_path / "set"
    out.mkdir()
    (out / "precious").write_text("kept")
    assert_refused(partial(prepare, takes, out), file=out, place="output", value="exists")
    assert (out / "precious").read_text() == "kept"
    prepare(takes[:1], out, PrepareConfig(), overwrite=True)
    assert not (out / "precious").exists() and load_dataset(out).styles == ("proud",)
    assert [p.name for p in tmp_path.iterdir()] == ["set"]


def test_a_failed_write_leaves_nothing_and_keeps_the_old_dataset(takes, tmp_path, monkeypatch):
    out = tmp_path / "set"
    prepare(takes[:1], out, PrepareConfig())

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(preparation, "_write_dataset", full_disk)
    assert_refused(partial(prepare, takes, out, overwrite=True), file=out)
    assert [p.name for p in tmp_path.iterdir()] == ["set"] and load_dataset(out).styles == ("proud",)


@pytest.mark.parametrize(
    ("field", "value"), [("layout", "mason2019"), ("fps", 30), ("seed", -1), ("validation", -0.1), ("test", 0.5)]
)
def test_bad_settings_are_refused(field, value):
    with pytest.raises(ValueError, match=rf"PrepareConfig\.{field} must .*{value}"):
        PrepareConfig(**{field: value})


@pytest.mark.parametrize(
    ("clips", "place"), [([], "clips"), (3, "clips"), ([("clip", "labels")], "clips[0]"), (["walk.bvh"], "clips[0]")]
)
def test_what_is_not_a_list_of_clips_is_refused_before_any_work(tmp_path, clips, place):
    assert_refused(partial(prepare, clips, tmp_path / "set"), file="set", place=place)
    assert not list(tmp_path.iterdir())


def test_no_workers_are_refused(tmp_path):
    clips = [ClipFile(tmp_path / "a.bvh", "a")]
    assert_refused(partial(prepare, clips, tmp_path / "set", workers=0), place="workers", value=0)


def test_paths_may_be_strings_and_settings_left_out(takes, tmp_path):
    folder = tmp_path / "bvh" / "calm"
    folder.mkdir(parents=True)
    write_bvh(folder / "walk.bvh", takes[0].clip)
    dataset = prepare(str(tmp_path / "bvh"), str(tmp_path / "set"))
    assert dataset.styles == ("calm",) and dataset.layout.name == "mason2018"
    assert load_dataset(str(tmp_path / "set")).rows == dataset.rows
    named: Any = str(folder / "walk.bvh")
    listed = prepare([ClipFile(named, "calm", "walk")], tmp_path / "listed")
    assert listed.rows == dataset.rows
    assert_refused(partial(prepare, str(tmp_path / "none"), tmp_path / "other"), file="none", value="absent")


def test_unknown_styles_and_splits_are_refused_with_the_known_ones(dataset):
    call = partial(dataset.arrays, "sad")
    assert_refused(call, place="style", value="sad", rule_mentions="must be one of angry, old, proud")
    assert_refused(partial(dataset.arrays, "old", "test"), place="split", value="test", rule_mentions="train")


def _damage_json(path: Path) -> None:
    (path / "dataset.json").write_text("{")


def _age(path: Path) -> None:
    data = json.loads((path / "dataset.json").read_text())
    (path / "dataset.json").write_text(json.dumps(data | {"format": 0}))


@pytest.mark.parametrize(
    ("damage", "place", "value"),
    [(_damage_json, "line 1", None), (_age, "format", 0)],
)
def test_damaged_datasets_are_refused(takes, tmp_path, damage, place, value):
    prepare(takes[:1], tmp_path / "set", PrepareConfig())
    damage(tmp_path / "set")
    assert_refused(partial(load_dataset, tmp_path / "set"), file="dataset.json", place=place, value=value)


def test_truncated_arrays_are_refused(takes, tmp_path):
    dataset = prepare(takes[:1], tmp_path / "set", PrepareConfig())
    path = dataset.path / "proud" / "x.npy"
    path.write_bytes(path.read_bytes()[:200])
    assert_refused(partial(dataset.arrays, "proud"), file=path, place="array", rule_mentions="prepare")


def test_a_folder_that_is_not_a_dataset_is_refused(tmp_path):
    assert_refused(partial(load_dataset, tmp_path), file="dataset.json", place="file", rule_mentions="prepare")


def test_json_keeps_skeletons_exactly(takes):
    skeleton = takes[0].clip.skeleton
    back = skeleton_from_json(json.loads(json.dumps(skeleton_to_json(skeleton))))
    assert back.names == skeleton.names and back.roles == skeleton.roles
    for name in ("parents", "offsets", "mirror", "resting_heights"):
        np.testing.assert_array_equal(getattr(back, name), getattr(skeleton, name))
    assert [joint for joint, _ in back.end_sites] == [joint for joint, _ in skeleton.end_sites]
    data = skeleton_to_json(skeleton)
    old = {k: v for k, v in data.items() if k != "resting_heights"}  # as versions before it wrote them
    assert skeleton_from_json(old).resting_heights is None
    incomplete = {k: v for k, v in data.items() if k != "mirror"}
    call = partial(skeleton_from_json, incomplete, "run.json")
    assert_refused(call, file="run.json", place="skeleton", value="no mirror")
    call = partial(skeleton_from_json, data | {"parents": data["parents"][1:]})
    assert_refused(call, place="skeleton.parents", value="20 entries")
