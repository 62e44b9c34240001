"""HTML players hold the motion exactly, stay small and safe, and show contacts and phases."""

from __future__ import annotations

import dataclasses
import re
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pfnn_jax.motion.bvh import write_bvh
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.datasets.labelled import LabelledClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_conjugate, quat_multiply, quat_rotate
from pfnn_jax.motion.labels.phase import label_phase
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.up_axis import TURNS
from pfnn_jax.viewer.draw.annotated_clip import AnnotatedClip, annotate, annotate_clips
from pfnn_jax.viewer.draw.filmstrip import filmstrip
from pfnn_jax.viewer.draw.scene import make_scene
from pfnn_jax.viewer.draw.upright import upright
from pfnn_jax.viewer.player import player
from pfnn_jax.viewer.player.notebook import show
from pfnn_jax.viewer.player.packing import pack
from pfnn_jax.viewer.player.player import player_html, player_page
from tests.raising import assert_refused
from tests.viewer.pages import captions, check_page, make_annotated, payload, played, unpack

ROUNDED = 0.6e-4  # metres: half of a tenth of a millimetre
NEAR = 1e-3  # metres: rounded rotations add up from the hips to a hand
BLENDED = 4e-3  # metres: weights in 255 parts, too
KILOBYTE = 1000
LABELLED = 0.2  # radians: the labeller times contacts to a frame or two


def test_player_contains_the_body_and_the_motion():
    annotated = make_annotated()
    data = payload(player_html([annotated], fps=30.0))
    scene, shown = make_scene(annotated.clip), played(data)
    every = slice(None, None, 2)
    assert data["clips"][0]["fps"] == 30.0 and len(shown.positions) == len(data["clips"][0]["phases"][0]["angle"])
    np.testing.assert_allclose(shown.positions, scene.positions[every], atol=NEAR)
    np.testing.assert_allclose(shown.focus, scene.focus[every], atol=ROUNDED)
    skin = shown.mesh.pose(shown.positions, shown.rotations)
    np.testing.assert_allclose(skin, scene.mesh.pose(scene.positions[every], scene.rotations[every]), atol=BLENDED)
    np.testing.assert_array_equal(shown.mesh.faces, scene.mesh.faces)
    np.testing.assert_array_equal(shown.mesh.colours, scene.mesh.colours)
    np.testing.assert_allclose(shown.mesh.weights.sum(axis=1), 1.0, rtol=1e-12)


def test_a_body_that_clips_share_is_written_once():
    clip = make_annotated()
    own = dataclasses.replace(make_scene(clip.clip).mesh, colours=np.zeros_like(make_scene(clip.clip).mesh.colours))
    data = payload(player_html([clip, clip, dataclasses.replace(clip, mesh=own)]))
    assert [shown["mesh"] for shown in data["clips"]] == [0, 0, 1] and len(data["meshes"]) == 2
    assert played(data, 2).mesh.colours.max() == 0


@given(
    arrays(np.int64, st.tuples(st.integers(1, 9), st.integers(1, 5)), elements=st.integers(-(2**30), 2**30 - 1)),
    st.sampled_from([1.0, 1e-4, 1 / 8191]),
)
def test_packed_numbers_come_back(values, unit):
    text = pack(values * unit, unit)
    np.testing.assert_array_equal(unpack(text, values.shape[1]), values)
    assert re.fullmatch("[A-Za-z0-9+/=]+", text)


@pytest.mark.parametrize("fps", [60.0, 30.0, 20.0])
def test_contacts_are_the_same_intervals_at_every_frame_rate(fps):
    annotated = make_annotated()
    data = payload(player_html([annotated], fps=fps))["clips"][0]
    assert annotated.contacts is not None
    for foot, runs in enumerate(data["contacts"]):
        down = np.zeros(annotated.clip.num_frames, bool)
        for first, past in runs:
            down[round(first * 60 / fps) : round(past * 60 / fps)] = True
        np.testing.assert_array_equal(down, annotated.contacts[:, 2 * foot : 2 * foot + 2].any(axis=1))


def test_a_second_takes_at_most_four_kilobytes_and_kilometres_fit():
    annotated = make_annotated(frames=1200)
    more = [len(player_html([annotated.cut_seconds(0, s)], assets=False)) for s in (10, 20)]
    assert more[1] - more[0] < 10 * 4 * KILOBYTE
    far = synthesise("neutral", np.zeros(600), np.full(600, 100.0))[0]
    shown = played(payload(player_html([AnnotatedClip("fast", far)])))
    scene = make_scene(far)
    assert scene.positions[-1, 0].max() > 900
    np.testing.assert_allclose(shown.positions, scene.positions[::2], atol=NEAR)


def test_pages_beyond_the_size_limit_are_refused(monkeypatch):
    monkeypatch.setattr(player, "MOST", 10 * KILOBYTE)
    assert_refused(lambda: player_html([make_annotated()]), place="player", rule_mentions="0.01 MB")
    monkeypatch.setattr(player, "MOST", 100 * KILOBYTE)
    player_html([make_annotated()])


def test_html_is_balanced_and_names_are_escaped():
    name = "</script><script>alert(1)</script>"
    page = player_page([make_annotated(name), make_annotated("plain", extras=False)], title=name)
    check_page(page.removeprefix("<!doctype html>"))
    assert name not in page
    assert captions(page) == [name, "plain"]
    assert page.count('class="scene"') == 2 and page.count('class="strip"') == 1


def test_empty_players_and_mismatched_lengths_are_refused():
    with pytest.raises(ValueError, match="at least one"):
        player_html([])
    annotated = make_annotated()
    with pytest.raises(ValueError, match="phase of 'x' has 3 frames, its clip 120"):
        AnnotatedClip("x", annotated.clip, phase=np.zeros(3))
    with pytest.raises(ValueError, match=r"phase of 'x' is \[120, 3\]"):
        AnnotatedClip("x", annotated.clip, phase=np.zeros((120, 3)))
    with pytest.raises(ValueError, match=r"contacts of 'x' are \[120, 3\]"):
        AnnotatedClip("x", annotated.clip, contacts=np.zeros((120, 3), bool))


def test_clips_that_cannot_be_shown_are_refused_by_file_and_frame():
    clip = dataclasses.replace(make_annotated().clip, source="a.bvh")
    empty = dataclasses.replace(clip, root_positions=clip.root_positions[:0], rotations=clip.rotations[:0])
    away, turned = clip.root_positions.copy(), clip.rotations.copy()
    away[7, 1], turned[9, 3] = np.inf, np.nan
    bad = {
        ("frames", "0"): empty,
        ("frame 7", "root positions not finite"): dataclasses.replace(clip, root_positions=away),
        ("frame 9", "rotations not finite"): dataclasses.replace(clip, rotations=turned),
        ("frame rate", "nan"): dataclasses.replace(clip, fps=np.nan),
    }
    for (place, value), shown in bad.items():
        for make in (lambda c: AnnotatedClip("x", c), lambda c: annotate(c, "x"), lambda c: annotate_clips([c])):
            assert_refused(partial(make, shown), file="a.bvh", place=place, value=value)


def test_paths_and_records_are_shown_as_their_clips(tmp_path):
    clip = dataclasses.replace(make_annotated(frames=150).clip, style="unknown", content="")
    path = tmp_path / "walk.bvh"
    write_bvh(path, clip)
    record = LabelledClip(clip, label_phase(clip))
    for shown in (path, str(path), record, make_annotated("walk", frames=150)):
        (annotated,) = annotate_clips([shown])
        assert annotated.clip.num_frames == 150 and annotated.contacts is not None
    assert annotate_clips([path])[0].name == "walk"


def test_anything_else_is_refused_before_any_work():
    for shown in (3, None, np.zeros((3, 3)), ["a"]):
        refused: Any = shown
        for draw in (show, filmstrip):
            call = partial(draw, make_annotated(), refused)
            assert_refused(call, place="clip 2", value=type(shown).__name__)
    assert_refused(lambda: show("missing.bvh"), file="missing.bvh")


def test_contacts_and_phase_are_found_from_the_motion():
    known = make_annotated(frames=240)
    annotated = annotate(known.clip, "zombie")
    assert annotated.phase is not None and known.phase is not None and annotated.note == ""
    labelled = np.isfinite(annotated.phase)
    assert labelled.mean() > 0.8
    off = np.angle(np.exp(1j * (annotated.phase - known.phase)))[labelled]
    assert np.median(np.abs(off - np.median(off))) < LABELLED
    (name, bars), (other, _) = annotated.foot_bars()
    assert (name, other) == ("left", "right") and 2 <= len(bars) <= 6


def test_standing_has_contacts_and_a_note_instead_of_a_phase():
    clip, _ = synthesise("neutral", np.zeros(90), np.zeros(90))
    still = dataclasses.replace(clip, root_positions=clip.root_positions[:1].repeat(90, 0),
                                rotations=clip.rotations[:1].repeat(90, 0))  # fmt: skip
    annotated = annotate(still, "still")
    assert (annotated.phase, annotated.note) == (None, "no steps: no phase")
    assert [runs.tolist() for _, runs in annotated.foot_bars()] == [[[0, 90]], [[0, 90]]]
    assert annotated.phase_lines() == []


def test_a_note_says_that_a_part_has_no_steps():
    speed = np.where(np.arange(360) < 180, 1.2, 0.0)
    clip, _ = synthesise("neutral", np.zeros(360), speed)
    stopping = dataclasses.replace(
        clip,
        root_positions=np.append(clip.root_positions[:180], clip.root_positions[180:181].repeat(180, 0), 0),
        rotations=np.append(clip.rotations[:180], clip.rotations[180:181].repeat(180, 0), 0),
    )
    annotated = annotate(stopping, "stops")
    assert annotated.phase is not None and np.isnan(annotated.phase[-30:]).all()
    assert annotated.note == "phase only where there are steps"
    assert annotated.cut_seconds(1.0, 1.0).note == ""
    assert annotated.cut_seconds(5.5, None).note == "no steps: no phase"
    noted = dataclasses.replace(annotated, note="mine")
    assert noted.cut_seconds(1.0, 1.0).note == "mine"
    local = dataclasses.replace(noted, phase=np.ones((360, 4, 2)))
    assert local.cut_seconds(1.0, 1.0).note == "mine"


def test_local_phases_become_four_lines_weighted_by_their_length():
    vectors = np.zeros((120, 4, 2))
    angle = np.linspace(0, 6, 120)
    vectors[:, 1] = 0.5 * np.stack([np.sin(angle), np.cos(angle)], -1)
    vectors[:, 3] = 2 * vectors[:, 1]
    lines = AnnotatedClip("x", make_annotated().clip, phase=vectors).phase_lines()
    assert [line.name for line in lines] == ["left hand", "right hand", "left toe", "right toe"]
    np.testing.assert_allclose(lines[1].angle, angle, atol=1e-12)
    assert lines[0].weight.max() == 0.0 and lines[1].weight[60] == pytest.approx(0.5) and lines[3].weight[60] == 1.0
    data = payload(player_html([AnnotatedClip("x", make_annotated().clip, phase=vectors)]))["clips"][0]
    assert data["phases"][1]["weight"][30] == pytest.approx(0.5)


@pytest.mark.parametrize("bones", [0, 4, 100])
def test_frames_without_local_phases_are_gaps(bones):
    vectors = np.ones((120, bones, 2))
    vectors[30:60] = np.nan
    vectors[60, :, 1] = np.inf
    annotated = AnnotatedClip("x", make_annotated().clip, phase=vectors)
    text = player_html([annotated], fps=60.0, assets=False)
    lines = payload(text)["clips"][0]["phases"]
    assert len({line["name"] for line in lines}) == len(lines) == bones
    for line in lines:
        assert [value is None for value in line["angle"]] == [30 <= t <= 60 for t in range(120)]
        assert line["weight"] is None  # all of it or none
    nowhere = AnnotatedClip("x", annotated.clip, phase=np.full((120, bones, 2), np.nan))
    assert all(line.weight.max() == 0.0 and np.isnan(line.angle).all() for line in nowhere.phase_lines())


def test_infinite_phases_are_gaps():
    annotated = make_annotated()
    (line,) = AnnotatedClip("x", annotated.clip, phase=np.where(np.arange(120) < 9, np.inf, 1.0)).phase_lines()
    assert np.isnan(line.angle[:9]).all() and (line.angle[9:] == 1.0).all() and line.weight.sum() == 111


def test_a_part_keeps_the_annotations_of_the_whole():
    annotated = make_annotated()
    part = annotated.cut_seconds(0.5, 1.0)
    assert part.clip.num_frames == 61 and part.seconds == 1.0
    assert annotated.phase is not None and part.phase is not None
    np.testing.assert_array_equal(part.phase, annotated.phase[30:91])
    assert annotated.cut_seconds(1.5, 1e300).clip.num_frames == 30
    bad = (
        (2.5, None),
        (-1.0, 1.0),
        (0.0, 0.0),
        (np.nan, 1.0),
        (np.inf, None),
        (0.0, np.nan),
        (0.0, np.inf),
        (1e307, 1),
    )
    for start, seconds in bad:
        assert_refused(partial(annotated.cut_seconds, start, seconds), place="start and seconds")


def test_captions_are_style_and_content_or_the_file():
    clip = make_annotated().clip
    nameless = dataclasses.replace(clip, style="unknown", content="", source="a/b.bvh")
    assert [shown.name for shown in annotate_clips([clip, nameless])] == ["zombie walk", "b"]
    with pytest.raises(ValueError, match="2 clips and 1 names"):
        annotate_clips([clip, clip], ["one"])


def world(clip: MotionClip) -> np.ndarray:
    """World positions [T, J, 3] of the joints."""
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def one_joint(frames: int = 40) -> MotionClip:
    """A moving point; its skeleton has neither bones nor roles."""
    skeleton = Skeleton(("It",), np.array([-1]), np.zeros((1, 3)), (), np.array([0]))
    positions = np.stack([np.linspace(0, 2, frames), np.ones(frames), np.zeros(frames)], axis=-1)
    return MotionClip(skeleton, 30.0, positions, np.tile([1.0, 0, 0, 0], (frames, 1, 1)))


@pytest.mark.parametrize("frames", [1, 2, 40])
def test_a_single_joint_plays_as_a_dot(frames):
    annotated = annotate_clips([one_joint(frames)])[0]
    assert annotated.note == "no feet known: no contacts, no phase" and annotated.name == "clip 1"
    data = payload(player_html([annotated]))
    shown = played(data)
    assert shown.positions.shape == (frames, 1, 3) and data["clips"][0]["tall"] > 0 and len(shown.mesh.faces) > 3


def test_z_up_clips_become_y_up():
    clip = make_annotated().clip
    tipped = dataclasses.replace(
        clip,
        root_positions=quat_rotate(quat_conjugate(TURNS["z"]), clip.root_positions),
        rotations=np.concatenate(
            [quat_multiply(quat_conjugate(TURNS["z"]), clip.rotations[:, :1]), clip.rotations[:, 1:]], axis=1
        ),
    )
    np.testing.assert_allclose(world(upright(tipped)), world(clip), atol=1e-12)
    assert upright(clip) is clip and upright(tipped, "y") is tipped
    assert annotate_clips([tipped])[0].phase is not None  # steps are found only in an upright clip


def test_the_ground_is_below_the_feet():
    clip = make_annotated().clip
    low = dataclasses.replace(clip, root_positions=clip.root_positions - [0.0, 0.95, 0.0])
    assert abs(make_scene(low).positions[..., 1].min()) < 0.1
    np.testing.assert_array_equal(make_scene(clip).positions, world(clip))  # feet near 0: the ground is at 0


def test_the_following_camera_does_not_lag_on_a_straight_path():
    clip, _ = synthesise("neutral", np.zeros(240), np.full(240, 1.2))
    scene = make_scene(clip)
    assert np.abs(scene.focus[:, [0, 2]] - scene.positions[:, 0][:, [0, 2]]).max() < 0.06  # the hips' own sway
    half = make_scene(resample(clip, 30.0))
    assert np.abs(half.focus - scene.focus[::2]).max() < 0.02
