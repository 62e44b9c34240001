"""Prepared datasets: balanced, mirrored in pairs, whole or absent, and readable back."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion import dataset as dataset_module
from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip, cut, mirror_clip
from pfnn_jax.motion.dataset import Dataset, PrepareConfig, load_dataset, prepare, stack
from pfnn_jax.motion.features import clip_features
from pfnn_jax.motion.labelled import LabelledClip, load_labelled
from pfnn_jax.motion.layout import pfnn2017
from pfnn_jax.motion.phase import mirror_phase, write_phase
from pfnn_jax.motion.skeleton import skeleton_from_json, skeleton_to_json
from pfnn_jax.motion.sources import ClipFile, list_clips
from pfnn_jax.motion.synthetic import mixed_schedule, synthesise
from pfnn_jax.motion.trajectory import wrap_angle

FLOAT32 = 1e-5  # a few ulp of normalised values


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


def test_styles_have_equal_frames_and_the_layouts_columns(dataset):
    assert dataset.styles == ("angry", "old", "proud")
    # 3 s of the shortest style, both of its ends lost, mirrored; 6 s of an unmirrored style have fewer
    assert dataset.frames_per_style == min(2 * 178, 358, 2 * (238 + 118))
    for style in dataset.styles:
        x, y, phase = dataset.arrays(style)
        assert x.shape == (dataset.frames_per_style, dataset.layout.input_size)
        assert y.shape == (dataset.frames_per_style, dataset.layout.output_size)
        assert phase.shape == (dataset.frames_per_style,)
        assert x.dtype == y.dtype == phase.dtype == np.float32
        assert isinstance(x, np.memmap) and not x.flags.writeable


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


def test_symmetric_styles_hold_each_chosen_frame_and_its_mirrored_twin(dataset):
    half = dataset.frames_per_style // 2
    for style, symmetric in (("angry", True), ("proud", True), ("old", False)):
        clips, frames = dataset.sources(style)
        mirrored = np.array([entry["mirrored"] for entry in dataset.clips])[clips]
        assert mirrored.sum() == (half if symmetric else 0)
        if symmetric:
            _, _, phase = dataset.arrays(style)
            assert (frames[:half] == frames[half:]).all() and not mirrored[:half].any()
            np.testing.assert_allclose(wrap_angle(phase[:half] - phase[half:] - np.pi), 0.0, atol=1e-5)


def test_no_frame_is_chosen_twice(dataset):
    for style in dataset.styles:
        assert len(set(zip(*(a.tolist() for a in dataset.sources(style)), strict=True))) == dataset.frames_per_style


def test_without_mirroring_only_the_clips_themselves(takes, tmp_path):
    dataset = prepare(takes, tmp_path / "set", PrepareConfig(mirror=False))
    assert dataset.frames_per_style == 178 and not any(clip["mirrored"] for clip in dataset.clips)


def test_the_choice_of_frames_follows_the_seed(takes, tmp_path, dataset):
    same, other = (prepare(takes, tmp_path / str(seed), PrepareConfig(seed=seed)) for seed in (0, 1))
    for clip_or_frame in (0, 1):
        assert (same.sources("proud")[clip_or_frame] == dataset.sources("proud")[clip_or_frame]).all()
    assert (other.sources("proud")[1] != dataset.sources("proud")[1]).any()


def test_a_stack_is_normalised_over_all_styles(dataset):
    x, y, phase = stack(dataset)
    assert x.shape == (3, dataset.frames_per_style, dataset.layout.input_size)
    assert x.dtype == y.dtype == phase.dtype == np.float32
    std = y.reshape(-1, y.shape[-1]).astype(np.float64).std(axis=0)
    varies = std > 0.5  # the trajectory's present sample and the hips are at (0, 0), and face (0, 1)
    assert (~varies).sum() == 6
    np.testing.assert_allclose(std[varies], 1.0, rtol=1e-3)
    np.testing.assert_allclose(y.mean(axis=(0, 1)), 0.0, atol=1e-3)
    restored = dataset.normaliser.inputs.invert(x[1])
    np.testing.assert_allclose(restored, dataset.arrays("old")[0], atol=1e-4)
    first, _, _ = stack(dataset, ["proud", "angry"])
    np.testing.assert_allclose(first[0], x[2], atol=FLOAT32)


def test_grouped_statistics_are_an_option(takes, tmp_path):
    dataset = prepare(takes, tmp_path / "set", PrepareConfig(grouped_std=True))
    at = dataset.layout.input_slice("joint_position")
    assert len(set(dataset.normaliser.inputs.std[at].tolist())) == 1


def test_loading_gives_the_same_dataset(dataset):
    loaded = load_dataset(dataset.path)
    assert loaded.layout == dataset.layout and loaded.styles == dataset.styles
    assert loaded.clips == dataset.clips and loaded.frames_per_style == dataset.frames_per_style
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
    assert dataset.skipped[0]["reason"] == "20; one trajectory window needs at least 30"


def test_a_style_of_which_nothing_remains_is_refused(takes, tmp_path):
    path = tmp_path / "standing.bvh"
    write_bvh(path, still(takes[0].clip))
    with pytest.raises(InputError, match="standing.bvh: style sad: 1 clips, none of use; .*no steps"):
        prepare([*takes, ClipFile(path, "sad")], tmp_path / "set", PrepareConfig())
    assert [p.name for p in tmp_path.iterdir()] == ["standing.bvh"]


def test_a_phase_file_beside_a_clip_wins(takes, tmp_path):
    path = tmp_path / "walk.bvh"
    write_bvh(path, takes[0].clip)
    found = load_labelled(ClipFile(path, "proud"))
    shifted = dataclasses.replace(found.labels, phase=(found.labels.phase + 1.0) % (2 * np.pi))
    write_phase(path.with_suffix(".phase"), shifted)
    corrected = load_labelled(ClipFile(path, "proud"))
    np.testing.assert_allclose(wrap_angle(corrected.labels.phase - found.labels.phase - 1.0), 0.0, atol=1e-5)
    assert corrected.clip.style == "proud" and corrected.gait is None


def test_hand_made_labels_are_cut_and_resampled_with_their_clip(mocap):
    file = list_clips(mocap / "pfnn")[0]
    whole, part = load_labelled(file), load_labelled(dataclasses.replace(file, start=400, stop=1000))
    assert part.clip.num_frames == part.labels.num_frames == 300
    assert part.gait is not None and whole.gait is not None
    np.testing.assert_allclose(part.labels.phase, whole.labels.phase[200:500], atol=1e-9)
    np.testing.assert_allclose(part.gait, whole.gait[200:500], atol=1e-9)
    assert clip_features(part.clip, pfnn2017(31), part.labels, part.gait).x.shape[1] == 342


def test_real_folders_prepare(mocap, tmp_path):
    files = list_clips(mocap / "bandai-namco-2")[::30]
    seen = []
    dataset = prepare(files, tmp_path / "set", PrepareConfig(), progress=lambda *event: seen.append(event))
    assert dataset.layout.input_size == 174 and len(dataset.styles) == 7 and not dataset.skipped
    assert [event[:2] for event in seen] == [(i + 1, len(files)) for i in range(len(files))]
    x, y, _ = stack(dataset)
    assert np.isfinite(x).all() and np.isfinite(y).all()


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
    with pytest.raises(InputError, match="exists; overwriting must be asked for"):
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


def test_unknown_styles_name_the_known(dataset):
    with pytest.raises(InputError, match="style: sad; must be one of angry, old, proud"):
        dataset.arrays("sad")


def _damage_json(path: Path) -> None:
    (path / "dataset.json").write_text("{")


def _age(path: Path) -> None:
    data = json.loads((path / "dataset.json").read_text())
    (path / "dataset.json").write_text(json.dumps(data | {"format": 0}))


@pytest.mark.parametrize(
    ("damage", "message"),
    [(_damage_json, "dataset.json: file"), (_age, "format: 0; this version reads format 1")],
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
