"""Malformed and hostile glTF files are refused in one line, whatever is wrong with them."""

from __future__ import annotations

import base64
import copy
import json
import struct

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip_files import read_whole_clip
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.container import read_document
from pfnn_jax.motion.gltf.skin import read_mesh
from pfnn_jax.motion.reading import ReadOptions
from tests.gltf.rigs import NAMES, glb, make_rig
from tests.raising import assert_refused

HIPS, LEG = NAMES.index("Hips"), NAMES.index("LeftLeg")


def animated():
    """Returns a rig whose left leg bends."""
    rig = make_rig()
    turns = [[0, 0, 0, 1], [0.1, 0, 0, 0.995], [0, 0, 0, 1]]
    rig.animate({(LEG, "rotation"): ([0, 0.5, 1.0], turns), (HIPS, "translation"): ([0, 1.0], [[0, 0.9, 0]] * 2)})
    return rig


def read_all(path):
    """Reads everything of a file."""
    character = read_character(path)
    read_mesh(character)
    return character, read_whole_clip(path, ReadOptions())


def refused(tmp_path, rig_or_bytes, **fields):
    """Asserts that a file is refused, with a message of one line."""
    path = tmp_path / "a.glb"
    path.write_bytes(rig_or_bytes if isinstance(rig_or_bytes, bytes) else rig_or_bytes.bytes())
    error = assert_refused(lambda: read_all(path), file="a.glb", **fields)
    assert len(str(error).splitlines()) == 1 and len(str(error)) < 1000
    return error


def test_the_rig_itself_is_read(tmp_path):
    character, clip = read_all(animated().write(tmp_path / "a.glb"))
    assert character.skeleton.num_joints == len(NAMES) and clip.num_frames == 25


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
def test_json_that_is_no_gltf_is_refused(tmp_path, text):
    refused(tmp_path, glb(text, b""))


@pytest.mark.parametrize("part", ["nodes", "skins", "meshes", "accessors", "bufferViews", "buffers", "animations"])
@pytest.mark.parametrize("wrong", [3, "text", [None], [3], {"a": 1}])
def test_lists_that_are_none_are_refused(tmp_path, part, wrong):
    rig = animated()
    data = {**copy.deepcopy(rig.json), "buffers": [{"byteLength": len(rig.binary)}], part: wrong}
    refused(tmp_path, glb(json.dumps(data).encode(), bytes(rig.binary)))


def test_nodes_that_are_no_tree_are_refused(tmp_path):
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
        *(set_transform("scale", value) for value in ([1e99] * 3, "big")),
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
def test_inverse_bind_matrices_that_are_none_are_refused(tmp_path, value):
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
def test_times_of_keys_that_are_none_are_refused(tmp_path, times):
    """Too long, not finite, descending, and not as many as values."""
    rig = make_rig()
    rig.animate({(LEG, "rotation"): (times, [[0, 0, 0, 1]] * 2)})
    refused(tmp_path, rig)


@pytest.mark.parametrize("values", [np.zeros((2, 4)), np.full((2, 4), np.inf), np.ones((2, 3))])
def test_rotations_that_are_none_are_refused(tmp_path, values):
    rig = make_rig()
    rig.animate({(LEG, "rotation"): ([0.0, 1.0], values)})
    refused(tmp_path, rig)


def test_a_file_without_a_skin_is_refused(tmp_path):
    rig = make_rig()
    del rig.json["skins"], rig.json["nodes"][-1]["skin"]
    refused(tmp_path, rig, place="skins", value="none")


def test_a_character_that_is_no_human_is_refused(tmp_path):
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


@given(st.data())
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_bytes_changed_anywhere_are_read_or_refused_in_one_line(tmp_path, data):
    raw = bytearray(animated().bytes())
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
    st.just({}),
)


@given(st.data())
@settings(max_examples=300, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_values_changed_anywhere_in_the_json_are_read_or_refused_in_one_line(tmp_path, data):
    rig = animated()
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
    read_or_refuse(tmp_path, glb(json.dumps(tree).encode(), bytes(rig.binary)))


def read_or_refuse(tmp_path, raw):
    """Asserts that a file is read, or refused with a message of one line."""
    path = tmp_path / "a.glb"
    path.write_bytes(raw)
    for read in (lambda: read_mesh(read_character(path)), lambda: read_whole_clip(path, ReadOptions())):
        try:
            read()
        except InputError as error:
            assert len(str(error).splitlines()) == 1 and len(str(error)) < 1000
