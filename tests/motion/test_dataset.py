"""Prepared datasets: every row of every style, mirrored in pairs, whole or absent, and readable back."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip, cut, mirror_clip
from pfnn_jax.motion.datasets import dataset as dataset_module
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


def test_styles_keep_all_of_their_rows_and_have_the_layouts_columns(dataset):
    assert dataset.styles == ("angry", "old", "proud")
    # both ends of every take are lost; symmetric styles are mirrored
    assert dataset.frames == {"angry": 2 * 178, "old": 358, "proud": 2 * (238 + 118)}
    assert dataset.frames_per_style == 356 and set(dataset.rows) == {"train"}
    for style, rows in dataset.frames.items():
        x, y, phase = dataset.arrays(style)
        assert x.shape == (rows, dataset.layout.input_size)
        assert y.shape == (rows, dataset.layout.output_size)
        assert phase.shape == (rows,)
        assert x.dtype == y.dtype == phase.dtype == np.float32
        assert isinstance(x, np.memmap) and not x.flags.writeable


def test_takes_stand_in_time_order_each_before_its_mirror_image(dataset):
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


def test_without_mirroring_only_the_clips_themselves(takes, tmp_path):
    dataset = prepare(takes, tmp_path / "set", PrepareConfig(mirror=False))
    assert dataset.frames["proud"] == 238 + 118 and not any(clip["mirrored"] for clip in dataset.clips)


def test_statistics_are_those_of_all_rows_to_train_on(takes, tmp_path):
    """Merged take by take, as good as over all rows at once."""
    dataset = prepare(takes, tmp_path / "set", PrepareConfig(validation=0.2))
    rows = [np.concatenate([dataset.arrays(style)[k] for style in dataset.styles]) for k in (0, 1)]
    whole = fit_normaliser(rows[0], rows[1], dataset.layout)
    for side in ("inputs", "outputs"):
        found, wanted = getattr(dataset.normaliser, side), getattr(whole, side)
        np.testing.assert_allclose(found.mean, wanted.mean, atol=FLOAT32)
        np.testing.assert_allclose(found.std, wanted.std, rtol=FLOAT32, atol=FLOAT32)


def test_rows_are_those_of_their_clip_and_frame(dataset, takes):
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


def test_grouped_statistics_are_an_option(takes, tmp_path):
    dataset = prepare(takes, tmp_path / "set", PrepareConfig(grouped_std=True))
    at = dataset.layout.input_slice("joint_position")
    assert len(set(dataset.normaliser.inputs.std[at].tolist())) == 1


def test_loading_gives_the_same_dataset(dataset):
    loaded = load_dataset(dataset.path)
    assert loaded.layout == dataset.layout and loaded.styles == dataset.styles
    assert loaded.clips == dataset.clips and loaded.rows == dataset.rows
    assert loaded.takes_without_window == {"train": {"angry": 2, "old": 0, "proud": 4}}
    assert skeleton_to_json(loaded.skeleton) == skeleton_to_json(dataset.skeleton)
    data = json.loads((dataset.path / "dataset.json").read_text())
    assert set(data["versions"]) == {"pfnn_jax", "numpy"} and data["config"]["seed"] == 0


def test_clips_without_steps_are_left_out_and_named(takes, tmp_path):
    walk = takes[0].clip
    path = tmp_path / "standing.bvh"
    write_bvh(path, still(walk))
    dataset = prepare([*takes, ClipFile(path, "proud")], tmp_path / "set", PrepareConfig())
    assert [(entry["file"], entry["style"]) for entry in dataset.skipped] == [(str(path), "proud")]
    assert "no steps" in dataset.skipped[0]["reason"]


def test_a_clip_too_short_for_a_window_is_left_out(takes, tmp_path):
    short = dataclasses.replace(takes[0], clip=dataclasses.replace(cut(takes[0].clip, 0, 20), source="short"))
    dataset = prepare([*takes, short], tmp_path / "set", PrepareConfig())
    assert dataset.skipped[0]["reason"] == "20; must be at least 30, one trajectory window"


def test_a_style_of_which_nothing_remains_is_refused(takes, tmp_path):
    path = tmp_path / "standing.bvh"
    write_bvh(path, still(takes[0].clip))
    with pytest.raises(InputError, match="standing.bvh: style sad: 1 clips, none of use; .*no steps"):
        prepare([*takes, ClipFile(path, "sad")], tmp_path / "set", PrepareConfig())
    assert [p.name for p in tmp_path.iterdir()] == ["standing.bvh"]


def test_real_folders_prepare(mocap, tmp_path):
    files = list_clips(mocap / "bandai-namco-2")[::30]
    seen = []
    dataset = prepare(files, tmp_path / "set", PrepareConfig(), progress=lambda *event: seen.append(event))
    assert dataset.layout.input_size == 174 and len(dataset.styles) == 7 and not dataset.skipped
    assert [event[:2] for event in seen] == [(i + 1, len(files)) for i in range(len(files))]
    for style in dataset.styles:
        assert all(np.isfinite(array).all() for array in dataset.arrays(style))


def test_skeletons_that_differ_are_refused(takes, mocap, tmp_path):
    other = ClipFile(mocap / "xia" / "neutral_01_000.bvh", "xia")
    with pytest.raises(InputError, match="neutral_01_000.bvh: skeleton: 31 joints, .* of 21 joints"):
        prepare([*takes, other], tmp_path / "set", PrepareConfig())
    skeleton = takes[0].clip.skeleton
    renamed = dataclasses.replace(skeleton, names=(*skeleton.names[:-1], "Tail"))
    clip = dataclasses.replace(takes[0].clip, skeleton=renamed, source="tail.bvh", style="zz")
    with pytest.raises(InputError, match="tail.bvh: joint 20: Tail under joint 19; .* RightToeBase under 19"):
        prepare([*takes, dataclasses.replace(takes[0], clip=clip)], tmp_path / "set", PrepareConfig())
    assert not list(tmp_path.iterdir())


def test_an_existing_folder_is_only_replaced_when_asked(takes, tmp_path):
    out = tmp_path / "set"
    out.mkdir()
    (out / "precious").write_text("kept")
    with pytest.raises(InputError, match="exists; .*--overwrite"):
        prepare(takes, out, PrepareConfig())
    assert (out / "precious").read_text() == "kept"
    prepare(takes[:1], out, PrepareConfig(), overwrite=True)
    assert not (out / "precious").exists() and load_dataset(out).styles == ("proud",)
    assert [p.name for p in tmp_path.iterdir()] == ["set"]


def test_a_failure_to_write_leaves_nothing_and_keeps_the_old(takes, tmp_path, monkeypatch):
    out = tmp_path / "set"
    prepare(takes[:1], out, PrepareConfig())

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(dataset_module, "write_dataset", full_disk)
    with pytest.raises(InputError, match="set: folder: .*No space left on device; must be writable"):
        prepare(takes, out, PrepareConfig(), overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["set"] and load_dataset(out).styles == ("proud",)


def test_no_clips_and_bad_settings_are_refused(tmp_path):
    with pytest.raises(InputError, match="clips: none; a dataset needs at least one"):
        prepare([], tmp_path / "set", PrepareConfig())
    with pytest.raises(InputError, match="layout: mason2019; must be one of mason2018, pfnn2017"):
        PrepareConfig(layout="mason2019")
    with pytest.raises(InputError, match="fps: 30; layout mason2018 is made for 60"):
        PrepareConfig(fps=30)
    with pytest.raises(InputError, match="seed: -1"):
        PrepareConfig(seed=-1)
    with pytest.raises(InputError, match="test: 0.5; a share from 0 to below a half"):
        PrepareConfig(test=0.5)
    with pytest.raises(InputError, match="workers: 0; at least one process must work"):
        prepare([ClipFile(tmp_path / "a.bvh", "a")], tmp_path / "set", PrepareConfig(), workers=0)


def test_unknown_styles_name_the_known(dataset):
    with pytest.raises(InputError, match="style: sad; must be one of angry, old, proud"):
        dataset.arrays("sad")
    with pytest.raises(InputError, match="split: test; this dataset was prepared with train"):
        dataset.arrays("old", "test")


def _damage_json(path: Path) -> None:
    (path / "dataset.json").write_text("{")


def _age(path: Path) -> None:
    data = json.loads((path / "dataset.json").read_text())
    (path / "dataset.json").write_text(json.dumps(data | {"format": 0}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [(_damage_json, "dataset.json: file"), (_age, "format: 0; this version reads format 2")],
)
def test_damaged_datasets_are_refused(takes, tmp_path, damage, message):
    prepare(takes[:1], tmp_path / "set", PrepareConfig())
    damage(tmp_path / "set")
    with pytest.raises(InputError, match=message):
        load_dataset(tmp_path / "set")


def test_truncated_arrays_are_refused(takes, tmp_path):
    dataset = prepare(takes[:1], tmp_path / "set", PrepareConfig())
    path = dataset.path / "proud" / "x.npy"
    path.write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="x.npy: array"):
        dataset.arrays("proud")


def test_a_folder_that_is_no_dataset_is_refused(tmp_path):
    with pytest.raises(InputError, match="a dataset is a folder that prepare has written"):
        load_dataset(tmp_path)


def test_skeletons_survive_json_to_the_last_bit(takes):
    skeleton = takes[0].clip.skeleton
    back = skeleton_from_json(json.loads(json.dumps(skeleton_to_json(skeleton))))
    assert back.names == skeleton.names and back.roles == skeleton.roles
    for name in ("parents", "offsets", "mirror"):
        np.testing.assert_array_equal(getattr(back, name), getattr(skeleton, name))
    assert [joint for joint, _ in back.end_sites] == [joint for joint, _ in skeleton.end_sites]
    data = skeleton_to_json(skeleton)
    with pytest.raises(InputError, match="run.json: skeleton: no mirror"):
        skeleton_from_json({k: v for k, v in data.items() if k != "mirror"}, "run.json")
    with pytest.raises(InputError, match="skeleton.parents: 20 entries"):
        skeleton_from_json(data | {"parents": data["parents"][1:]})
