"""Malformed and hostile glTF files are refused in one line, whatever is wrong with them."""

from __future__ import annotations

import base64
import copy
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.clip_files import read_whole_clip
from pfnn_jax.motion.gltf.animations import clip_names, read_tracks
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.container import read_document
from pfnn_jax.motion.gltf.skin import read_mesh
from pfnn_jax.motion.gltf.write import character_bytes
from pfnn_jax.motion.reading import ReadOptions
from tests.gltf.rigs import DOT, NAMES, as_matrix, glb, make_rig, places
from tests.raising import assert_refused

HIPS, LEG = NAMES.index("Hips"), NAMES.index("LeftLeg")


def animated():
    """Returns a rig whose left leg bends."""
    rig = make_rig()
    turns = [[0, 0, 0, 1], [0.1, 0, 0, 0.995], [0, 0, 0, 1]]
    rig.animate({(LEG, "rotation"): ([0, 0.5, 1.0], turns), (HIPS, "translation"): ([0, 1.0], [[0, 0.9, 0]] * 2)})
    return rig


def full():
    """Returns a rig with everything that is read or rewritten: a material, images, a matrix and a map of VRM 0.x."""
    rig = animated()
    data, dot = rig.json, "data:image/png;base64," + DOT
    data["images"] = [{"uri": dot}, {"uri": "dot.png"}]
    data["textures"] = [{"source": 0}]
    texture = {"index": 0, "extensions": {"KHR_texture_transform": {"offset": [0.1, 0.2], "rotation": 0.1}}}
    surface = {"baseColorFactor": [1.0, 0.5, 0.2, 1.0], "baseColorTexture": texture}
    data["materials"] = [{"pbrMetallicRoughness": surface}]
    primitive = data["meshes"][0]["primitives"][0]
    primitive["material"] = 0
    primitive["attributes"]["TEXCOORD_0"] = rig.add(np.zeros((3 * len(NAMES), 2), np.float32), "VEC2")
    spine = data["nodes"][NAMES.index("Spine")]
    spine["matrix"] = as_matrix(np.array([1.0, 0.0, 0.0, 0.0]), np.array(spine.pop("translation")), 1.0)
    bones = {"hips": "Hips", "head": "Head", "leftUpperLeg": "LeftUpLeg", "leftLowerLeg": "LeftLeg"}
    rows = [{"bone": bone, "node": NAMES.index(name)} for bone, name in bones.items()]
    data["extensions"] = {"VRM": {"humanoid": {"humanBones": rows}}}
    return rig


def read_all(path):
    """Reads everything of a file."""
    character = read_character(path)
    read_mesh(character)
    return character, read_whole_clip(path, ReadOptions())


def write(path):
    """Returns the file of a character with a clip of two frames appended, whose skeleton is the character's own."""
    character = read_character(path)
    skeleton = character.skeleton
    turns = np.zeros((2, skeleton.num_joints, 4))
    turns[..., 0] = 1.0
    clip = MotionClip(skeleton, 30.0, np.repeat(character.bind_positions[:1], 2, axis=0), turns)
    return character_bytes(character, {"walk": clip})


def refused(tmp_path, rig_or_bytes, **fields):
    """Asserts that a file is refused, with a message of one line."""
    path = tmp_path / "a.glb"
    path.write_bytes(rig_or_bytes if isinstance(rig_or_bytes, bytes) else rig_or_bytes.bytes())
    error = assert_refused(lambda: read_all(path), file="a.glb", **fields)
    assert len(str(error).splitlines()) == 1 and len(str(error)) < 1000
    return error


@pytest.fixture
def dotted(tmp_path):
    """A folder with the image that `full` names."""
    (tmp_path / "dot.png").write_bytes(base64.b64decode(DOT))
    return tmp_path


@pytest.mark.parametrize("make", [animated, full])
def test_the_rig_itself_is_read_and_written(dotted, make):
    character, clip = read_all(make().write(dotted / "a.glb"))
    assert character.skeleton.num_joints == len(NAMES) and clip.num_frames == 25
    (dotted / "b.glb").write_bytes(write(dotted / "a.glb"))
    again = read_document(dotted / "b.glb")
    assert [each["name"] for each in again.json["animations"]] == ["walk", "walk_2"]
    assert all(image.get("uri", "data:").startswith("data:") for image in again.json.get("images", []))


@pytest.mark.parametrize(
    "name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "ACME_secret"]
)
def test_required_extensions_that_cannot_be_read_are_named(tmp_path, name):
    rig = animated()
    rig.json["extensionsRequired"] = [name]
    error = refused(tmp_path, rig, place="extensionsRequired")
    assert name in str(error)


@pytest.mark.parametrize("keep", [0, 3, 11, 12, 19, 40, 400, -1, -40])
def test_truncated_files_are_refused(tmp_path, keep):
    refused(tmp_path, animated().bytes()[:keep])


@pytest.mark.parametrize(
    ("header", "place"),
    [
        (struct.pack("<4sII", b"glTF", 1, 12), "header"),
        (struct.pack("<4sII", b"glTF", 2, 12), "chunk 0"),
        (struct.pack("<4sII", b"glTF", 2, 0xFFFFFFFF), "header"),
        (struct.pack("<4sIII4s", b"glTF", 2, 24, 0xFFFFFFFF, b"JSON") + b"{}  ", "chunk 0"),
        (struct.pack("<4sIII4s", b"glTF", 2, 24, 4, b"BIN\0") + b"\0" * 4, "chunk 0"),
        (b"OggS" + b"\0" * 40, "JSON"),
        (b"", "JSON"),
    ],
)
def test_wrong_headers_and_chunks_are_refused(tmp_path, header, place):
    refused(tmp_path, header, place=place)


DEEP = b'{"a":' * 5_000 + b"1" + b"}" * 5_000


@pytest.mark.parametrize(
    "text", [b"[]", b"3", b"null", b'{"asset":', b"\xff\xfe", b'{"asset": NaN}', b"[" * 100_000, DEEP]
)
def test_json_of_another_kind_is_refused(tmp_path, text):
    refused(tmp_path, glb(text, b""))


@pytest.mark.parametrize("part", ["nodes", "skins", "meshes", "accessors", "bufferViews", "buffers", "animations"])
@pytest.mark.parametrize("wrong", [3, "text", [None], [3], {"a": 1}])
def test_top_level_values_that_are_not_lists_are_refused(tmp_path, part, wrong):
    rig = animated()
    data = {**copy.deepcopy(rig.json), "buffers": [{"byteLength": len(rig.binary)}], part: wrong}
    refused(tmp_path, glb(json.dumps(data).encode(), bytes(rig.binary)))


def test_nodes_in_cycles_and_under_two_parents_are_refused(tmp_path):
    cyclic = animated()
    cyclic.json["nodes"][NAMES.index("Head")]["children"] = [HIPS]
    refused(tmp_path, cyclic, rule_mentions="one parent")
    looped = animated()
    looped.json["nodes"] += [{"children": [len(NAMES) + 2]}, {"children": [len(NAMES) + 1]}]
    refused(tmp_path, looped, rule_mentions="tree")
    own = animated()
    own.json["nodes"].append({"children": [len(NAMES) + 1]})
    refused(tmp_path, own, rule_mentions="tree")


def set_accessor(key, value):
    def change(rig):
        for accessor in rig.json["accessors"]:
            accessor[key] = value

    return change


def set_view(key, value):
    def change(rig):
        for view in rig.json["bufferViews"]:
            view[key] = value

    return change


def set_transform(key, value):
    def change(rig):
        rig.json["nodes"][HIPS].pop("translation", None)
        rig.json["nodes"][HIPS][key] = value

    return change


@pytest.mark.parametrize(
    "change",
    [
        *(set_accessor("count", value) for value in (2**31, 2**62, -1, 1.5, "3", 10**9)),
        *(set_accessor("byteOffset", value) for value in (2**40, -4, "a")),
        *(set_accessor("componentType", value) for value in (5127, None, [5126])),
        *(set_accessor("type", value) for value in ("MAT9", None, 4)),
        *(set_accessor("bufferView", value) for value in (10**6, -1, "0")),
        *(set_view("byteLength", value) for value in (2**40, -1, None)),
        *(set_view("byteOffset", value) for value in (2**40, -1)),
        *(set_view("byteStride", value) for value in (0, 1, 2**30)),
        *(set_view("buffer", value) for value in (7, -1, None)),
        *(set_transform("matrix", value) for value in ([0.0] * 16, [1.0] * 15, ["a"] * 16, [1e300] * 16)),
        *(set_transform("rotation", value) for value in ([0, 0, 0, 0], [1, 2], 3)),
        *(set_transform("scale", value) for value in ([1e99] * 3, [10**400, 1, 1], "big")),
        *(set_transform("children", value) for value in ([10**9], [-1], "0", [[0]])),
    ],
)
def test_numbers_out_of_range_are_refused(tmp_path, change):
    rig = animated()
    change(rig)
    refused(tmp_path, rig)


def test_large_accessors_without_data_are_refused(tmp_path):
    rig = animated()
    for accessor in rig.json["accessors"]:
        accessor.pop("bufferView")
        accessor["count"] = 20_000_000
    refused(tmp_path, rig)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_invalid_inverse_bind_matrices_are_refused(tmp_path, value):
    rig = make_rig()
    rig.json["skins"][0]["inverseBindMatrices"] = rig.add(np.full((len(NAMES), 16), value, np.float32), "MAT4")
    refused(tmp_path, rig)


def test_too_many_joints_are_refused_with_the_limit(tmp_path):
    rig = make_rig()
    rig.json["nodes"] += [{} for _ in range(100_000)]
    refused(tmp_path, rig, place="nodes", rule_mentions="20000")
    rig = make_rig()
    first = len(rig.json["nodes"])
    rig.json["nodes"] += [{} for _ in range(3_000)]
    rig.json["nodes"][HIPS]["children"] += list(range(first, first + 3_000))
    rig.json["skins"][0] = {"joints": [*range(len(NAMES)), *range(first, first + 3_000)]}
    refused(tmp_path, rig, rule_mentions="2000")


@pytest.mark.parametrize(
    "times", [[0.0, 1e30], [-1e9, 1.0], [0.0, np.nan], [0.0, -1.0], [0.0, 15_000.0], [0.0], [0.0, 1.0, 2.0]]
)
def test_invalid_times_of_keys_are_refused(tmp_path, times):
    """Too long, not finite, descending, and not as many as values."""
    rig = make_rig()
    rig.animate({(LEG, "rotation"): (times, [[0, 0, 0, 1]] * 2)})
    refused(tmp_path, rig)


@pytest.mark.parametrize("values", [np.zeros((2, 4)), np.full((2, 4), np.inf), np.ones((2, 3))])
def test_invalid_rotations_of_keys_are_refused(tmp_path, values):
    rig = make_rig()
    rig.animate({(LEG, "rotation"): ([0.0, 1.0], values)})
    refused(tmp_path, rig)


def test_a_file_without_a_skin_is_refused(tmp_path):
    rig = make_rig()
    del rig.json["skins"], rig.json["nodes"][-1]["skin"]
    refused(tmp_path, rig, place="skins", value="none")


def test_a_skin_without_a_humanoid_is_refused(tmp_path):
    rig = make_rig()
    rig.json["skins"][0]["joints"] = [NAMES.index(name) for name in ("Hips", "Spine", "Head")]
    refused(tmp_path, rig, place="skeleton")


def test_joints_of_vertices_beyond_the_skin_are_refused(tmp_path):
    rig = make_rig()
    joints = np.full((3 * len(NAMES), 4), 200, np.uint8)
    rig.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = rig.add(joints, "VEC4")
    refused(tmp_path, rig, rule_mentions=f"{len(NAMES)} joints")


@pytest.mark.parametrize(
    ("uri", "rule"),
    [
        ("http://example.com/a.bin", "folder"),
        ("file:///etc/passwd", "folder"),
        ("/etc/passwd", "folder"),
        ("../secret.bin", "folder"),
        ("inner/../../secret.bin", "folder"),
        ("..%2Fsecret.bin", "folder"),
        ("C:\\secret.bin", "folder"),
        ("link.bin", "lead out"),
        ("missing.bin", "no such file"),
        ("a" * 300 + ".bin", "name of a file"),
        ("\ud800.bin", "name of a file"),
        ("data:application/octet-stream;base64,@@@@", "base64"),
        ("data:text/plain,abc", "base64"),
        (7, "name a file"),
    ],
)
def test_buffers_outside_the_folder_are_refused(tmp_path, uri, rule):
    (tmp_path / "secret.bin").write_bytes(b"\0" * 100_000)
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    rig = make_rig()
    data = {**rig.json, "buffers": [{"byteLength": len(rig.binary), "uri": uri}]}
    (folder / "a.gltf").write_text(json.dumps(data))
    assert_refused(lambda: read_document(folder / "a.gltf"), place="buffers[0].uri", rule_mentions=rule)


@pytest.mark.parametrize("kind", ["file", "data", "spaces"])
def test_buffers_in_the_folder_and_in_the_json_are_read(tmp_path, kind):
    rig = animated()
    names = {"file": "a.bin", "spaces": "bin%20files/a.bin"}
    (tmp_path / "bin files").mkdir()
    for path in (tmp_path / "a.bin", tmp_path / "bin files" / "a.bin"):
        path.write_bytes(bytes(rig.binary))
    data = "data:application/octet-stream;base64," + base64.b64encode(bytes(rig.binary)).decode()
    rig.json["buffers"] = [{"byteLength": len(rig.binary), "uri": names.get(kind, data)}]
    (tmp_path / "a.gltf").write_text(json.dumps(rig.json))
    character, clip = read_all(tmp_path / "a.gltf")
    assert character.skeleton.num_joints == len(NAMES) and clip.num_frames == 25


def test_sparse_accessors_replace_values(tmp_path):
    rig = make_rig()
    moved = np.array([[5.0, 6.0, 7.0]], np.float32)
    indices, values = rig.add(np.array([1], np.uint16), "SCALAR"), rig.add(moved, "VEC3")
    views = [rig.json["accessors"][number]["bufferView"] for number in (indices, values)]
    accessor = rig.json["accessors"][rig.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    accessor["sparse"] = {
        "count": 1,
        "indices": {"bufferView": views[0], "componentType": 5123},
        "values": {"bufferView": views[1]},
    }
    character = read_character(rig.write(tmp_path / "a.glb"))
    assert np.allclose(read_mesh(character).vertices[1] - character.placement.translation, moved[0])


def change_full(rig, place, value):
    """Puts a value to a place of the JSON of a rig, such as `nodes.0.scale`."""
    *above, last = [int(key) if key.isdigit() else key for key in place.split(".")]
    inner = rig.json
    for key in above:
        inner = inner[key]
    inner[last] = value


HUGE, HALF_A_PAIR = 10**400, "\ud800"
TEXTURE = "materials.0.pbrMetallicRoughness.baseColorTexture.extensions.KHR_texture_transform"
BONE = "extensions.VRM.humanoid.humanBones.0.bone"


@pytest.mark.parametrize(
    ("place", "value"),
    [
        *(("animations.0.channels.0.target.path", value) for value in ([], {})),
        *((BONE, value) for value in ([], {})),
        ("materials.0.pbrMetallicRoughness.baseColorFactor", [HUGE, 1, 1, 1]),
        *((f"{TEXTURE}.{name}", value) for name, value in (("rotation", HUGE), ("scale", [HUGE, 1]), ("offset", "a"))),
        ("images.0", 3), ("images.0.uri", 3), ("images", {"a": 1}), ("images.1.uri", "../dot.png"),
        ("images.1.uri", HALF_A_PAIR),
        ("animations", [3]), ("accessors", {"a": {}}), ("bufferViews", {"a": {}}),
        ("bufferViews.0.buffer", 7), ("bufferViews.0.byteOffset", "a"),
        *(("asset.extras", value) for value in (HUGE, HALF_A_PAIR)), (f"nodes.{HIPS}.name", HALF_A_PAIR),
        (f"nodes.{LEG}.matrix", None),
        *(("nodes.0.scale", value) for value in ([0, 0, 0], [1, 0, 1], [1e6] * 3)),
        *((f"nodes.{LEG}.scale", value) for value in ([0, 0, 0], [1e-9] * 3)),
    ],
)  # fmt: skip
@pytest.mark.parametrize("packed", [True, False])
def test_values_of_the_wrong_kind_are_read_and_written_or_refused_in_one_line(dotted, place, value, packed):
    """In a GLB, and in a `.gltf` file whose buffer is packed when it is written."""
    rig = full()
    change_full(rig, place, value)
    if packed:
        read_or_refuse(dotted, rig.bytes())
    else:
        (dotted / "a.bin").write_bytes(bytes(rig.binary))
        data = {**rig.json, "buffers": [{"byteLength": len(rig.binary), "uri": "a.bin"}]}
        read_or_refuse(dotted, json.dumps(data).encode())


def test_numbers_that_overflow_are_refused(tmp_path):
    text = json.dumps(animated().json).replace("0.9", "1e999")
    refused(tmp_path, glb(text.encode(), b""), place="JSON")


def test_joints_that_are_scaled_to_nothing_are_refused(tmp_path):
    hidden = make_rig()
    hidden.json["nodes"][0]["scale"] = [0, 0, 0]
    path = hidden.write(tmp_path / "a.glb")
    read_character(path)  # in its bind pose
    assert_refused(lambda: write(path), file="a.glb", rule_mentions="must have a scale")
    del hidden.json["skins"][0]["inverseBindMatrices"]
    refused(tmp_path, hidden)


def test_nested_scales_that_grow_without_bound_are_refused(tmp_path):
    rig = make_rig()
    first = len(rig.json["nodes"])
    rig.json["nodes"] += [{"scale": [1e6] * 3, "children": [first + n + 1]} for n in range(60)] + [{}]
    refused(tmp_path, rig, value="too large")


def test_nodes_that_are_nested_too_deeply_are_refused(tmp_path):
    rig = make_rig()
    first = len(rig.json["nodes"])
    rig.json["nodes"] += [{"children": [first + n + 1]} for n in range(19_000)] + [{}]
    refused(tmp_path, rig, rule_mentions="256")


def test_legs_below_each_others_feet_are_refused(tmp_path):
    """Each foot is a child of the hips and carries the other leg."""
    world = dict(zip(NAMES, places(), strict=True))

    def cross(data):
        nodes = data["nodes"]
        hips = nodes[HIPS]
        for side, other in (("Left", "Right"), ("Right", "Left")):
            foot, thigh, leg = (NAMES.index(f"{name}{part}") for name, part in
                                ((side, "Foot"), (other, "UpLeg"), (other, "Leg")))  # fmt: skip
            hips["children"].append(foot)
            hips["children"].remove(thigh)
            nodes[foot]["translation"] = (world[f"{side}Foot"] - world["Hips"]).tolist()
            nodes[foot]["children"].append(thigh)
            nodes[thigh]["translation"] = (world[f"{other}UpLeg"] - world[f"{side}Foot"]).tolist()
            nodes[leg].pop("children")

    refused(tmp_path, make_rig(cross), place="skeleton", rule_mentions="each other's feet")


def test_accessors_animations_and_skins_are_bounded(tmp_path):
    """Each of these small files would take gigabytes or minutes."""
    rig = animated()
    rig.json["animations"] += [{}] * 100_000
    refused(tmp_path, rig, place="animations", rule_mentions="1000")
    rig = animated()
    rig.json["skins"][0] = {"joints": [HIPS] * 100_000}
    refused(tmp_path, rig, place="skins[0].joints")
    rig = animated()
    rig.json["skins"] += [{"joints": list(range(len(NAMES)))}] * 201
    refused(tmp_path, rig, place="skins")


@pytest.mark.parametrize("skin", [0, None])
def test_meshes_that_many_nodes_show_are_bounded(tmp_path, skin):
    rig = make_rig()
    first = len(rig.json["nodes"])
    rig.json["nodes"] += [{"mesh": 0} if skin is None else {"mesh": 0, "skin": 0}] * 10_000
    rig.json["nodes"][HIPS]["children"] += list(range(first, first + 10_000))
    refused(tmp_path, rig, rule_mentions="in all")


def test_keys_that_many_channels_share_are_read_once(tmp_path):
    rig = make_rig()
    rig.animate({(LEG, "rotation"): (np.arange(2_000) / 30, np.tile([0.0, 0, 0, 1], (2_000, 1)))})
    extra = len(rig.json["nodes"])
    rig.json["nodes"] += [{}] * 500
    channels = rig.json["animations"][0]["channels"]
    channels += [{"sampler": 0, "target": {"node": extra + n, "path": "rotation"}} for n in range(500)]
    tracks = read_tracks(read_document(rig.write(tmp_path / "a.glb")), 0)
    assert len(tracks) == 501 and len({id(track.values) for track in tracks}) == 1
    assert len({track.node for track in tracks}) == 501


def test_pixels_of_all_textures_are_bounded(tmp_path, monkeypatch):
    """The texture that is beyond the bound leaves the colour of its material."""
    rig = full()
    path = rig.write(tmp_path / "a.glb")
    monkeypatch.setattr("pfnn_jax.motion.gltf.colours.MAX_PIXELS", 0)
    mesh = read_mesh(read_character(path))
    assert np.unique(mesh.colours, axis=0).tolist() == [[255, 188, 124]]


def test_a_buffer_file_that_many_buffers_name_is_read_once(tmp_path, monkeypatch):
    rig = make_rig()
    (tmp_path / "a.bin").write_bytes(bytes(rig.binary))
    rig.json["buffers"] = [{"byteLength": len(rig.binary), "uri": "a.bin"}] + [{"byteLength": 1, "uri": "a.bin"}] * 50
    (tmp_path / "a.gltf").write_text(json.dumps(rig.json))
    seen = []
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: seen.append(path.name) or read(path))
    assert len(read_document(tmp_path / "a.gltf").buffers) == 51
    assert seen == ["a.gltf", "a.bin"]


def test_names_of_clips_are_all_different(tmp_path):
    rig = animated()
    moves = rig.json["animations"][0]
    names = ["A", "A (2)", "A", "A", None, "clip 4", "A (2)"]
    rig.json["animations"] = [{**moves, "name": name} for name in names]
    found = clip_names(read_document(rig.write(tmp_path / "a.glb")))
    assert len(set(found)) == len(names) and found[:2] == names[:2]


def test_joints_get_different_names(tmp_path):
    def rename(data):
        data["nodes"][NAMES.index("Head")]["name"] = f"Hips_{NAMES.index('Spine')}"
        data["nodes"][NAMES.index("Spine")]["name"] = "Hips"

    names = read_character(make_rig(rename).write(tmp_path / "a.glb")).skeleton.names
    assert len(set(names)) == len(names)


@pytest.mark.slow
@given(st.data())
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_bytes_changed_anywhere_are_read_or_refused_in_one_line(tmp_path, data):
    raw = bytearray(FULL.bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    read_or_refuse(tmp_path, bytes(raw))


VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**70), 2**70),
    st.integers(-2, 40),
    st.floats(),
    st.text(max_size=4),
    st.lists(st.integers(-2, 40), max_size=17),
    st.sampled_from([{}, HUGE, HALF_A_PAIR, [0, 0, 0], [1e6] * 3]),
)
FULL = full()


@pytest.mark.slow
@given(st.data())
@settings(max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_values_changed_anywhere_in_the_json_are_read_or_refused_in_one_line(tmp_path, data):
    rig = FULL
    tree = {**copy.deepcopy(rig.json), "buffers": [{"byteLength": len(rig.binary)}]}
    for _ in range(data.draw(st.integers(1, 3))):
        place = tree
        while True:
            keys = sorted(place) if isinstance(place, dict) else range(len(place))
            if not keys:
                break
            key = data.draw(st.sampled_from(list(keys)))
            if isinstance(place[key], dict | list) and data.draw(st.integers(0, 3)):
                place = place[key]
                continue
            if isinstance(place, dict) and data.draw(st.booleans()):
                del place[key]
            else:
                place[key] = data.draw(VALUES)
            break
    (tmp_path / "dot.png").write_bytes(base64.b64decode(DOT))
    read_or_refuse(tmp_path, glb(json.dumps(tree).encode(), bytes(rig.binary)))


def read_or_refuse(tmp_path, raw):
    """Asserts that a file is read and written with a clip, or refused with a message of one line."""
    path = tmp_path / "a.glb"
    path.write_bytes(raw)
    calls = (lambda: read_mesh(read_character(path)), lambda: read_whole_clip(path, ReadOptions()), lambda: write(path))
    for call in calls:
        try:
            call()
        except InputError as error:
            assert len(str(error).splitlines()) == 1 and len(str(error)) < 1000
