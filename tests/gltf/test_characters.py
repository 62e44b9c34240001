"""Rigged characters of glTF files: joints, bind poses, humanoid maps and meshes."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.nodes import read_nodes
from pfnn_jax.motion.gltf.skin import read_mesh
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.humanoid.tree import joint_tree
from pfnn_jax.motion.kinematics import quat_from_axis_angle
from pfnn_jax.motion.skeleton import rest_pose
from tests.gltf.rigs import NAMES, as_matrix, make_rig, places
from tests.motion.expected_maps import CHARACTERS

DIGITS = 2e-5
"""Units of the file; the table of joints has five digits."""

ROUNDING = 1e-5
"""Metres; files hold float32."""

SAVED_IN_A_CLIP = ("mixamo_toram", "quaternius_adventurer", "quaternius_platformer", "ue_mannequiny")
"""Characters whose nodes stand in the middle of a clip. The file does not state where their bind pose stands in the
scene: the table's differs from ours by a rigid motion."""

OTHER_BIND = ("rigify_lumberjack",)
"""Characters whose controls have one and the same inverse bind matrix, which the table takes as it is."""

STANDS = 0.02
"""Metres of the lowest vertex above or below the ground."""


@pytest.fixture(scope="module")
def read(characters):
    """Returns a character by name, read once."""
    found = {}

    def read_once(name):
        if name not in found:
            found[name] = read_character(characters / f"{name}.glb")
        return found[name]

    return read_once


@pytest.fixture(scope="module")
def table(characters):
    return json.loads((characters / "joints.json").read_text())["files"]


@pytest.mark.parametrize("name", CHARACTERS)
def test_joints_of_real_characters_stand_where_the_table_says(name, read, table):
    character, joints = read(name), table[name]["joints"]
    rows = {int(node): row for row, node in enumerate(character.nodes)}
    assert set(rows) >= {joint["node"] for joint in joints}
    world = read_nodes(character.document).world()[:, :3, 3]
    assert np.allclose([world[joint["node"]] for joint in joints], [joint["rest"] for joint in joints], atol=DIGITS)
    known = [joint for joint in joints if joint.get("bind") is not None]
    bind = np.array([joint["bind"] for joint in known])
    ours = character.bind_positions[[rows[joint["node"]] for joint in known]]
    ours = (ours - character.placement.translation) / character.placement.scale
    if name in SAVED_IN_A_CLIP:
        assert np.allclose(_distances(ours), _distances(bind), atol=3 * DIGITS)
    elif name not in OTHER_BIND:
        turned = character.placement.to_ours(bind) - character.placement.translation
        assert np.allclose(ours, turned / character.placement.scale, atol=DIGITS)


@pytest.mark.parametrize("name", CHARACTERS)
def test_the_map_of_real_characters(name, read, table):
    character = read(name)
    body = character.skeleton.humanoid
    if name == "derived_noname":  # whose nodes are those of another file, which has names
        names = {joint["node"]: joint["name"] for joint in table["ue_mannequin_f"]["joints"]}
        wanted = {**CHARACTERS["ue_mannequin_f"]}
        found = body.names(tuple(names[int(node)] for node in character.nodes))
        limbs = [bone for bone in wanted if bone not in ("spine", "neck", "head")]
        assert {bone: found[bone] for bone in limbs} == {bone: wanted[bone] for bone in limbs}
    else:
        names = {joint["node"]: joint["name"] for joint in table[name]["joints"]}
        assert body.names(tuple(names.get(int(node), "") for node in character.nodes)) == CHARACTERS[name]


@pytest.mark.parametrize("name", CHARACTERS)
def test_real_characters_stand_on_the_ground_and_face_forward(name, read):
    character = read(name)
    skeleton, body = character.skeleton, character.skeleton.humanoid
    assert (
        len(set(skeleton.names)) == skeleton.num_joints
        and (skeleton.parents[1:] < np.arange(1, len(skeleton.names))).all()
    )
    assert np.allclose(rest_pose(skeleton) + character.bind_positions[0], character.bind_positions, atol=ROUNDING)
    across = character.bind_positions[body.left_upper_arm] - character.bind_positions[body.right_upper_arm]
    assert across[0] > 0.98 * np.linalg.norm(across)
    mesh = read_mesh(character)
    height = np.ptp(mesh.vertices[:, 1])
    assert abs(mesh.vertices[:, 1].min()) < STANDS * height
    assert 0.8 < height < 6.0  # metres; two are giants, whose files say so
    tree = joint_tree(tuple(skeleton.parents.tolist()))
    for side in ("left", "right"):
        foot = getattr(body, f"{side}_foot")
        assert foot is None or tree.is_above(getattr(body, f"{side}_shin"), foot)


@pytest.mark.parametrize("name", CHARACTERS)
def test_meshes_of_real_characters_move_with_their_joints(name, read):
    character = read(name)
    mesh = read_mesh(character)
    still = np.zeros((len(character.nodes), 4))
    still[:, 0] = 1.0
    assert np.allclose(mesh.pose(character.bind_positions, still), mesh.vertices, atol=1e-9)
    assert np.allclose(mesh.weights.sum(axis=1), 1.0) and mesh.weights.min() >= 0.0
    assert mesh.joints.max() < len(character.nodes) and mesh.faces.max() < len(mesh.vertices)
    # vertices are near the joint that moves them most, apart from what a hand holds
    apart = np.linalg.norm(mesh.vertices - character.bind_positions[mesh.joints[:, 0]], axis=1)
    assert np.percentile(apart, 90) < 0.5 * np.ptp(mesh.vertices[:, 1])


def test_a_rig_is_read_as_it_was_made(tmp_path):
    character = read_character(make_rig().write(tmp_path / "a.glb"))
    assert character.notes == ()
    assert np.allclose(_by_name(character), places(), atol=ROUNDING)
    assert character.skeleton.roles is not None


@pytest.mark.parametrize("scale", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("kind", ["matrix", "trs"])
def test_an_armature_scaled_and_turned_leaves_the_character_the_same(tmp_path, scale, kind):
    """The nodes are in units of 1 / scale under an armature that turns them a quarter about X."""
    quarter = quat_from_axis_angle(np.array([1.0, 0.0, 0.0]), np.array(np.pi / 2))
    back = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # the quarter undone

    def under_armature(data):
        for node in data["nodes"][: len(NAMES)]:
            node["translation"] = (back @ np.array(node["translation"]) / scale).tolist()
        armature = {"children": [0], "name": "Armature"}
        if kind == "matrix":
            armature["matrix"] = as_matrix(quarter, np.zeros(3), scale)
        else:
            armature |= {"rotation": np.roll(quarter, -1).tolist(), "scale": [scale] * 3}
        data["nodes"].append(armature)

    rig = make_rig(under_armature)
    bind = np.tile(np.eye(4), (len(NAMES), 1, 1))
    bind[:, :3, :3] = scale * np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    bind[:, :3, 3] = places()
    inverse = np.linalg.inv(bind).swapaxes(1, 2).astype(np.float32)
    rig.json["skins"][0]["inverseBindMatrices"] = rig.add(inverse.reshape(-1, 16), "MAT4")
    character = read_character(rig.write(tmp_path / "a.glb"))
    assert np.allclose(_by_name(character), places(), atol=10 * ROUNDING)  # as float32 loses at a scale of 100
    assert np.allclose(character.placement.scale, 1.0)


@pytest.mark.parametrize("yaw", [0.0, 90.0, 180.0, -90.0, 30.0])
def test_a_character_is_turned_to_face_forward(tmp_path, yaw):
    turn = quat_from_axis_angle(np.array([0.0, 1.0, 0.0]), np.radians(yaw))

    def turned(data):
        data["nodes"].append({"children": [0], "rotation": np.roll(turn, -1).tolist()})
        del data["skins"][0]["inverseBindMatrices"]
        data["nodes"][len(NAMES)].pop("skin")

    character = read_character(make_rig(turned).write(tmp_path / "a.glb"))
    body = need_humanoid(character.skeleton)
    across = character.bind_positions[body.left_thigh] - character.bind_positions[body.right_thigh]
    assert np.allclose(across / np.linalg.norm(across), [1.0, 0.0, 0.0], atol=ROUNDING)


def test_feet_under_the_root_are_put_under_the_legs(tmp_path):
    def under_root(data):
        world = dict(zip(NAMES, places(), strict=True))
        for side in ("Left", "Right"):
            foot, leg = NAMES.index(f"{side}Foot"), NAMES.index(f"{side}Leg")
            data["nodes"][leg].pop("children")
            data["nodes"][0]["children"].append(foot)
            data["nodes"][foot]["translation"] = world[f"{side}Foot"].tolist()

    skeleton = read_character(make_rig(under_root).write(tmp_path / "a.glb")).skeleton
    body = need_humanoid(skeleton)
    assert skeleton.parents[body.left_foot] == body.left_shin
    assert skeleton.parents[body.right_foot] == body.right_shin


def test_joints_without_names_and_with_the_same_name_get_names_of_their_own(tmp_path):
    def rename(data):
        data["nodes"][NAMES.index("Spine")]["name"] = "Hips"
        del data["nodes"][NAMES.index("LeftToeBase")]["name"]

    names = read_character(make_rig(rename).write(tmp_path / "a.glb")).skeleton.names
    assert len(set(names)) == len(names) and all(names)


def test_a_giant_without_a_unit_is_made_a_person(tmp_path):
    rig = make_rig()
    for node in rig.json["nodes"][: len(NAMES)]:
        node["translation"] = [100 * value for value in node["translation"]]
    del rig.json["skins"][0]["inverseBindMatrices"]
    path = rig.write(tmp_path / "a.glb")
    character = read_character(path)
    assert np.isclose(character.placement.scale, 0.85 / 80) and any("--unit" in note for note in character.notes)
    assert np.isclose(read_character(path, unit=0.01).placement.scale, 0.01)


def test_rigid_parts_follow_the_joint_that_they_hang_on(tmp_path):
    def rigid(data):
        body = data["nodes"][len(NAMES)]
        body.pop("skin")
        data["nodes"][NAMES.index("LeftHand")]["children"] = [len(NAMES)]

    mesh = read_mesh(character := read_character(make_rig(rigid).write(tmp_path / "a.glb")))
    assert (mesh.joints[:, 0] == character.skeleton.names.index("LeftHand")).all()


def test_colours_are_those_of_the_material(tmp_path):
    def coloured(data):
        data["materials"] = [{"pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.0, 0.2158605, 1.0]}}]
        data["meshes"][0]["primitives"][0]["material"] = 0

    mesh = read_mesh(read_character(make_rig(coloured).write(tmp_path / "a.glb")))
    assert np.unique(mesh.colours, axis=0).tolist() == [[255, 0, 128]]


def _by_name(character):
    """Returns the joints [J, 3] of a made rig in its own order."""
    return character.bind_positions[[character.skeleton.names.index(name) for name in NAMES]]


def _distances(points):
    return np.linalg.norm(points[:, None] - points[None], axis=-1)
