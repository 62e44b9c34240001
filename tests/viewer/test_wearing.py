"""Worn characters without a browser: contents of files, skinned bodies in pieces, and poses moment by moment."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

from pfnn_jax.errors import InputError  # noqa: E402
from pfnn_jax.motion.bvh import bvh_text  # noqa: E402
from pfnn_jax.motion.clip import MotionClip  # noqa: E402
from pfnn_jax.motion.gltf.write import glb_bytes  # noqa: E402
from pfnn_jax.motion.kinematics import forward_kinematics, quat_from_axis_angle, quat_multiply  # noqa: E402
from pfnn_jax.motion.retargeting.retarget import retarget  # noqa: E402
from pfnn_jax.motion.skinned_mesh import SkinnedMesh  # noqa: E402
from pfnn_jax.motion.synthetic.walks import synthesise  # noqa: E402
from pfnn_jax.viewer.body import grow_body  # noqa: E402
from pfnn_jax.viewer.page import scene as scenes  # noqa: E402
from pfnn_jax.viewer.page import worn_character  # noqa: E402
from pfnn_jax.viewer.page.downloads import BVH, GLB, recording_bytes  # noqa: E402
from pfnn_jax.viewer.page.restyle import check_clip  # noqa: E402
from pfnn_jax.viewer.page.scene import PageScene, Spring  # noqa: E402
from pfnn_jax.viewer.page.skinned_body import MOST_BONES, Piece, SkinnedBody, split_mesh  # noqa: E402
from pfnn_jax.viewer.page.view import View, at_moment  # noqa: E402
from pfnn_jax.viewer.page.worn_character import (  # noqa: E402
    FileContent,
    LiveRetargeter,
    WornCharacter,
    clip_as_bvh,
    clip_bytes,
    read_content,
    read_worn_character,
)
from tests.raising import assert_refused  # noqa: E402

EXACT = 1e-9  # float64 over a few products
ROUNDED = 1e-5  # metres: vertices are welded at this distance, and files hold float32
LEVEL = 0.01  # metres by which the floor of the last second differs from that of the seconds around
GIANT = 1.6
MOVED = ("root_positions", "rotations")


@pytest.fixture(scope="module")
def clip() -> MotionClip:
    return synthesise("zombie", np.zeros(150), np.full(150, 0.9))[0]


@pytest.fixture(scope="module")
def character(clip) -> bytes:
    """A rigged character with two motions, larger than the body of the clip."""
    large = replace(clip.skeleton, offsets=GIANT * clip.skeleton.offsets, resting_heights=None)
    large = replace(large, end_sites=tuple((joint, GIANT * site) for joint, site in large.end_sites))
    walk = replace(clip, skeleton=large, root_positions=GIANT * clip.root_positions)
    short = replace(walk, root_positions=walk.root_positions[:10], rotations=walk.rotations[:10])
    return glb_bytes(large, grow_body(large), {"walk": walk, "blink": short, "stroll": walk}, root_motion=True)


@pytest.fixture(scope="module")
def worn(character) -> WornCharacter:
    return read_worn_character("my rig.glb", character)


def views(clip: MotionClip) -> list[View]:
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    roots = positions[:, 0][:, [0, 2]]
    return [
        View(
            run="run",
            frame=t,
            joints=positions[t],
            world_rotations=rotations[t],
            root=roots[t],
            facing=np.array([0.0, 1.0]),
            past_positions=roots[t][None],
            past_directions=np.array([[0.0, 1.0]]),
            future_positions=roots[t][None],
            future_directions=np.array([[0.0, 1.0]]),
            contacts=np.zeros(4),
        )
        for t in range(len(positions))
    ]


def posed(piece: Piece, mesh: SkinnedMesh, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Returns the triangles [F, 3, 3] of a piece as viser draws them: four bones a vertex."""
    assert (np.count_nonzero(piece.weights, axis=1) <= 4).all()
    assert np.allclose(piece.weights.sum(axis=1), 1.0, atol=EXACT)
    order = np.argsort(-piece.weights, axis=1)[:, : min(4, len(piece.bones))]
    weights = np.take_along_axis(piece.weights, order, axis=1)
    joints = piece.bones[order]
    if joints.shape[1] < 4:
        more = ((0, 0), (0, 4 - joints.shape[1]))
        joints, weights = np.pad(joints, more), np.pad(weights, more)
    alone = replace(mesh, vertices=piece.vertices, joints=joints, weights=weights)
    return alone.pose(positions, rotations)[piece.faces]


def test_a_character_that_cannot_follow_another_skeleton_is_taken_off(clip, worn, monkeypatch):
    import viser

    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        scene = PageScene(server.scene)
        scene.set_skeleton(clip.skeleton)
        scene.wear(worn)

        def refuse(*_: Any) -> None:
            raise InputError("my rig.glb", "roles", "no left leg", "must have legs")

        monkeypatch.setattr(scenes, "LiveRetargeter", refuse)
        assert_refused(lambda: scene.set_skeleton(clip.skeleton), place="roles")
        assert scene.worn is None
        scene.draw(views(clip)[0], 0.1)
    finally:
        server.stop()


def test_pieces_move_as_the_whole_mesh(clip):
    mesh = grow_body(clip.skeleton)
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    whole = mesh.pose(positions[50], rotations[50])
    pieces = split_mesh(mesh)
    assert sum(len(piece.faces) for piece in pieces) == len(mesh.faces)
    for piece in pieces:
        faces = mesh.faces[(mesh.colours[mesh.faces[:, 0]] == piece.colour).all(axis=1)]
        assert np.allclose(posed(piece, mesh, positions[50], rotations[50]), whole[faces], atol=ROUNDED)


def test_joints_that_are_carried_need_no_bones(clip, worn):
    live = LiveRetargeter(clip.skeleton, worn)
    seen = live.retarget(views(clip)[60])
    carriers = live.retargeter.carriers
    every, fewer = split_mesh(worn.mesh), split_mesh(worn.mesh, carriers)
    assert set(np.concatenate([piece.bones for piece in fewer])) <= set(carriers)
    for piece, same in zip(every, fewer, strict=True):
        assert np.allclose(
            posed(piece, worn.mesh, seen.joints, seen.world_rotations),
            posed(same, worn.mesh, seen.joints, seen.world_rotations),
            atol=ROUNDED,
        )


def test_a_body_of_many_colours_keeps_few_bones(clip):
    mesh = grow_body(clip.skeleton)
    painted = replace(mesh, colours=np.random.default_rng(0).integers(0, 256, mesh.colours.shape).astype(np.uint8))
    assert 1 <= sum(len(piece.bones) for piece in split_mesh(painted)) <= MOST_BONES


class FakeScene:
    """Takes skinned meshes and the messages that move their bones."""

    def __init__(self) -> None:
        self.sent: list[Any] = []
        self.nodes: dict[str, Any] = {}

    def add_mesh_skinned(self, name: str, *_: Any, **options: Any) -> Any:
        self.nodes[name] = SimpleNamespace(name=name, visible=True, **options)
        return self.nodes[name]

    def _queue_scene_message(self, message: Any) -> None:
        self.sent.append(message)

    def taken(self) -> list[Any]:
        sent, self.sent = self.sent, []
        return sent


def test_only_bones_that_moved_are_sent(clip):
    scene: Any = FakeScene()
    body = SkinnedBody(scene, "/body")
    mesh = grow_body(clip.skeleton)
    body.show(mesh)
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    body.place(positions[0], rotations[0])
    assert scene.taken()
    body.place(positions[0], rotations[0])
    assert not scene.taken()
    turned = rotations[0].copy()
    joint = clip.skeleton.roles.head if clip.skeleton.roles else 0
    turned[joint] = quat_multiply(quat_from_axis_angle([0.0, 1.0, 0.0], 0.3), turned[joint])
    body.place(positions[0], turned)
    sent = scene.taken()
    bones = [piece.bones for piece in split_mesh(mesh)]
    assert sent and all(bones[int(each.name.rsplit("/")[-1])][each.bone_index] == joint for each in sent)


def test_nodes_of_a_larger_body_are_hidden_and_taken_again(clip, worn):
    """Viser's page ends when a skinned node is removed."""
    scene: Any = FakeScene()
    body = SkinnedBody(scene, "/body")
    body.show(grow_body(clip.skeleton))
    count = len(scene.nodes)
    plain = replace(worn.mesh, colours=np.zeros_like(worn.mesh.colours))
    body.show(plain)
    assert [node.visible for node in scene.nodes.values()] == [True] + [False] * (count - 1)
    body.show(grow_body(clip.skeleton))
    assert all(node.visible for node in scene.nodes.values()) and len(scene.nodes) == count


def test_poses_of_single_moments_equal_the_clip_on_level_ground(clip, worn):
    live = LiveRetargeter(clip.skeleton, worn)
    there = retarget(clip, worn.skeleton)
    expected = forward_kinematics(worn.skeleton, there.clip.root_positions, there.clip.rotations)[0]
    for view in views(clip):
        seen = live.retarget(view)
        assert np.allclose(seen.joints, expected[view.frame], atol=LEVEL), view.frame
        assert np.allclose(seen.root, there.scale * view.root, atol=EXACT)


def test_a_moment_between_steps_lies_between_their_poses(clip):
    first, second = views(clip)[30:32]
    between = replace(second, before=(first.joints, -first.world_rotations, first.root), share=0.25)
    for share, same in ((0.0, first), (1.0, second)):
        moment = at_moment(replace(between, share=share))
        assert np.allclose(moment.joints, same.joints, atol=EXACT)
        assert np.allclose(np.abs(np.sum(moment.world_rotations * same.world_rotations, axis=-1)), 1.0, atol=EXACT)
    moment = at_moment(between)
    assert np.allclose(moment.root, 0.75 * first.root + 0.25 * second.root, atol=EXACT)
    assert np.allclose(np.linalg.norm(moment.world_rotations, axis=-1), 1.0, atol=EXACT)


def test_the_camera_does_not_depend_on_the_number_of_pictures_and_never_overshoots():
    often, seldom = Spring(np.zeros(2), 0.1), Spring(np.zeros(2), 0.1)
    target = np.array([1.0, -2.0])
    for _ in range(30):
        before = often.value
        often.follow(target, 1 / 60)
        assert (np.abs(often.value - target) <= np.abs(before - target) + EXACT).all()
        assert (np.abs(often.value) <= np.abs(target) + EXACT).all()
    seldom.follow(target, 0.5)
    assert np.allclose(often.value, seldom.value, atol=EXACT)


def test_files_offer_what_they_hold(clip, character):
    assert read_content("C:\\a walk.BVH", bvh_text(clip).encode()) == FileContent("a walk", ("",), body=False)
    rig = FileContent("my rig", ("walk", "stroll"), body=True, whole=False)
    assert read_content("my rig.glb", character) == rig, "blink is too short"
    bare = glb_bytes(clip.skeleton, grow_body(clip.skeleton), {})
    assert read_content("bare.vrm", bare) == FileContent("bare", (), body=True)
    name, data = clip_as_bvh("my rig.glb", character, "stroll")
    assert name == "my rig stroll.bvh" and data.startswith(b"HIERARCHY")


def test_the_motion_that_is_offered_is_the_one_that_is_learned(clip, monkeypatch):
    """A walk that is too long to be offered is not what is learned in place of the motion that is."""
    turned = replace(clip, rotations=clip.rotations[::-1], root_positions=clip.root_positions[::-1])
    long = replace(
        clip, **{name: np.tile(getattr(clip, name), (25, 1, 1)[: getattr(clip, name).ndim]) for name in MOVED}
    )
    data = glb_bytes(clip.skeleton, grow_body(clip.skeleton), {"Walk": long, "Run": turned}, root_motion=True)
    content = read_content("both.glb", data)
    assert content == FileContent("both", ("Run",), body=True, whole=False)
    assert clip_bytes("both.glb", data, content, "Run") == clip_as_bvh("both.glb", data, "Run")
    assert check_clip("both.glb", data).name == "both Run"
    alone = glb_bytes(clip.skeleton, grow_body(clip.skeleton), {"Run": turned}, root_motion=True)
    content = read_content("one.glb", alone)
    assert clip_bytes("one.glb", alone, content, "Run") == ("one.glb", alone)
    monkeypatch.setattr(worn_character, "MOST_BYTES", len(alone) - 1)
    assert clip_bytes("one.glb", alone, content, "Run")[0] == "one Run.bvh", "large for its body, not for its motion"


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("bad.glb", b""),
        ("bad.glb", b"glTF\x02\0\0\0\xff\xff\xff\x7f"),
        ("bad.vrm", b"GIF89a"),
        ("bad.gltf", b'{"asset": {"version": "2.0"}, "buffers": [{"uri": "../secret.bin", "byteLength": 4}]}'),
        ("bad.gltf", b'{"asset": {"version": "2.0"}}'),
    ],
)
def test_other_files_are_refused_by_their_own_name(name, data):
    assert_refused(lambda: read_content(name, data), file=name)


def test_what_cannot_be_worn_is_refused(clip, character, monkeypatch):
    assert_refused(lambda: read_worn_character("walk.bvh", bvh_text(clip).encode()), file="walk.bvh", place="body")
    assert_refused(lambda: read_worn_character("walk.exe", b""), place="file name")
    monkeypatch.setattr(worn_character, "MOST_FACES", 10)
    assert_refused(lambda: read_worn_character("my rig.glb", character), file="my rig.glb", place="mesh")
    monkeypatch.setattr(worn_character, "MOST_CHARACTER_BYTES", 10)
    assert_refused(lambda: read_worn_character("my rig.glb", character), file="my rig.glb", place="size")


def test_a_recording_is_downloaded_on_the_body_or_the_worn_character(clip, worn, tmp_path):
    from pfnn_jax.motion.clip_files import read_clip

    for kind, body, scale in ((BVH, None, 1.0), (GLB, None, 1.0), (BVH, worn, GIANT), (GLB, worn, GIANT)):
        path = tmp_path / f"recording.{kind.lower()}"
        path.write_bytes(recording_bytes(replace(clip, style="mine"), kind, body))
        found = read_clip(path, travel="keep", clip_name="mine" if kind == GLB else None)
        assert found.num_frames == clip.num_frames
        travel = (found.root_positions[-1] - found.root_positions[0])[[0, 2]]
        expected = scale * (clip.root_positions[-1] - clip.root_positions[0])[[0, 2]]
        assert np.allclose(travel, expected, atol=LEVEL * scale), (kind, body)
