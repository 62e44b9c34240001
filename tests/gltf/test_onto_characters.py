"""Laws of motion written onto rigged characters, on twenty that people use; `test_writing.py` needs no files."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfnn_jax.motion.clip import MotionClip, cut, resample
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.gltf.character import Character, read_character
from pfnn_jax.motion.gltf.write import character_bytes
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.root_motion import in_place
from pfnn_jax.motion.skeleton import need_roles
from pfnn_jax.motion.synthetic.walks import synthesise

NAMES = (
    "cesiumman", "derived_noname", "godot_platformer", "kaykit_mage", "kaykit_manny", "metarig_hackmit",
    "metarig_malebase", "mixamo_hunter", "mixamo_toram", "quaternius_adventurer", "quaternius_platformer",
    "quaternius_robotexpressive", "rigify_lumberjack", "rigify_mannyquin", "sketchbook_boxman", "ue_mannequin_f",
    "ue_mannequiny", "vrm0_cryptovoxels", "vrm0_godette", "vrm1_example",
)  # fmt: skip
FOOTLESS = ("metarig_hackmit", "sketchbook_boxman")
FPS = 30.0
FLOOR = 0.01  # metres below the place of a standing foot
SLIDE, STILL = 1.2, 0.03  # times as far as in the source, and leg lengths per second that no eye sees
FIGURES = {"cesiumman": 0.06, "quaternius_platformer": 0.07, "rigify_lumberjack": 0.05}
"""STILL of figures whose toe lies steeply under the ankle, or whose hips are wider than their legs are long."""
BACKWARDS = -1.0  # degrees that a knee may bend backwards where the leg is straight
IN_THREE = 1e-3  # metres of a body of 1.7 m, as keys are float32 and players interpolate them
READ_BACK = 1e-4  # metres, and of a distance: float32 keys
EXACT = 1e-9  # metres
KNEES = 0.01  # metres that a knee may move whose leg is quite straight: legs keep a last bit of bend


@dataclass
class Written:
    """A character with three clips on it.

    Attributes:
        character: as read.
        moved: the clips on its skeleton, with travel.
        in_place, travelling: files with the clips in place, and with root motion.
    """

    character: Character
    moved: dict[str, MotionClip]
    in_place: Path
    travelling: Path


@pytest.fixture(scope="module")
def clips(mocap) -> dict[str, MotionClip]:
    """A straight walk and a circle of procedural walkers, and a person who walks to the side by up to 48°."""
    frames = np.zeros(90)
    strafe = read_clip(mocap / "bandai-namco-1" / "dataset-1_walk-left_tired_001.bvh")
    return {
        "our walk": resample(synthesise("neutral", frames, frames + 1.2)[0], FPS),
        "our circle": resample(synthesise("proud", frames + 0.8, frames + 1.2)[0], FPS),
        "our strafe": resample(cut(strafe, 0, int(2.5 * strafe.fps)), FPS),
    }


@pytest.fixture(scope="module")
def written(characters, clips, tmp_path_factory) -> dict[str, Written]:
    """Every character with every clip."""
    folder, found = tmp_path_factory.mktemp("characters"), {}
    for name in NAMES:
        character = read_character(characters / f"{name}.glb")
        moved = {title: retarget(clip, character.skeleton).clip for title, clip in clips.items()}
        paths = folder / f"{name}.glb", folder / f"{name}_travels.glb"
        for path, travels in zip(paths, (False, True), strict=True):
            path.write_bytes(character_bytes(character, moved, root_motion=travels))
        found[name] = Written(character, moved, *paths)
    return found


def every(written: dict[str, Written]) -> Iterator[tuple[str, Written, str, MotionClip]]:
    """Yields name, character, title and clip on it of all that were written."""
    for name, each in written.items():
        for title, clip in each.moved.items():
            yield name, each, title, clip


def chunks(path: Path) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON and the binary chunk of a GLB file."""
    raw = path.read_bytes()
    (size,) = struct.unpack_from("<I", raw, 12)
    return json.loads(raw[20 : 20 + size]), raw[20 + size + 8 :]


def seen_joints(body: HumanoidMap) -> list[int]:
    """Returns hips, head, hands, feet and toes, as far as a body has them."""
    sides = [getattr(body, f"{side}_{part}") for side in ("left", "right") for part in ("hand", "foot", "toe", "shin")]
    return [joint for joint in (body.hips, body.head, *sides) if joint is not None]


def test_no_file_has_an_error_that_it_had_not_before(characters, written, validate):
    before = validate([characters / f"{name}.glb" for name in NAMES])
    after = validate([each.in_place for each in written.values()])  # the others differ in values only
    for name, each in written.items():
        assert after[each.in_place] <= before[characters / f"{name}.glb"], name


def test_what_the_file_held_stays_as_it_was(characters, written):
    for name, each in written.items():
        old, old_binary = chunks(characters / f"{name}.glb")
        new, binary = chunks(each.in_place)
        length = old["buffers"][0]["byteLength"]
        assert binary[:length] == old_binary[:length], name
        new["buffers"][0]["byteLength"] = length
        for key in ("animations", "accessors", "bufferViews"):
            new[key] = new[key][: len(old.get(key, []))]
            if key not in old:
                assert new.pop(key) == []
        for number, node in enumerate(old["nodes"]):
            if "matrix" in node and "matrix" not in new["nodes"][number]:  # animated nodes may not have one
                kept = {key: value for key, value in new["nodes"][number].items() if key in node}
                new["nodes"][number] = {**kept, "matrix": node["matrix"]}
                assert kept.keys() | {"matrix"} == node.keys()
        assert new == old, name
        assert [*new] == [*old], name


def test_keys_obey_the_rules_of_engines(written):
    for name, each in written.items():
        data, binary = chunks(each.in_place)
        for animation in data["animations"][-len(each.moved) :]:
            times = {sampler["input"] for sampler in animation["samplers"]}
            assert len(times) == 1, name
            keys = values_of(data, binary, times.pop())
            assert keys[0] == 0 and np.all(np.diff(keys[:, 0]) > 0)
            assert {sampler["interpolation"] for sampler in animation["samplers"]} == {"LINEAR"}
            for channel in animation["channels"]:
                values = values_of(data, binary, animation["samplers"][channel["sampler"]]["output"])
                assert channel["target"]["path"] in ("rotation", "translation")
                if channel["target"]["path"] == "rotation":
                    np.testing.assert_allclose(np.linalg.norm(values, axis=-1), 1.0, atol=1e-6)
                    assert np.all(np.sum(values[1:] * values[:-1], axis=-1) > 0), name


def values_of(data: dict[str, Any], binary: bytes, number: int) -> np.ndarray:
    """Returns the values [T, n] of an accessor of float32 that we wrote."""
    accessor = data["accessors"][number]
    size = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = data["bufferViews"][accessor["bufferView"]]["byteOffset"] + accessor["byteOffset"]
    return np.frombuffer(binary, "<f4", accessor["count"] * size, start).reshape(-1, size)


def test_three_js_puts_joints_where_our_kinematics_do(written, three):
    for name, each in written.items():
        joints, place = seen_joints(need_humanoid(each.character.skeleton)), each.character.placement
        frames = np.linspace(0, each.moved["our walk"].num_frames - 1, 10).astype(int)
        for path, travels in ((each.in_place, False), (each.travelling, True)):
            times = dict.fromkeys(each.moved, frames / FPS)
            for title, found in three.sample(path, times, each.character.nodes[joints]).items():
                clip = each.moved[title] if travels else in_place(each.moved[title])
                ours = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0][frames]
                message = f"{name}: {title}"
                np.testing.assert_allclose(place.to_ours(found), ours[:, joints], atol=IN_THREE, err_msg=message)


@pytest.mark.parametrize("name", NAMES)
def test_reading_what_was_written_gives_the_same_clip(written, name):
    each = written[name]
    for title, clip in each.moved.items():
        again = read_clip(each.travelling, clip_name=title, travel="keep")
        assert again.fps == pytest.approx(FPS) and again.num_frames == clip.num_frames
        joints = seen_joints(need_humanoid(clip.skeleton))
        ours = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0][:, joints]
        places = forward_kinematics(again.skeleton, again.root_positions, again.rotations)[0]
        found = places[:, [again.skeleton.names.index(clip.skeleton.names[joint]) for joint in joints]]
        # a clip that is read faces as it was recorded, and stands where the file says
        np.testing.assert_allclose(distances(found), distances(ours), READ_BACK, READ_BACK, err_msg=title)


def distances(points: np.ndarray) -> np.ndarray:
    """Returns the distances of points [T, n, 3] to the first one and to where that was at the beginning."""
    return np.concatenate(
        [np.linalg.norm(points - points[:, :1], axis=-1), np.linalg.norm(points - points[:1, :1], axis=-1)], axis=1
    )


def test_feet_stay_above_the_floor_and_knees_never_bend_backwards(written):
    for name, _, title, clip in every(written):
        if name in FOOTLESS:
            continue
        body = need_humanoid(clip.skeleton)
        heights = clip.skeleton.resting_heights
        assert heights is not None
        places = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]
        for side, row in zip(("left", "right"), heights, strict=True):
            thigh, shin, foot, toe = (getattr(body, f"{side}_{part}") for part in ("thigh", "shin", "foot", "toe"))
            for joint, height in zip((foot, foot if toe is None else toe), row, strict=True):
                assert places[:, joint, 1].min() > height - FLOOR, f"{name}: {title}"
            left = places[:, body.left_thigh] - places[:, body.right_thigh]
            assert knee_bend(places, left, thigh, shin, foot).min() > BACKWARDS, f"{name}: {title}"


def knee_bend(places: np.ndarray, left: np.ndarray, thigh: int, shin: int, foot: int) -> np.ndarray:
    """Returns the angle [T] of a knee in degrees, positive where it is bent as knees bend."""
    upper, lower = places[:, shin] - places[:, thigh], places[:, foot] - places[:, shin]
    hinge = left - (np.sum(left * upper, axis=-1) / np.sum(upper**2, axis=-1))[:, None] * upper
    hinge = hinge / np.linalg.norm(hinge, axis=-1, keepdims=True)
    across = np.sum(np.cross(upper, lower) * hinge, axis=-1)
    return np.degrees(np.arctan2(across, np.sum(upper * lower, axis=-1)))


def test_standing_feet_slide_no_more_than_the_sources(written, clips):
    for name, _, title, clip in every(written):
        if name not in FOOTLESS:
            own, there = slides(clips[title], clip)
            assert there < SLIDE * own + FIGURES.get(name, STILL), f"{name}: {title}"


def slides(source: MotionClip, clip: MotionClip) -> tuple[float, float]:
    """Returns the mean speed in leg lengths per second of the part on which each foot of the source stands, in both.

    That is its heel or its toe, whichever moves less while it is in contact; the heel where the target has no toe.
    """
    has_toe, speeds = need_humanoid(clip.skeleton).left_toe is not None, []
    for motion in (source, clip):
        body = need_humanoid(motion.skeleton)
        feet = [getattr(body, f"{side}_{part}") for side in ("left", "right") for part in ("foot", "toe")]
        feet = feet if has_toe else [feet[0], feet[0], feet[2], feet[2]]
        places = forward_kinematics(motion.skeleton, motion.root_positions, motion.rotations)[0][:, feet]
        leg = leg_length_of(motion.skeleton, body)
        speed = np.linalg.norm(np.diff(places[..., [0, 2]], axis=0), axis=-1) * motion.fps / leg
        speeds.append(speed.reshape(-1, 2, 2))
    places = forward_kinematics(source.skeleton, source.root_positions, source.rotations)[0]
    contact = foot_contacts(places, need_roles(source.skeleton), source.fps)
    contact = (contact[1:] & contact[:-1]).reshape(-1, 2, 2)
    contact = contact if has_toe else contact & contact[..., :1]
    part = np.argmin(np.where(contact, speeds[0], np.inf), axis=-1)[..., None]
    stands = np.take_along_axis(contact, part, axis=-1)
    own, there = (float(np.take_along_axis(speed, part, axis=-1)[stands].mean()) for speed in speeds)
    return own, there


@pytest.mark.parametrize("shortcut", [True, False])
def test_the_bind_pose_put_onto_itself_changes_nothing(written, monkeypatch, shortcut):
    if not shortcut:
        monkeypatch.setattr("pfnn_jax.motion.retargeting.retarget.same_bones", lambda *skeletons: False)
    for name, each in written.items():
        if name in FOOTLESS and not shortcut:
            continue
        skeleton = each.character.skeleton
        still = np.tile([1.0, 0.0, 0.0, 0.0], (3, skeleton.num_joints, 1))
        clip = MotionClip(skeleton, FPS, np.tile(each.character.bind_positions[0], (3, 1)), still)
        again = retarget(clip, skeleton).clip
        found = forward_kinematics(skeleton, again.root_positions, again.rotations)[0]
        places = np.broadcast_to(each.character.bind_positions, found.shape)
        np.testing.assert_allclose(found, places, atol=EXACT if shortcut else KNEES, err_msg=name)
