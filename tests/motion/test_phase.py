"""Phase labels: agreement with labels made by hand, coverage of recorded gaits, refusal without steps, and files."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfnn_jax.errors import InputError
from pfnn_jax.motion.bvh import read_bvh
from pfnn_jax.motion.clip import MotionClip, mirror_clip, resample
from pfnn_jax.motion.datasets.labelled import load_clip
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import (
    CYCLE,
    PhaseLabels,
    cut_phase,
    label_phase,
    mirror_phase,
    read_phase,
    resample_phase,
    write_phase,
)
from pfnn_jax.motion.synthetic.walks import STYLES, mixed_schedule, synthesise
from tests.raising import assert_refused

FILE = 1e-6 * CYCLE  # radians; files hold six decimals of a cycle


def mean_difference(found: PhaseLabels, wanted: PhaseLabels) -> float:
    """Mean absolute difference in cycles, where both have labels."""
    both = found.labelled & wanted.labelled
    return float(np.abs(wrap_angle(found.phase - wanted.phase))[both].mean() / CYCLE)


def check_laws(labels: PhaseLabels) -> None:
    """Asserts a phase in range that never decreases, alternating feet, and contacts where the phase has them."""
    assert ((labels.phase >= 0) & (labels.phase < CYCLE)).all() and not labels.phase[~labels.labelled].any()
    together = labels.labelled[1:] & labels.labelled[:-1]
    step = wrap_angle(np.diff(labels.phase))[together]
    assert (step > 0).all()
    order = np.argsort(np.concatenate([labels.contacts_right, labels.contacts_left]), kind="stable")
    side = np.repeat([0, 1], [len(labels.contacts_right), len(labels.contacts_left)])[order]
    if labels.labelled.all():
        assert (np.diff(side) != 0).all()
    assert np.abs(wrap_angle(labels.phase[labels.contacts_right])).max(initial=0) <= step.max()
    assert np.abs(wrap_angle(labels.phase[labels.contacts_left] - np.pi)).max(initial=0) <= step.max()


# the labeller


@pytest.mark.parametrize("fps", [120.0, 60.0])
@pytest.mark.parametrize(
    ("stem", "limit"),
    [
        ("LocomotionFlat04_000", 0.04),
        ("LocomotionFlat04_000_mirror", 0.04),
        ("NewCaptures10_000", 0.025),
        ("NewCaptures10_000_mirror", 0.025),
    ],
)
def test_labels_agree_with_those_made_by_hand(mocap, stem, limit, fps):
    clip = read_bvh(mocap / "pfnn" / f"{stem}.bvh")
    hand = read_phase(mocap / "pfnn" / f"{stem}.phase", clip.num_frames)
    clip = resample(clip, fps)
    hand = resample_phase(hand, 120.0, fps, clip.num_frames)
    found = label_phase(clip)
    check_laws(found)
    assert found.labelled[hand.labelled].all()
    assert mean_difference(found, hand) < limit  # cycles


@pytest.mark.parametrize("style", ["active", "elderly", "exhausted", "feminine", "masculine", "normal", "youthful"])
def test_nearly_every_frame_of_walks_and_runs_is_labelled(mocap, style):
    files = [file for file in list_clips(mocap / "bandai-namco-2") if file.style == style][::9]
    assert {file.content for file in files} >= {"walk", "run"}
    for file in files:
        labels = label_phase(load_clip(file))
        check_laws(labels)
        assert labels.labelled.mean() > 0.95, file.path.name
        halves = np.diff(np.sort(np.concatenate([labels.contacts_right, labels.contacts_left]))) / 60
        assert 0.2 < halves.min() and halves.max() < 1.0, (file.path.name, halves)


@pytest.mark.parametrize("name", ["neutral_01_000", "sexy_01_000", "angry_13_000", "depressed_13_000"])
def test_a_single_cycle_is_enough(mocap, name):
    clip = read_bvh(mocap / "xia" / f"{name}.bvh")
    labels = [label_phase(resample(clip, fps)) for fps in (120.0, 60.0)]
    for found in labels:
        check_laws(found)
        assert found.labelled.mean() > 0.95
    halved = resample_phase(labels[0], 120.0, 60.0, labels[1].num_frames)
    assert mean_difference(labels[1], halved) < 0.02  # cycles: one frame is about 0.02


def test_a_long_take_with_many_turns_is_labelled_within_its_cut(mocap):
    file = next(file for file in list_clips(mocap / "100style") if file.path.stem == "Angry_FW")
    labels = label_phase(load_clip(file))
    check_laws(labels)
    assert labels.labelled.mean() > 0.95


@pytest.mark.parametrize("name", ["depressed_18_000", "neutral_16_000"])
def test_a_punch_and_a_jump_are_refused(mocap, name):
    path = mocap / "xia" / f"{name}.bvh"
    with pytest.raises(NoGaitError, match=rf"{name}.bvh: phase: 0 foot contacts"):
        label_phase(read_bvh(path))


def test_the_refusal_names_the_rate_of_the_file_not_that_of_the_resampled_clip(mocap):
    file = ClipFile(mocap / "xia-test" / "neutral_16_000.bvh", "neutral")
    with pytest.raises(NoGaitError, match="the file's 120 frames per second"):
        label_phase(load_clip(file, fps=60.0))


def test_a_standing_clip_is_refused(mocap):
    file = next(file for file in list_clips(mocap / "100style") if file.path.stem == "Neutral_ID")
    with pytest.raises(NoGaitError, match="no steps"):
        label_phase(load_clip(file))


def _still(clip: MotionClip, frame: int, frames: int) -> MotionClip:
    index = np.full(frames, frame)
    return dataclasses.replace(clip, root_positions=clip.root_positions[index], rotations=clip.rotations[index])


def _join(*clips: MotionClip) -> MotionClip:
    return dataclasses.replace(
        clips[0],
        root_positions=np.concatenate([clip.root_positions for clip in clips]),
        rotations=np.concatenate([clip.rotations for clip in clips]),
    )


def test_a_walk_between_two_pauses_is_labelled_and_the_pauses_are_not():
    walk, _ = synthesise("neutral", np.zeros(400), np.full(400, 1.2))
    labels = label_phase(_join(_still(walk, 0, 120), walk, _still(walk, -1, 120)))
    check_laws(labels)
    assert labels.labelled[125:515].all()
    assert not labels.labelled[:110].any() and not labels.labelled[-110:].any()


@pytest.mark.parametrize("style", sorted(STYLES))
def test_procedural_walks_are_labelled_throughout(style):
    clip, truth = synthesise(style, *mixed_schedule(style, 12, 3), seed=1)
    labels = label_phase(clip)
    check_laws(labels)
    assert labels.labelled.all()
    # their clock starts at touch-down, the labeller's half a double support later
    late = wrap_angle(truth.phase - labels.phase) / CYCLE
    assert 0 < late.mean() < 0.1 and late.std() < 0.03


def test_mirrored_motion_has_mirrored_labels():
    clip, _ = synthesise("angry", *mixed_schedule("angry", 8, 1), seed=4)
    mirrored, wanted = label_phase(mirror_clip(clip)), mirror_phase(label_phase(clip))
    assert (mirrored.labelled == wanted.labelled).all()
    np.testing.assert_allclose(wrap_angle(mirrored.phase - wanted.phase), 0.0, atol=1e-6)


def test_labels_do_not_depend_on_size():
    clip, _ = synthesise("proud", *mixed_schedule("proud", 8, 1), seed=4)
    skeleton = dataclasses.replace(clip.skeleton, offsets=clip.skeleton.offsets * 2.5)
    giant = dataclasses.replace(clip, skeleton=skeleton, root_positions=clip.root_positions * 2.5)
    np.testing.assert_allclose(label_phase(giant).phase, label_phase(clip).phase, atol=1e-9)


# files


@st.composite
def some_labels(draw) -> PhaseLabels:
    """Labels with several runs and gaps; a gap of one frame is not kept by files."""
    lengths = draw(st.lists(st.integers(2, 30), min_size=1, max_size=6))
    first = draw(st.booleans())
    labelled = np.concatenate([np.full(length, first ^ bool(i % 2)) for i, length in enumerate(lengths)])
    rate = draw(st.floats(0.02, 0.5))
    phase = (draw(st.floats(0, 6.0)) + rate * np.arange(len(labelled))) % CYCLE
    empty = np.zeros(0, int)
    return PhaseLabels(np.where(labelled, phase, 0.0), labelled, empty, empty)


@given(labels=some_labels())
def test_reading_a_written_file_restores_every_label(tmp_path_factory, labels):
    path = tmp_path_factory.getbasetemp() / "a.phase"
    write_phase(path, labels, overwrite=True)
    if not labels.labelled.any():
        assert_refused(lambda: read_phase(path), file=path, value=f"{labels.num_frames} zeros")
        return
    back = read_phase(path, labels.num_frames)
    assert (back.labelled == labels.labelled).all()
    assert np.abs(wrap_angle(back.phase - labels.phase)).max() <= FILE
    lines = path.read_text().splitlines()
    assert len(lines) == labels.num_frames and all(len(line.split(".")[1]) >= 5 for line in lines)


def test_a_gap_of_one_frame_is_widened_by_a_frame(tmp_path):
    labelled = np.arange(9) != 4
    empty = np.zeros(0, int)
    write_phase(tmp_path / "a.phase", PhaseLabels(np.where(labelled, 2.0, 0.0), labelled, empty, empty))
    assert np.flatnonzero(~read_phase(tmp_path / "a.phase").labelled).tolist() == [4, 5]


def test_reading_a_written_file_restores_contacts(tmp_path):
    clip, _ = synthesise("neutral", np.zeros(300), np.full(300, 1.2))
    labels = label_phase(_join(_still(clip, 0, 60), clip))
    write_phase(tmp_path / "a.phase", labels)
    back = read_phase(tmp_path / "a.phase", labels.num_frames)
    assert (back.labelled == labels.labelled).all()
    assert (back.contacts_right == labels.contacts_right).all()
    assert (back.contacts_left == labels.contacts_left).all()


def test_hand_made_files_have_no_label_before_the_first_and_after_the_last_step(mocap):
    labels = read_phase(mocap / "pfnn" / "LocomotionFlat04_000.phase", 2428)
    labelled = np.flatnonzero(labels.labelled)
    assert (labelled == np.arange(98, 2141)).all()  # its footsteps file: right foot at line 98, last at line 2141
    assert labels.contacts_right[:3].tolist() == [198, 288, 377]
    assert labels.contacts_left[:3].tolist() == [155, 236, 334]


@pytest.mark.parametrize(
    ("text", "place", "value"),
    [
        ("0.1\n0.2\n", "lines", 2),
        ("0.1\nhalf\n0.3\n", "line 2", "half"),
        ("0.1\n0.2\n1.2\n", "line 3", 1.2),
        ("0.1\nnan\n0.3\n", "line 2", np.nan),
        ("0.1\n0.2 0.3\n0.3\n", "line 2", "2 values"),
        ("0.1\n\n0.3\n", "line 2", "0 values"),
        ("0\n0\n0\n", "file", "3 zeros"),
        ("", "lines", 0),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path, text, place, value):
    path = tmp_path / "bad.phase"
    path.write_text(text)
    error = assert_refused(lambda: read_phase(path, 3), file=path, place=place, value=value)
    assert "\n" not in str(error)


def test_a_missing_file_is_refused(tmp_path):
    assert_refused(lambda: read_phase(tmp_path / "none.phase"), file="none.phase", place="file")


def test_an_existing_file_is_replaced_only_with_overwrite(tmp_path):
    path = tmp_path / "a.phase"
    path.write_text("kept")
    labels = PhaseLabels(np.array([0.1, 0.2]), np.array([True, True]), np.zeros(0, int), np.zeros(0, int))
    with pytest.raises(InputError, match="exists"):
        write_phase(path, labels)
    assert path.read_text() == "kept"
    write_phase(path, labels, overwrite=True)
    assert read_phase(path).num_frames == 2 and [p.name for p in tmp_path.iterdir()] == ["a.phase"]


# whole labels


def test_resampling_keeps_the_phase_in_time():
    _, labels = synthesise("neutral", np.zeros(240), np.full(240, 1.2), fps=120.0)
    half = resample_phase(labels, 120.0, 60.0, 120)
    np.testing.assert_allclose(half.phase, labels.phase[::2], atol=1e-12)
    up = resample_phase(half, 60.0, 120.0, 239)
    np.testing.assert_allclose(wrap_angle(up.phase - labels.phase[:239]), 0.0, atol=1e-3)
    third = resample_phase(labels, 120.0, 90.0, 170)
    assert third.labelled.all() and (wrap_angle(np.diff(third.phase)) > 0).all()


def test_resampling_labels_only_between_labelled_frames():
    phase = np.linspace(0.1, 1.0, 10)
    labelled = np.ones(10, bool)
    labelled[[0, 5]] = False
    empty = np.zeros(0, int)
    up = resample_phase(PhaseLabels(np.where(labelled, phase, 0), labelled, empty, empty), 30.0, 60.0, 19)
    expected = np.ones(19, bool)
    expected[[0, 1, 9, 10, 11]] = False
    assert (up.labelled == expected).all()


def test_cutting_moves_the_contacts():
    _, labels = synthesise("neutral", np.zeros(240), np.full(240, 1.2))
    part = cut_phase(labels, 50, 200)
    assert part.num_frames == 150 and (part.phase == labels.phase[50:200]).all()
    kept = labels.contacts_right[(labels.contacts_right >= 50) & (labels.contacts_right < 200)]
    assert (part.contacts_right == kept - 50).all()


def test_a_skeleton_without_roles_is_refused():
    clip, _ = synthesise("neutral", np.zeros(60), np.full(60, 1.2))
    bare = dataclasses.replace(clip, skeleton=dataclasses.replace(clip.skeleton, roles=None), source="a.bvh")
    assert_refused(lambda: label_phase(bare), file="a.bvh", place="skeleton")


def test_a_phase_file_must_have_a_line_for_each_frame(mocap, tmp_path):
    """A `.phase` file of another length than the BVH file is refused when a clip is loaded with its labels."""
    from pfnn_jax.motion.datasets.labelled import load_labelled

    source = mocap / "xia" / "neutral_01_000.bvh"
    path = tmp_path / source.name
    path.write_bytes(source.read_bytes())
    path.with_suffix(".phase").write_text("0.5\n")
    assert_refused(lambda: load_labelled(ClipFile(path, "neutral")), place="lines", value=1, rule_mentions="327")
