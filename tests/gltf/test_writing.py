"""Laws of files that are written from nothing, and of appending to small ones."""

from __future__ import annotations

import base64
import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, cut, move_clip
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.cycles import cut_cycle
from pfnn_jax.motion.gltf.append import Animation, Channel, append_clips, glb
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.container import read_document
from pfnn_jax.motion.gltf.write import ROOT, glb_bytes, new_character
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_yaw, quat_to_matrix
from pfnn_jax.motion.retargeting.cycle import retarget_closed
from pfnn_jax.motion.root_motion import in_place, is_cycle, split_root
from pfnn_jax.motion.synthetic.walks import synthesise
from pfnn_jax.viewer.body import grow_body
from pfnn_jax.workflows.characters import put_onto
from tests.gltf.rigs import DOT
from tests.raising import assert_refused

EXACT = 1e-9  # metres and quaternion components
IN_THREE = 1e-4  # metres
FPS = 60.0


@pytest.fixture(scope="module")
def walk() -> MotionClip:
    """A walk of three seconds that turns to the left."""
    frames = np.zeros(180)
    return synthesise("proud", frames + 0.5, frames + 1.2)[0]


@pytest.fixture(scope="module")
def body_file(walk, tmp_path_factory) -> Path:
    """Our own body with the walk, travelling."""
    path = tmp_path_factory.mktemp("body") / "body.glb"
    path.write_bytes(glb_bytes(walk.skeleton, grow_body(walk.skeleton), {"proud": walk}, root_motion=True))
    return path


def json_of(content: bytes) -> dict[str, Any]:
    """Returns the JSON of a GLB file."""
    (size,) = struct.unpack_from("<I", content, 12)
    return json.loads(content[20 : 20 + size])


def places(clip: MotionClip) -> np.ndarray:
    """Returns the positions [T, J, 3] of all joints."""
    return forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)[0]


def test_our_own_body_has_no_error(walk, body_file, validate, tmp_path):
    (tmp_path / "still.glb").write_bytes(put_onto(cut_cycle(walk), body_file))
    assert not any(validate([body_file, tmp_path / "still.glb"]).values())


def test_our_own_body_moves_in_three_js_as_here(walk, body_file, three):
    character = new_character(walk.skeleton, grow_body(walk.skeleton))
    frames = np.linspace(0, walk.num_frames - 1, 10).astype(int)
    found = three.sample(body_file, {"proud": frames / FPS}, character.nodes)["proud"]
    np.testing.assert_allclose(found, places(walk)[frames], atol=IN_THREE)
    assert three.durations(body_file) == {"proud": pytest.approx((walk.num_frames - 1) / FPS)}


def test_our_own_body_is_read_back_with_its_motion(walk, body_file):
    again = read_clip(body_file, travel="keep")
    joints = [again.skeleton.names.index(name) for name in walk.skeleton.names]
    np.testing.assert_allclose(places(again)[:, joints], places(walk), atol=1e-4)


def test_in_place_nothing_moves_the_root(walk):
    data = json_of(glb_bytes(walk.skeleton, grow_body(walk.skeleton), {"proud": walk}))
    assert data["nodes"][0]["name"] == ROOT
    assert 0 not in {channel["target"]["node"] for channel in data["animations"][0]["channels"]}


@pytest.mark.parametrize("turn", [0.0, 0.8])
def test_a_loop_ends_in_the_keys_with_which_it_begins(turn, body_file):
    frames = np.zeros(240)
    cycle = cut_cycle(synthesise("neutral", frames + turn, frames + 1.2)[0])
    content = put_onto(cycle, body_file, name="loop")
    document = json_of(content)
    binary = content[-document["buffers"][0]["byteLength"] :]
    animation = document["animations"][-1]
    assert animation["name"] == "loop"
    view = document["bufferViews"][-1]["byteOffset"]
    for sampler in animation["samplers"]:
        accessor = document["accessors"][sampler["output"]]
        size = {"VEC3": 3, "VEC4": 4}[accessor["type"]]
        values = np.frombuffer(binary, "<f4", accessor["count"] * size, view + accessor["byteOffset"]).reshape(-1, size)
        first, last = values[0], values[-1]
        last = last * np.sign(first @ last) if size == 4 else last
        np.testing.assert_allclose(last, first, atol=1e-6)


def test_a_name_that_is_taken_gets_a_number(walk, body_file):
    data = json_of(put_onto(walk, body_file, name="proud"))
    assert [animation["name"] for animation in data["animations"]] == ["proud", "proud_2"]


def test_buffers_and_images_of_other_files_are_packed(body_file, walk, tmp_path, validate):
    """A `.gltf` with a buffer in a file, one in a data URI, and an image in a file becomes one valid GLB."""
    data, raw = json_of(body_file.read_bytes()), body_file.read_bytes()
    binary = raw[-data["buffers"][0]["byteLength"] :]
    (tmp_path / "body.bin").write_bytes(binary)
    (tmp_path / "dot.png").write_bytes(base64.b64decode(DOT))
    extra = np.arange(4, dtype="<f4").tobytes()
    data["buffers"] = [
        {"uri": "body.bin", "byteLength": len(binary)},
        {"uri": "data:application/octet-stream;base64," + base64.b64encode(extra).decode(), "byteLength": len(extra)},
    ]
    data["bufferViews"].append({"buffer": 1, "byteLength": len(extra)})
    data["images"] = [{"uri": "dot.png"}]
    (tmp_path / "body.gltf").write_text(json.dumps(data))
    (tmp_path / "out.glb").write_bytes(put_onto(walk, tmp_path / "body.gltf", name="again"))
    packed = read_document(tmp_path / "out.glb")
    assert len(packed.json["buffers"]) == 1 and "uri" not in packed.json["buffers"][0]
    view = packed.json["bufferViews"][len(data["bufferViews"]) - 1]
    assert packed.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] == extra
    image = packed.json["bufferViews"][packed.json["images"][0]["bufferView"]]
    start = image["byteOffset"]
    assert packed.binary[start : start + image["byteLength"]] == base64.b64decode(DOT)
    assert not validate([tmp_path / "out.glb"])[tmp_path / "out.glb"]


def test_animated_nodes_with_a_matrix_keep_their_pose(body_file, walk, three, tmp_path):
    data, raw = json_of(body_file.read_bytes()), body_file.read_bytes()
    for number, node in enumerate(data["nodes"][:-1]):
        turn, place = node.pop("rotation", [0.0, 0.0, 0.0, 1.0]), node.pop("translation", [0.0, 0.0, 0.0])
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrix(turn)
        matrix[:3, 3] = place
        node["matrix"] = matrix.T.ravel().tolist()
        assert number or node["name"] == ROOT
    del data["animations"]
    (tmp_path / "matrices.glb").write_bytes(glb(data, raw[-data["buffers"][0]["byteLength"] :]))
    nodes, times = 1 + np.arange(walk.skeleton.num_joints), {"again": np.array([0.0, 0.8, 1.7])}
    found = []
    for name in (body_file, tmp_path / "matrices.glb"):
        (tmp_path / "out.glb").write_bytes(put_onto(walk, name, root_motion=True, name="again"))
        found.append(three.sample(tmp_path / "out.glb", times, nodes)["again"])
    np.testing.assert_allclose(found[1], found[0], atol=IN_THREE)


def rotation_matrix(turn: list[float]) -> np.ndarray:
    """Returns the matrix [3, 3] of a quaternion xyzw."""
    return quat_to_matrix(np.roll(turn, 1))


def test_keys_that_are_not_finite_are_refused(body_file):
    document = read_document(body_file)
    values = np.zeros((3, 3))
    values[1, 0] = np.nan
    animation = Animation("bad", FPS, [Channel(0, "translation", values)])
    assert_refused(lambda: append_clips(document, [animation]), file="body.glb", place="frame 1")
    assert_refused(lambda: append_clips(document, [Animation("none", FPS, [])]), place="clip")


def test_other_files_are_no_characters(walk, tmp_path):
    (tmp_path / "body.fbx").write_bytes(b"Kaydara")
    assert_refused(lambda: put_onto(walk, tmp_path / "body.fbx"), place="suffix", value=".fbx")
    with pytest.raises(InputError):
        put_onto(walk, tmp_path / "absent.glb")


def test_a_split_clip_is_joined_again(walk):
    for clip in (walk, cut_cycle(walk)):
        root, still = split_root(clip)
        path = [move_clip(cut(still, t, t + 1), root.rotations[t], root.positions[t]) for t in range(clip.num_frames)]
        again = replace(
            still,
            root_positions=np.concatenate([frame.root_positions for frame in path]),
            rotations=np.concatenate([frame.rotations for frame in path]),
        )
        np.testing.assert_allclose(places(again), places(clip), atol=EXACT)


def test_in_place_does_not_depend_on_where_the_clip_lies(walk):
    moved = move_clip(walk, quat_from_yaw(2.0), np.array([3.0, 0.0, -1.0]))
    np.testing.assert_allclose(places(in_place(moved)), places(in_place(walk)), atol=EXACT)


def test_a_cycle_in_place_and_on_another_body_stays_closed(walk, body_file):
    cycle = cut_cycle(walk)
    assert is_cycle(cycle) and not is_cycle(walk)
    moved = retarget_closed(cycle, read_character(body_file).skeleton).clip
    assert is_cycle(moved) and moved.num_frames == cycle.num_frames
    standing = places(in_place(moved))
    np.testing.assert_allclose(standing[-1], standing[0], atol=EXACT)


def test_sway_and_bob_stay_in_place(walk):
    joint = need_humanoid(walk.skeleton).hips
    hips = places(in_place(walk))[:, joint]
    np.testing.assert_allclose(hips[:, 1], places(walk)[:, joint, 1], atol=EXACT)
    assert np.ptp(hips[30:-30, 0]) > 0.01 and np.abs(hips[:, [0, 2]]).max() < 0.2


def test_chunks_of_other_types_are_kept(walk, body_file, tmp_path):
    extra = struct.pack("<I4s", 8, b"ACME") + b"whatever"
    raw = bytearray(body_file.read_bytes() + extra)
    struct.pack_into("<I", raw, 8, len(raw))
    (tmp_path / "extra.glb").write_bytes(raw)
    assert read_document(tmp_path / "extra.glb").chunks == ((b"ACME", b"whatever"),)
    content = put_onto(walk, tmp_path / "extra.glb", name="again")
    assert content.endswith(extra) and struct.unpack_from("<I", content, 8) == (len(content),)


def test_a_colour_on_no_first_corner_of_a_face_is_left_out(walk):
    mesh = grow_body(walk.skeleton)
    colours = np.tile(np.array([10, 20, 30], np.uint8), (len(mesh.vertices), 1))
    lonely = np.append(mesh.vertices, mesh.vertices[:1], axis=0)
    grown = {name: np.append(getattr(mesh, name), getattr(mesh, name)[:1], axis=0) for name in PER_VERTEX}
    painted = np.append(colours, [[200, 0, 0]], axis=0).astype(np.uint8)
    mesh = replace(mesh, vertices=lonely, colours=painted, **grown)
    primitives = json_of(glb_bytes(walk.skeleton, mesh, {"walk": walk}))["meshes"][0]["primitives"]
    assert len(primitives) == 1


PER_VERTEX = ("normals", "joints", "weights")
