"""Faults of the kinds that real files have, made on purpose in the ways in which other producers make them."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pfnn_jax.motion.bvh import read_bvh, read_skeleton, write_bvh
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_from_euler,
    quat_from_yaw,
    quat_multiply,
    quat_slerp,
)
from pfnn_jax.motion.length_unit import UNITS
from pfnn_jax.motion.skeleton import Roles, Skeleton, need_roles
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.motion.up_axis import TURNS
from pfnn_jax.motion.world_motion import world_motion
from tests.motion.retargeting import moved, with_rest
from tests.motion.skeletons import tipped
from tests.raising import assert_refused

FRAMES, FPS = 240, 60.0
WRITTEN = 1e-5  # metres: files hold 6 decimals of degrees and of centimetres
TRAVEL = 0.08  # share of a walk's length by which rebuilt travel may differ: feet roll from heel to toe
WALK = synthesise("neutral", np.zeros(FRAMES), np.full(FRAMES, 1.2), fps=FPS)[0]
SIX = "Xposition Yposition Zposition Zrotation Yrotation Xrotation"

Change = Callable[[str], str]


@pytest.fixture(scope="module")
def walk_text(tmp_path_factory) -> str:
    return text_of(WALK, tmp_path_factory.mktemp("walk"))


def text_of(clip: MotionClip, folder: Path) -> str:
    path = folder / "clip.bvh"
    write_bvh(path, clip, overwrite=True)
    return path.read_text()


def saved(folder: Path, text: str | bytes) -> Path:
    path = folder / "made.bvh"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def read_clip(folder: Path, clip: MotionClip, **options) -> MotionClip:
    return read_bvh(saved(folder, text_of(clip, folder)), **options)


def rows_of(text: str) -> tuple[str, np.ndarray]:
    """The text up to the rows, and the rows."""
    head, _, numbers = text.partition(re.findall(r"Frame Time: \S+\n", text)[0])
    return text[: len(text) - len(numbers)], np.array([line.split() for line in numbers.split("\n") if line], float)


def with_rows(change: Callable[[np.ndarray], np.ndarray], form: str = "{!r}") -> Change:
    """A change of the rows of numbers; `Frames:` counts them."""

    def changed(text: str) -> str:
        head, rows = rows_of(text)
        rows = change(rows)
        lines = [" ".join(form.format(float(value)) for value in row) for row in rows]
        return re.sub(r"Frames: \d+", f"Frames: {len(rows)}", head) + "\n".join(lines) + "\n"

    return changed


def renamed(change: Callable[[str], str]) -> Change:
    return lambda text: re.sub(r"(ROOT|JOINT) (.+)", lambda found: f"{found[1]} {change(found[2])}", text)


def halves(hierarchy: Callable[[str], str], motion: Callable[[str], str]) -> Change:
    def changed(text: str) -> str:
        head, tail = text.split("MOTION")
        return hierarchy(head) + motion("MOTION" + tail)

    return changed


def commas(text: str) -> str:
    return re.sub(r"(\d)\.(\d)", r"\1,\2", text)


def comma_separated(text: str) -> str:
    head, rows = rows_of(text)
    return head + "\n".join(", ".join(map(repr, row)) for row in rows.tolist()) + "\n"


def sided(form: str) -> Callable[[str], str]:
    """Names with the side behind the part, such as `Arm.L`."""
    return lambda name: re.sub(r"^(Left|Right)(.*)", lambda found: form.format(found[2], found[1][0]), name)


def spaced(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)


def assert_same(clip: MotionClip, notes: int = 0) -> None:
    """Asserts that a clip is the walk, whatever its joints are called."""
    assert (clip.num_frames, clip.fps, len(clip.notes)) == (FRAMES, FPS, notes), clip.notes
    assert need_roles(clip.skeleton) == WALK.skeleton.roles
    np.testing.assert_array_equal(clip.skeleton.mirror, WALK.skeleton.mirror)
    np.testing.assert_allclose(world_motion(clip).positions, world_motion(WALK).positions, atol=WRITTEN)


def assert_like(clip: MotionClip, joints: Callable[[Roles], list[int]]) -> None:
    """Asserts that some joints move as in the walk, on a skeleton with more or fewer joints."""
    ours, theirs = joints(need_roles(clip.skeleton)), joints(need_roles(WALK.skeleton))
    found, wanted = world_motion(clip).positions[:, ours], world_motion(WALK).positions[:, theirs]
    np.testing.assert_allclose(found, wanted, atol=WRITTEN)


def head_above_feet(clip: MotionClip) -> float:
    """Median height in metres of the head above the ankles."""
    body = need_humanoid(clip.skeleton)
    assert body.head is not None and body.left_foot is not None and body.right_foot is not None
    heights = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0][..., 1]
    return float(np.median(heights[:, body.head] - (heights[:, body.left_foot] + heights[:, body.right_foot]) / 2))


def limbs(roles: Roles) -> list[int]:
    ends = [roles.left_foot[0], roles.right_foot[0], roles.left_hand, roles.right_hand, roles.head]
    return [roles.hips, roles.left_hip, roles.right_hip, roles.left_shoulder, roles.right_shoulder, *ends]


# text

SAME_TEXT: dict[str, Callable[[str], str | bytes]] = {
    "tabs": lambda text: text.replace(" ", "\t"),
    "crlf": lambda text: text.replace("\n", "\r\n"),
    "cr": lambda text: text.replace("\n", "\r"),
    "byte order mark": lambda text: "\ufeff" + text,
    "utf-16": lambda text: text.encode("utf-16"),
    "blank lines at the end": lambda text: text + "\n\n   \n\t\n",
    "end of a file on old systems": lambda text: text + "\x1a",
    "padded with zero bytes": lambda text: text + "\0" * 64,
    "blank lines at the start": lambda text: "\n\n  " + text,
    "lower case": halves(str.lower, str.lower),
    "upper case": halves(str.upper, str.upper),
    "brace behind the name": lambda text: re.sub(r"\n\s*\{", " {", text),
    "brace at the name": lambda text: re.sub(r"\n\s*\{", "{", text),
    "no space behind colons": lambda text: text.replace("Frames: ", "Frames:").replace("Time: ", "Time:"),
    "space before colons": lambda text: text.replace("Frames:", "Frames :").replace("Time:", "Time :"),
    "both counts in one line": lambda text: text.replace("\nFrame Time", " Frame Time"),
    "no end sites": lambda text: re.sub(r"End Site\s*\{[^}]*\}", "", text),
    "end sites of length zero": lambda text: re.sub(r"(End Site\s*\{\s*OFFSET)[^}]*", r"\1 0 0 0\n", text),
    "end sites with names": lambda text: text.replace("End Site", "End Site tip_end"),
    "decimal commas": halves(commas, commas),
    "decimal commas in the motion": halves(str, commas),
    "comma separated": comma_separated,
    "exponents": with_rows(lambda rows: rows, "{:.8e}"),
    "exponents in upper case": with_rows(lambda rows: rows, "{:.8E}"),
    "signs": with_rows(lambda rows: rows, "{:+.8f}"),
    "angles beyond a turn": with_rows(
        lambda rows: rows + 360 * np.random.default_rng(0).integers(-2, 3, rows.shape) * (np.arange(66) > 2)
    ),
    "another order of positions": lambda text: with_rows(lambda rows: rows[:, [2, 0, 1, *range(3, rows.shape[1])]])(
        text.replace("Xposition Yposition Zposition", "Zposition Xposition Yposition")
    ),
    "rotations before positions": lambda text: with_rows(
        lambda rows: rows[:, [3, 4, 5, 0, 1, 2, *range(6, rows.shape[1])]]
    )(text.replace(SIX, "Zrotation Yrotation Xrotation Xposition Yposition Zposition")),
    "exponent in the frame time": lambda text: re.sub(r"Time: \S+", "Time: 1.6666667e-02", text),
    "no digit before the point": lambda text: re.sub(r"Time: \S+", "Time: .016667", text),
}
NAMES: dict[str, Callable[[str], str]] = {
    "spaces": spaced,
    "prefix with spaces": lambda name: "Bip01 " + spaced(name),
    "two namespaces": lambda name: "hero:rig:" + name,
    "path": lambda name: "Armature|mixamorig:" + name,
    "brackets": lambda name: f"{name} (1)",
    "square brackets": lambda name: f"[{name}]",
    "quotes": lambda name: f'"{name}"',
    "dots": sided("{}.{}"),
    "underscores": sided("{}_{}"),
    "accents": lambda name: name + "é",
    "other script": lambda name: "骨_" + name,
    "counter": lambda name: f"{name}_{WALK.skeleton.names.index(name):02d}",
}


@pytest.mark.parametrize("kind", SAME_TEXT)
def test_the_same_text_written_differently_is_the_same_motion(walk_text, tmp_path, kind):
    assert_same(read_bvh(saved(tmp_path, SAME_TEXT[kind](walk_text))))


@pytest.mark.parametrize("kind", NAMES)
def test_the_same_joints_called_differently_are_the_same_motion(walk_text, tmp_path, kind):
    assert_same(read_bvh(saved(tmp_path, renamed(NAMES[kind])(walk_text))))


JAPANESE = {
    "Hips": "センター",
    "Spine": "上半身",
    "Neck": "首",
    "Head": "頭",
    "Shoulder": "肩",
    "Arm": "腕",
    "ForeArm": "ひじ",
    "Hand": "手首",
    "UpLeg": "足",
    "Leg": "ひざ",
    "Foot": "足首",
    "ToeBase": "つま先",
}


def in_japanese(name: str) -> str:
    """The name of a joint of the walk in MikuMikuDance."""
    side, part = re.fullmatch(r"(Left|Right|)(.*?)", name).groups()  # type: ignore[union-attr]
    return {"Left": "左", "Right": "右", "": ""}[side] + JAPANESE.get(part, part)


@pytest.mark.parametrize("encoding", ["utf-8", "cp932", "utf-16"])
def test_japanese_names_are_read_in_any_encoding(walk_text, tmp_path, encoding):
    clip = read_bvh(saved(tmp_path, renamed(in_japanese)(walk_text).encode(encoding)))
    assert_same(clip)
    assert clip.skeleton.humanoid is not None and clip.skeleton.humanoid.confidence == 1.0
    assert clip.skeleton.names[need_roles(clip.skeleton).left_hip] == "左足"


def test_names_in_an_older_encoding_are_read(walk_text, tmp_path):
    clip = read_bvh(saved(tmp_path, walk_text.replace("ROOT Hips", "ROOT Hüfte").encode("latin-1")))
    assert_same(clip)
    assert clip.skeleton.names[0] == "Hüfte"


@pytest.mark.parametrize(
    ("change", "place", "value"),
    [
        (lambda text: text.replace("Frames: 240", "Frames: 241"), None, "240 frames"),
        (lambda text: text.replace("Frames: 240", "Frames: 0"), None, "Frames: 0"),
        (lambda text: re.sub(r"Time: \S+", "Time: 30", text), None, "Frame Time: 30"),
        (lambda text: re.sub(r"Time: \S+", "Time: 33,33", text), None, "Frame Time: 33,33"),
        (lambda text: re.sub(r"Time: \S+", "Time: 1/60", text), None, "Frame Time: 1/60"),
        (lambda text: text.replace("JOINT Head", "JOINT Neck"), None, "Neck"),
        (with_rows(lambda rows: np.where(rows == rows[7, 9], np.nan, rows)), None, "value 10 is nan"),
        (with_rows(lambda rows: np.where(rows == rows[7, 9], np.inf, rows)), None, "value 10 is inf"),
        (lambda text: text.rstrip() + " -1.#IND00\n", None, "value 67 is -1.#IND00"),
        (lambda text: text.rstrip()[:-40] + "\n", None, None),
        (lambda text: text.replace("MOTION", "ROOT Other\n{\nOFFSET 0 0 0\nCHANNELS 0\n}\nMOTION"), None, "ROOT"),
    ],
)
def test_what_has_no_clear_meaning_is_refused_in_one_line(walk_text, tmp_path, change, place, value):
    path = saved(tmp_path, change(walk_text))
    error = assert_refused(lambda: read_bvh(path), file=path, place=place, value=value)
    assert error.place.startswith("line") and "\n" not in str(error)


def test_a_row_that_is_not_counted_is_noted(walk_text, tmp_path):
    assert_same(read_bvh(saved(tmp_path, walk_text.replace("Frames: 240", "Frames: 239"))), notes=1)


@pytest.mark.parametrize(("seconds", "fps"), [("0.333333", 3.0), ("0.16667", 6.0), ("0.00166667", 600.0)])
def test_rates_that_motion_is_hardly_recorded_at_are_noted(walk_text, tmp_path, seconds, fps):
    path = saved(tmp_path, re.sub(r"Time: \S+", f"Time: {seconds}", walk_text))
    clip = read_bvh(path)
    assert clip.fps == pytest.approx(fps, rel=1e-4) and any("--source-fps" in note for note in clip.notes)
    assert_same(read_bvh(path, source_fps=60))


def test_the_speed_of_sprinters_is_noted(tmp_path):
    clip = read_clip(tmp_path, WALK, source_fps=500)  # 10 m/s
    assert any("m/s" in note and "--source-fps" in note for note in clip.notes)


def test_clips_of_one_frame_are_read(walk_text, tmp_path):
    for count in (1, 2):
        clip = read_bvh(saved(tmp_path, with_rows(lambda rows, count=count: rows[:count])(walk_text)))
        assert clip.num_frames == count and clip.skeleton.roles == WALK.skeleton.roles


def test_a_frame_that_is_written_twice_is_no_jump(walk_text, tmp_path):
    clip = read_bvh(saved(tmp_path, with_rows(lambda rows: np.vstack([rows[:1], rows]))(walk_text)))
    assert clip.num_frames == FRAMES + 1 and clip.notes == ()


# unit and axis


@pytest.mark.parametrize("unit", UNITS)
@pytest.mark.parametrize("up", ["y", "z", "-y"])
def test_unit_and_axis_are_found_together(tmp_path, unit, up):
    path = tmp_path / "clip.bvh"
    write_bvh(path, tipped(WALK, up), unit=UNITS[unit])
    clip = read_bvh(path)
    assert clip.reading is not None and (clip.reading.up, clip.reading.unit) == (up, UNITS[unit])
    assert leg_length_of(clip.skeleton, need_humanoid(clip.skeleton)) == pytest.approx(0.83, abs=0.01)


@pytest.mark.parametrize("up", TURNS)
@pytest.mark.parametrize("yaw", [0.0, np.pi / 2, 3.5])
def test_files_whose_rest_pose_stands_along_another_axis_stand_up(tmp_path, up, yaw):
    """Some exporters turn the offsets, others the root."""
    clip = moved(WALK, yaw, np.zeros(3))
    turned = tipped(clip, up)
    offsets_too = with_rest(turned, np.tile(quat_conjugate(TURNS[up]), (WALK.skeleton.num_joints, 1)))
    for each in (turned, offsets_too):
        found = read_clip(tmp_path, each)
        assert found.reading is not None and found.reading.up == up
        np.testing.assert_allclose(world_motion(found).positions, world_motion(clip).positions, atol=WRITTEN)


ARMS = ("Clavicle", "Shoulder", "Arm", "ForeArm", "Hand")


@pytest.mark.parametrize("up", TURNS)
def test_bodies_without_arms_stand_up(tmp_path, up):
    """Trackers at the hips and feet, and a headset, give no arms."""
    clip = without_joints({f"{side}{part}" for side in ("Left", "Right") for part in ARMS})
    found = read_clip(tmp_path, tipped(clip, up))
    assert found.skeleton.roles is None and found.skeleton.humanoid is not None
    assert found.reading is not None and found.reading.up == up
    np.testing.assert_allclose(world_motion(found).positions, world_motion(clip).positions, atol=WRITTEN)


@pytest.mark.parametrize("up", TURNS)
def test_a_headset_skeleton_that_lies_is_doubtful(mocap, tmp_path, up):
    clip = read_bvh(mocap / "field" / "slimevr_head_root.bvh")  # bends forward, so that no axis is clear
    found = read_clip(tmp_path, tipped(clip, up))
    heights = head_above_feet(found)
    assert heights > 0.4 * head_above_feet(clip) or any("--up" in note for note in found.notes)


@pytest.mark.parametrize("degrees", [(0, 90, 0), (90, 0, 0), (-90, 0, 90), (0, 180, 0)])
@pytest.mark.parametrize("everywhere", [False, True])
def test_an_orientation_that_is_part_of_the_hips_changes_nothing(tmp_path, degrees, everywhere):
    pose = np.tile([1.0, 0.0, 0.0, 0.0], (WALK.skeleton.num_joints, 1))
    pose[slice(None) if everywhere else 0] = quat_from_euler(np.radians(np.array(degrees, float)), "XYZ")
    assert_same(read_clip(tmp_path, with_rest(WALK, pose)))


# channels and joints


def six_channels(positions: Callable[[np.ndarray, int], np.ndarray]) -> Change:
    """Position channels on every joint: `positions` returns those of a joint [T, 3] from its OFFSET and T."""

    def changed(text: str) -> str:
        head, rows = rows_of(text)
        offsets = re.findall(r"JOINT .*\s*\{\s*OFFSET (.*)", head)
        parts = [rows[:, :6]]
        for joint, offset in enumerate(offsets):
            at = 6 + 3 * joint
            parts += [positions(np.array(offset.split(), float), len(rows)), rows[:, at : at + 3]]
        head = head.replace("CHANNELS 3 Zrotation Yrotation Xrotation", f"CHANNELS 6 {SIX}")
        return head + "\n".join(" ".join(map(repr, row)) for row in np.hstack(parts).tolist()) + "\n"

    return changed


def test_positions_on_every_joint_are_offsets(walk_text, tmp_path):
    noise = np.random.default_rng(0)
    assert_same(read_bvh(saved(tmp_path, six_channels(lambda offset, frames: np.tile(offset, (frames, 1)))(walk_text))))
    zero = six_channels(lambda _, frames: 1e-7 * noise.normal(size=(frames, 3)))
    assert_same(read_bvh(saved(tmp_path, zero(walk_text))), notes=1)
    half = six_channels(lambda _, frames: np.vstack([np.zeros((1, 3)), np.ones((frames - 1, 3))]))
    path = saved(tmp_path, half(walk_text))
    assert_refused(lambda: read_bvh(path), rule_mentions="rigid")


def with_joints(rows: list[tuple[str, str, tuple[float, float, float]]]) -> MotionClip:
    """The walk with more joints (name, parent, offset), at rest."""
    skeleton = WALK.skeleton
    names, parents, offsets = list(skeleton.names), list(skeleton.parents), list(skeleton.offsets)
    for name, parent, offset in rows:
        parents.append(names.index(parent))
        names.append(name)
        offsets.append(np.array(offset, float))
    rest = np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, len(rows), 1))
    more = Skeleton(tuple(names), np.array(parents), np.array(offsets), skeleton.end_sites, np.arange(len(names)))
    return replace(WALK, skeleton=more, rotations=np.concatenate([WALK.rotations, rest], axis=1))


def without_joints(names: set[str]) -> MotionClip:
    """The walk without some leaves."""
    skeleton = WALK.skeleton
    kept = [joint for joint in range(skeleton.num_joints) if skeleton.names[joint] not in names]
    parents = np.array([kept.index(parent) if (parent := skeleton.parents[joint]) >= 0 else -1 for joint in kept])
    called = tuple(skeleton.names[joint] for joint in kept)
    fewer = Skeleton(called, parents, skeleton.offsets[kept], (), np.arange(len(kept)))
    return replace(WALK, skeleton=fewer, rotations=WALK.rotations[:, kept])


def with_connectors(above: dict[str, str]) -> MotionClip:
    """The walk with joints at the places of others, above them."""
    skeleton = WALK.skeleton
    names: list[str] = []
    parents: list[int] = []
    offsets, rotations = [], []
    place = {-1: -1}
    for joint, name in enumerate(skeleton.names):
        parent, offset = place[int(skeleton.parents[joint])], skeleton.offsets[joint]
        if name in above:
            names.append(above[name])
            parents.append(parent)
            offsets.append(offset)
            rotations.append(np.tile([1.0, 0.0, 0.0, 0.0], (FRAMES, 1)))
            parent, offset = len(names) - 1, np.zeros(3)
        place[joint] = len(names)
        names.append(name)
        parents.append(parent)
        offsets.append(offset)
        rotations.append(WALK.rotations[:, joint])
    more = Skeleton(tuple(names), np.array(parents), np.array(offsets), (), np.arange(len(names)))
    return replace(WALK, skeleton=more, rotations=np.stack(rotations, axis=1))


PROPS = {
    "sword": [("Sword", "RightHand", (0, -0.1, 0.1)), ("SwordTip", "Sword", (0, 0, 1.2))],
    "prop on the floor": [("Prop", "Hips", (1, -0.9, 1)), ("Prop1", "Prop", (0, 0, 0.5))],
    "tail": [("Tail", "Hips", (0, -0.1, -0.2)), ("Tail1", "Tail", (0, -0.1, -0.2)), ("Tail2", "Tail1", (0, -0.4, 0))],
    "flag": [("Backpack", "Spine", (0, 0.2, -0.2)), ("Flag", "Backpack", (0, 1.5, 0))],
    "skirt": [
        (f"Skirt{at}_{row}", f"Skirt{at}_{row - 1}" if row else "Hips", (0.1 * np.cos(at), -0.25, 0.1 * np.sin(at)))
        for at in range(6)
        for row in range(3)
    ],
}
CONNECTORS = {
    "acclaim": {"LeftUpLeg": "LHipJoint", "RightUpLeg": "RHipJoint"},
    "without telling names": {f"{side}{bone}": f"{bone}{side[0]}x" for side in ("Left", "Right") for bone in ("Arm",)},
    "above the hips": {"Hips": "reference"},
    "in every limb": {
        f"{side}{bone}": f"bone{side[0]}{at}"
        for side in ("Left", "Right")
        for at, bone in enumerate(("UpLeg", "Leg", "Arm", "ForeArm"))
    },
}


@pytest.mark.parametrize("prop", PROPS)
def test_props_and_clothes_are_no_part_of_the_body(tmp_path, prop):
    clip = read_clip(tmp_path, with_joints(PROPS[prop]))
    assert clip.notes == ()
    assert_like(clip, limbs)


@pytest.mark.parametrize("kind", CONNECTORS)
def test_joints_at_one_place_change_nothing(tmp_path, kind):
    clip = read_clip(tmp_path, with_connectors(CONNECTORS[kind]))
    assert clip.notes == ()
    assert_like(clip, limbs)


@pytest.mark.parametrize("missing", [("Toe", "ToeBase"), ("Hand",)])
def test_bodies_without_toes_or_hands_are_read(tmp_path, missing):
    gone = {f"{side}{part}" for side in ("Left", "Right") for part in missing}
    clip = read_clip(tmp_path, without_joints(gone))
    roles = need_roles(clip.skeleton)
    assert clip.notes == () and (roles.left_foot[0] == roles.left_foot[1]) == ("Toe" in missing)
    assert_like(clip, lambda roles: [roles.left_hip, roles.right_hip, roles.left_foot[0], roles.head])


SIBLINGS = {
    "none": "",
    "camera": "Camera",
    "two props": "Ball Racket",
    "controls of an engine": "ik_foot_l ik_foot_r ik_hand_gun",
}


PROP = "{\nOFFSET 50 0 50\nCHANNELS 3 Zrotation Yrotation Xrotation\nEnd Site\n{\nOFFSET 0 9 0\n}\n}\n"


def below_root(text: str, root: str, props: list[str], first: bool, carrier: str) -> str:
    """The walk with its hips below a root, next to props.

    Args:
        text: of the walk.
        root: name of the root.
        props: names of joints next to the hips.
        first: whether these come before the hips.
        carrier: of the travel: `hips`, `root`, or `armature` for hips that are below another joint.
    """
    head, rows = rows_of(text)
    body, frames = head.replace("HIERARCHY\n", "").replace("ROOT ", "JOINT ").split("MOTION")
    if carrier == "armature":
        body = f"JOINT Armature\n{{\nOFFSET 0 0 0\nCHANNELS 0\n{body}}}\n"
    more = "".join(f"JOINT {name}\n{PROP}" for name in props)
    inner = more + body if first else body + more
    head = f"HIERARCHY\nROOT {root}\n{{\nOFFSET 0 0 0\nCHANNELS 6 {SIX}\n{inner}}}\nMOTION{frames}"
    place, still = np.zeros((FRAMES, 6)), np.zeros((FRAMES, 3 * len(props)))
    if carrier == "root":
        place[:, [0, 2]] = rows[:, [0, 2]]
        rows[:, [0, 2]] = 0.0
    values = np.hstack([place, still, rows] if first else [place, rows, still])
    return head + "\n".join(" ".join(map(repr, row)) for row in values.tolist()) + "\n"


@pytest.mark.parametrize("siblings", SIBLINGS)
@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("carrier", ["hips", "root", "armature"])
def test_joints_next_to_the_hips_are_left_out(walk_text, tmp_path, siblings, first, carrier):
    names = SIBLINGS[siblings].split()
    path = saved(tmp_path, below_root(walk_text, "Root", names, first, carrier))
    clip = read_bvh(path)
    assert_same(clip, notes=1 if names else 0)
    assert read_skeleton(path).names == WALK.skeleton.names
    assert not names or any(names[0] in note for note in clip.notes)


def test_controls_of_miku_miku_dance_are_left_out(walk_text, tmp_path):
    text = renamed(in_japanese)(walk_text)
    path = saved(tmp_path, below_root(text, "全ての親", ["左足ＩＫ", "右足ＩＫ"], False, "hips"))
    assert_same(read_bvh(path), notes=1)


# jumps


def posed(before: int = 0, after: int = 0, *, in_place: bool, between: int = 0) -> MotionClip:
    """The walk with the rest pose held before and after it, and frames between the pose and the walk."""
    joints = WALK.skeleton.num_joints
    rest = np.tile([1.0, 0.0, 0.0, 0.0], (1, joints, 1))
    place = WALK.root_positions[:1] if in_place else np.zeros((1, 3))
    share = np.linspace(0, 1, between + 2)[1:-1]
    rotations = [quat_slerp(rest[0], WALK.rotations[0], np.full(joints, each)) for each in share]
    positions = [place[0] + each * (WALK.root_positions[0] - place[0]) for each in share]
    end = WALK.root_positions[-1:] if in_place else np.zeros((1, 3))
    return replace(
        WALK,
        root_positions=np.concatenate(
            [np.repeat(place, before, axis=0), *(each[None] for each in positions), WALK.root_positions]
            + [np.repeat(end, after, axis=0)]
        ),
        rotations=np.concatenate(
            [np.repeat(rest, before, axis=0), *(each[None] for each in rotations), WALK.rotations]
            + [np.repeat(rest, after, axis=0)]
        ),
    )


@pytest.mark.parametrize(("before", "after"), [(1, 0), (5, 0), (0, 1), (1, 1), (30, 30), (300, 0), (0, 1000)])
@pytest.mark.parametrize("in_place", [False, True])
def test_poses_before_and_after_the_motion_are_cut(tmp_path, before, after, in_place):
    clip = read_clip(tmp_path, posed(before, after, in_place=in_place))
    assert clip.reading is not None and clip.reading.first_frame == before
    assert_same(clip, notes=1)


@pytest.mark.parametrize("before", [1, 30])
@pytest.mark.parametrize("in_place", [False, True])
def test_a_frame_halfway_from_a_pose_to_the_motion_is_cut(tmp_path, before, in_place):
    """Resampling makes one."""
    assert_same(read_clip(tmp_path, posed(before, in_place=in_place, between=1)), notes=1)


@pytest.mark.parametrize(("at", "frames", "kept"), [(100, 1, 139), (100, 3, 137), (235, 1, 235), (239, 1, 239)])
def test_a_glitch_of_some_frames_is_cut(tmp_path, at, frames, kept):
    positions = WALK.root_positions.copy()
    positions[at : at + frames] += [3.0, 0.0, 0.0]
    clip = read_clip(tmp_path, replace(WALK, root_positions=positions))
    assert clip.num_frames == kept and len(clip.notes) == 1


def test_a_sudden_turn_is_cut(tmp_path):
    rotations = WALK.rotations.copy()
    rotations[150:, 0] = quat_multiply(quat_from_yaw(np.pi / 2), rotations[150:, 0])
    assert read_clip(tmp_path, replace(WALK, rotations=rotations)).num_frames == 150


# walks on the spot


@pytest.mark.parametrize(
    ("channels", "up"),
    [("Xposition Yposition Zposition", "y"), ("Xposition Yposition Zposition", "z"), ("Yposition", "y"), ("", "y")],
)
def test_walks_on_the_spot_travel_whatever_positions_the_file_has(tmp_path, channels, up):
    still = replace(WALK, root_positions=WALK.root_positions * np.array([0.0, 1.0, 0.0]))
    text = text_of(tipped(still, up), tmp_path)
    kept = ["XYZ".index(channel[0]) for channel in channels.split()]
    wanted = f"CHANNELS {3 + len(kept)} {channels}".rstrip()
    text = text.replace("CHANNELS 6 Xposition Yposition Zposition", wanted)
    text = with_rows(lambda rows: rows[:, [*kept, *range(3, rows.shape[1])]])(text)
    clip = read_bvh(saved(tmp_path, text))
    ground = WALK.root_positions[[0, -1]][:, [0, 2]]
    walked = np.linalg.norm((clip.root_positions[-1] - clip.root_positions[0])[[0, 2]])
    assert walked == pytest.approx(np.linalg.norm(ground[1] - ground[0]), rel=TRAVEL)
    assert any("on the spot" in note for note in clip.notes)
