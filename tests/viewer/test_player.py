"""Players carry the motion exactly, stay small and safe, and know what is under the feet."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.kinematics import quat_conjugate, quat_multiply, quat_rotate
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.synthetic.walks import synthesise, synthetic_skeleton
from pfnn_jax.viewer.draw.annotated_clip import (
    AnnotatedClip,
    annotate,
    annotate_clips,
    cut_seconds,
    foot_bars,
    phase_lines,
)
from pfnn_jax.viewer.draw.body import Z_TO_Y, body_capsules, body_points, capsule_ends, upright
from pfnn_jax.viewer.draw.palette import SIDES
from pfnn_jax.viewer.draw.scene import make_scene
from pfnn_jax.viewer.player import player
from pfnn_jax.viewer.player.player import player_html, player_page
from tests.viewer.pages import captions, check_page, decoded, make_annotated, payload

QUANTUM = 0.00051  # metres: half a millimetre of rounding
KILOBYTE = 1000
LABELLED = 0.2  # radians: the labeller times contacts to a frame or two


def test_player_carries_the_capsules_of_the_motion():
    annotated = make_annotated()
    data = payload(player_html([annotated], fps=30.0))["clips"][0]
    points, capsules = body_points(annotated.clip)[::2], body_capsules(annotated.clip.skeleton)
    shown = decoded(data)
    assert data["fps"] == 30.0 and len(shown) == len(points) == len(data["phases"][0]["angle"])
    assert len(data["capsules"]) == len(capsules)
    for capsule, (start, end, first, second, side, *_) in zip(capsules, data["capsules"], strict=True):
        np.testing.assert_allclose(shown[:, start], points[:, capsule.start], atol=QUANTUM)
        np.testing.assert_allclose(shown[:, end], points[:, capsule.end], atol=QUANTUM)
        assert (first, second) == pytest.approx((capsule.start_radius, capsule.end_radius), abs=1e-4)
        assert side == capsule.side


@pytest.mark.parametrize("fps", [60.0, 30.0, 20.0])
def test_player_shows_contacts_as_runs_whatever_its_rate(fps):
    annotated = make_annotated()
    data = payload(player_html([annotated], fps=fps))["clips"][0]
    assert annotated.contacts is not None
    for foot, runs in enumerate(data["contacts"]):
        stands = np.zeros(annotated.clip.num_frames, bool)
        for first, past in runs:
            stands[round(first * 60 / fps) : round(past * 60 / fps)] = True
        np.testing.assert_array_equal(stands, annotated.contacts[:, 2 * foot : 2 * foot + 2].any(axis=1))


def test_a_second_takes_eight_kilobytes_and_scenes_of_a_kilometre_still_fit():
    annotated = make_annotated(frames=1200)
    assert len(player_html([annotated], fps=30.0, assets=False)) < 20 * 8 * KILOBYTE
    far = synthesise("neutral", np.zeros(600), np.full(600, 100.0))[0]
    data = payload(player_html([AnnotatedClip("fast", far)]))["clips"][0]
    for values, true in ((decoded(data)[:, 0], body_points(far)[::2, 0]), (decoded(data, "focus")[:, 0, :1], 0.0)):
        np.testing.assert_allclose(values, np.broadcast_to(true, values.shape), atol=1000 / 32767)


def test_pages_refuse_to_grow_without_end(monkeypatch):
    monkeypatch.setattr(player, "MOST", 10 * KILOBYTE)
    with pytest.raises(InputError, match=r"player: 0 MB for 2 s of motion; a page holds 0 MB: show fewer seconds"):
        player_html([make_annotated()])


def test_players_are_balanced_and_names_cannot_break_out():
    name = "</script><script>alert(1)</script>"
    page = player_page([make_annotated(name), make_annotated("plain", extras=False)], title=name)
    check_page(page.removeprefix("<!doctype html>"))
    assert name not in page
    assert captions(page) == [name, "plain"]
    assert page.count('class="scene"') == 2 and page.count('class="strip"') == 1


def test_players_refuse_nothing_and_mismatched_lengths():
    with pytest.raises(ValueError, match="at least one"):
        player_html([])
    annotated = make_annotated()
    with pytest.raises(ValueError, match="phase of 'x' has 3 frames, its clip 120"):
        AnnotatedClip("x", annotated.clip, phase=np.zeros(3))
    with pytest.raises(ValueError, match=r"phase of 'x' is \[120, 3\]"):
        AnnotatedClip("x", annotated.clip, phase=np.zeros((120, 3)))
    with pytest.raises(ValueError, match=r"contacts of 'x' are \[120, 3\]"):
        AnnotatedClip("x", annotated.clip, contacts=np.zeros((120, 3), bool))


def test_the_script_is_one_function_and_the_colours_are_those_of_pictures():
    assets = player.player_assets()
    found = re.fullmatch(r"<style>(.*)</style><script>(.*)</script>", assets, re.DOTALL)
    assert found is not None
    style, script = found.groups()
    assert script.startswith("(() => {") and script.endswith("})();")
    assert [script.count(f"class {name} {{") for name in ("Scene", "Strip", "Player")] == [1, 1, 1]
    bright, dark = re.findall(r"\.motion-player { (--player-[^}]*) }", style)
    for side, colour in SIDES.items():
        assert f"--player-{side}: {colour};" in bright and f"--player-{side}: #" in dark
    used = set(re.findall(r"var\((--player-\w+)\)", style))
    assert used <= set(re.findall(r"(--player-\w+):", bright)) == set(re.findall(r"(--player-\w+):", dark))


def test_what_cannot_be_shown_is_refused_by_name():
    clip = dataclasses.replace(make_annotated().clip, source="a.bvh")
    empty = dataclasses.replace(clip, root_positions=clip.root_positions[:0], rotations=clip.rotations[:0])
    away, turned = clip.root_positions.copy(), clip.rotations.copy()
    away[7, 1], turned[9, 3] = np.inf, np.nan
    bad = {
        "frames: 0; a clip that is shown has at least one": empty,
        "frame 7: root positions not finite": dataclasses.replace(clip, root_positions=away),
        "frame 9: rotations not finite": dataclasses.replace(clip, rotations=turned),
        "frame rate: nan; frames per second must be positive": dataclasses.replace(clip, fps=np.nan),
    }
    for message, shown in bad.items():
        for make in (lambda c: AnnotatedClip("x", c), lambda c: annotate(c, "x"), lambda c: annotate_clips([c])):
            with pytest.raises(InputError, match=f"^a.bvh: {message}"):
                make(shown)


def test_labels_are_those_of_the_motion():
    known = make_annotated(frames=240)
    annotated = annotate(known.clip, "zombie")
    assert annotated.phase is not None and known.phase is not None and annotated.note == ""
    labelled = np.isfinite(annotated.phase)
    assert labelled.mean() > 0.8
    off = np.angle(np.exp(1j * (annotated.phase - known.phase)))[labelled]
    assert np.median(np.abs(off - np.median(off))) < LABELLED
    (name, bars), (other, _) = foot_bars(annotated)
    assert (name, other) == ("left", "right") and 2 <= len(bars) <= 6


def test_standing_has_contacts_and_no_phase_and_says_so():
    clip, _ = synthesise("neutral", np.zeros(90), np.zeros(90))
    still = dataclasses.replace(clip, root_positions=clip.root_positions[:1].repeat(90, 0),
                                rotations=clip.rotations[:1].repeat(90, 0))  # fmt: skip
    annotated = annotate(still, "still")
    assert (annotated.phase, annotated.note) == (None, "no steps: no phase")
    assert [runs.tolist() for _, runs in foot_bars(annotated)] == [[[0, 90]], [[0, 90]]]
    assert phase_lines(annotated) == []


def test_where_steps_are_found_for_a_part_only_the_note_says_so():
    speed = np.where(np.arange(360) < 180, 1.2, 0.0)
    clip, _ = synthesise("neutral", np.zeros(360), speed)
    stands = dataclasses.replace(
        clip,
        root_positions=np.append(clip.root_positions[:180], clip.root_positions[180:181].repeat(180, 0), 0),
        rotations=np.append(clip.rotations[:180], clip.rotations[180:181].repeat(180, 0), 0),
    )
    annotated = annotate(stands, "stops")
    assert annotated.phase is not None and np.isnan(annotated.phase[-30:]).all()
    assert annotated.note == "phase only where there are steps"
    assert cut_seconds(annotated, 1.0, 1.0).note == ""
    assert cut_seconds(annotated, 5.5, None).note == "no steps: no phase"
    told = dataclasses.replace(annotated, note="mine")
    assert cut_seconds(told, 1.0, 1.0).note == "mine"
    local = dataclasses.replace(told, phase=np.ones((360, 4, 2)))
    assert cut_seconds(local, 1.0, 1.0).note == "mine"


def test_local_phases_become_four_lines_as_strong_as_their_vectors():
    vectors = np.zeros((120, 4, 2))
    angle = np.linspace(0, 6, 120)
    vectors[:, 1] = 0.5 * np.stack([np.sin(angle), np.cos(angle)], -1)
    vectors[:, 3] = 2 * vectors[:, 1]
    lines = phase_lines(AnnotatedClip("x", make_annotated().clip, phase=vectors))
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
    assert len({line["name"] for line in lines}) == len(lines) == bones and "NaN" not in text
    for line in lines:
        assert [value is None for value in line["angle"]] == [30 <= t <= 60 for t in range(120)]
        assert line["weight"] is None  # all of it or none
    nowhere = AnnotatedClip("x", annotated.clip, phase=np.full((120, bones, 2), np.nan))
    assert all(line.weight.max() == 0.0 and np.isnan(line.angle).all() for line in phase_lines(nowhere))


def test_a_phase_that_is_not_finite_is_none():
    annotated = make_annotated()
    (line,) = phase_lines(AnnotatedClip("x", annotated.clip, phase=np.where(np.arange(120) < 9, np.inf, 1.0)))
    assert np.isnan(line.angle[:9]).all() and (line.angle[9:] == 1.0).all() and line.weight.sum() == 111


def test_a_part_keeps_the_labels_of_the_whole():
    annotated = make_annotated()
    part = cut_seconds(annotated, 0.5, 1.0)
    assert part.clip.num_frames == 61 and part.seconds == 1.0
    assert annotated.phase is not None and part.phase is not None
    np.testing.assert_array_equal(part.phase, annotated.phase[30:91])
    assert cut_seconds(annotated, 1.5, 1e300).clip.num_frames == 30
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
        with pytest.raises(InputError, match="start and seconds: .*; what is shown lies in the clip's 2.0 seconds"):
            cut_seconds(annotated, start, seconds)


def test_names_are_style_and_content_or_the_file():
    clip = make_annotated().clip
    nameless = dataclasses.replace(clip, style="unknown", content="", source="a/b.bvh")
    assert [annotated.name for annotated in annotate_clips([clip, nameless])] == ["zombie walk", "b"]
    with pytest.raises(ValueError, match="2 clips and 1 names"):
        annotate_clips([clip, clip], ["one"])


def test_body_of_the_walker_is_symmetric_and_bodies_without_roles_are_equally_thin():
    skeleton = synthetic_skeleton()
    capsules = {(c.start, c.end): c for c in body_capsules(skeleton)}
    mirrored = [c for c in capsules.values() if c.end < skeleton.num_joints and c.side == "left"]
    assert mirrored
    for capsule in mirrored:
        other = capsules[(int(skeleton.mirror[capsule.start]), int(skeleton.mirror[capsule.end]))]
        assert (other.start_radius, other.side) == (capsule.start_radius, "right")
    bare = dataclasses.replace(skeleton, roles=None)
    (radius,) = {c.start_radius for c in body_capsules(bare)}
    assert 0.02 < radius < 0.04
    small = dataclasses.replace(bare, offsets=bare.offsets / 100, end_sites=())
    assert all(c.start_radius < radius / 90 for c in body_capsules(small))


def test_capsule_ends_lie_on_the_bone():
    annotated = make_annotated()
    head = next(c for c in body_capsules(annotated.clip.skeleton) if c.span != (0.0, 1.0))
    points = body_points(annotated.clip)
    a, b = capsule_ends(points, head)
    bone = points[:, head.end] - points[:, head.start]
    np.testing.assert_allclose(b - a, (head.span[1] - head.span[0]) * bone, atol=1e-12)


def test_a_head_without_a_crown_sits_in_line_with_the_neck():
    skeleton = synthetic_skeleton()
    assert skeleton.roles is not None
    head = skeleton.roles.head
    bald = dataclasses.replace(skeleton, end_sites=tuple(site for site in skeleton.end_sites if site[0] != head))
    capsule = body_capsules(bald)[-1]
    assert (capsule.end, capsule.side) == (head, "middle")
    assert capsule.span[1] > capsule.span[0] > 1.0  # beyond the head joint


def one_joint(frames: int = 40) -> MotionClip:
    """A point on its way; its skeleton has neither bones nor roles."""
    skeleton = Skeleton(("It",), np.array([-1]), np.zeros((1, 3)), (), np.array([0]))
    positions = np.stack([np.linspace(0, 2, frames), np.ones(frames), np.zeros(frames)], axis=-1)
    return MotionClip(skeleton, 30.0, positions, np.tile([1.0, 0, 0, 0], (frames, 1, 1)))


@pytest.mark.parametrize("frames", [1, 2, 40])
def test_a_single_joint_plays_as_a_dot(frames):
    annotated = annotate_clips([one_joint(frames)])[0]
    assert annotated.note == "no feet known: no contacts, no phase" and annotated.name == "clip 1"
    data = payload(player_html([annotated]))["clips"][0]
    assert decoded(data).shape == (frames, 1, 3) and data["tall"] > 0 and len(data["capsules"]) == 1


def test_z_up_becomes_y_up_and_y_up_stays():
    clip = make_annotated().clip
    tipped = dataclasses.replace(
        clip,
        root_positions=quat_rotate(quat_conjugate(Z_TO_Y), clip.root_positions),
        rotations=np.concatenate(
            [quat_multiply(quat_conjugate(Z_TO_Y), clip.rotations[:, :1]), clip.rotations[:, 1:]], axis=1
        ),
    )
    np.testing.assert_allclose(body_points(upright(tipped)), body_points(clip), atol=1e-12)
    assert upright(clip) is clip and upright(tipped, "y") is tipped
    assert annotate_clips([tipped])[0].phase is not None  # steps are found once it stands


def test_the_ground_is_where_the_feet_are():
    clip = make_annotated().clip
    low = dataclasses.replace(clip, root_positions=clip.root_positions - [0.0, 0.95, 0.0])
    assert abs(make_scene(low).points[..., 1].min()) < 0.05
    np.testing.assert_array_equal(make_scene(clip).points, body_points(clip))  # a file that means 0 keeps it


def test_a_camera_that_follows_does_not_lag_on_a_straight_way():
    clip, _ = synthesise("neutral", np.zeros(240), np.full(240, 1.2))
    scene = make_scene(clip)
    assert np.abs(scene.focus[:, [0, 2]] - scene.points[:, 0][:, [0, 2]]).max() < 0.06  # the hips' own sway
    half = make_scene(resample(clip, 30.0))
    assert np.abs(half.focus - scene.focus[::2]).max() < 0.02
