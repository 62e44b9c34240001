"""Writes a GLB file of a skeleton, its body and its motion: for those who have no character of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax import __version__
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.append import FLOAT, Animation, append_clips
from pfnn_jax.motion.gltf.channels import clip_channels
from pfnn_jax.motion.gltf.character import Character, Placement
from pfnn_jax.motion.gltf.container import Document
from pfnn_jax.motion.gltf.srgb import to_linear
from pfnn_jax.motion.kinematics import quat_conjugate, quat_multiply, quat_rotate, quat_to_matrix
from pfnn_jax.motion.root_motion import split_root
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.skinned_mesh import SkinnedMesh, unit_normals

ROOT = "root"
"""Name of the joint on the ground above the hips, which carries root motion: Unreal wants one."""

_UBYTE, _USHORT, _UINT = 5121, 5123, 5125
_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
_ROUGHNESS = 0.8  # of clothes: a mannequin that shines looks like plastic


def glb_bytes(
    skeleton: Skeleton, mesh: SkinnedMesh, clips: Mapping[str, MotionClip], *, root_motion: bool = False
) -> bytes:
    """Returns a GLB file with a skinned body and its clips.

    Args:
        skeleton: J joints.
        mesh: its body.
        clips: motion on the skeleton, by name.
        root_motion: let the root joint travel; otherwise all clips are in place.
    """
    return character_bytes(new_character(skeleton, mesh), clips, root_motion=root_motion)


def character_bytes(character: Character, clips: Mapping[str, MotionClip], *, root_motion: bool = False) -> bytes:
    """Returns the GLB file of a character with clips appended, which are on its skeleton; arguments as `glb_bytes`."""
    animations = []
    for name, clip in clips.items():
        root, in_place = split_root(clip)
        channels = clip_channels(character, in_place, root if root_motion else None)
        animations.append(Animation(name, clip.fps, channels))
    return append_clips(character.document, animations)


def new_character(skeleton: Skeleton, mesh: SkinnedMesh) -> Character:
    """Returns a character without clips: a joint on the ground, the skeleton under it, and its body.

    The pose of its nodes is that in which the mesh was made, with its lowest vertex on the ground and the hips above
    the origin.
    """
    mesh = _grounded(skeleton, mesh)
    data, binary = _document(skeleton, mesh)
    document = Document(Path("body.glb"), data, binary, (binary,))
    placement = Placement(1.0, _IDENTITY, np.zeros(3))
    nodes = 1 + np.arange(skeleton.num_joints)
    rotations = np.tile(_IDENTITY, (skeleton.num_joints, 1))
    return Character(document, skeleton, nodes, mesh.bind_positions, rotations, placement, ())


def _grounded(skeleton: Skeleton, mesh: SkinnedMesh) -> SkinnedMesh:
    """Returns the mesh moved such that it stands on the ground above the origin."""
    hips = 0 if skeleton.humanoid is None else skeleton.humanoid.hips
    place = mesh.bind_positions[hips] * np.array([1.0, 0.0, 1.0]) + np.array([0.0, mesh.vertices[:, 1].min(), 0.0])
    return replace(mesh, vertices=mesh.vertices - place, bind_positions=mesh.bind_positions - place)


class _Binary:
    """Collects arrays in one buffer, and their views and accessors."""

    def __init__(self) -> None:
        self.content = b""
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: np.ndarray, component: int, kind: str, target: int | None = None) -> int:
        """Adds values and returns the index of their accessor."""
        content = np.ascontiguousarray(values).tobytes()
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": len(content)}
        self.views.append({**view, "target": target} if target else view)
        self.content += content + b"\0" * (-len(content) % 4)
        accessor = {"bufferView": len(self.views) - 1, "componentType": component, "count": len(values), "type": kind}
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def _document(skeleton: Skeleton, mesh: SkinnedMesh) -> tuple[dict[str, Any], bytes]:
    """Returns the JSON and the binary chunk of a file with skeleton and body."""
    binary = _Binary()
    colours, kinds = np.unique(mesh.colours, axis=0, return_inverse=True)
    kinds = kinds.ravel()
    shown = np.unique(kinds[mesh.faces[:, 0]])  # a colour may be on no face's first vertex
    primitives = [_primitive(binary, mesh, kinds, int(number)) for number in shown]
    joints = list(range(skeleton.num_joints + 1))
    bind = {"inverseBindMatrices": binary.add(_inverse_binds(mesh), FLOAT, "MAT4"), "joints": joints, "skeleton": 0}
    nodes = [*_joints(skeleton, mesh), {"name": "body", "mesh": 0, "skin": 0}]
    data = {
        "asset": {"version": "2.0", "generator": f"pfnn_jax {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0, len(nodes) - 1]}],
        "nodes": nodes,
        "skins": [{"name": "body", **bind}],
        "meshes": [{"name": "body", "primitives": primitives}],
        "materials": [_material(colour) for colour in colours],
        "buffers": [{"byteLength": len(binary.content)}],
        "bufferViews": binary.views,
        "accessors": binary.accessors,
    }
    return data, binary.content


def _joints(skeleton: Skeleton, mesh: SkinnedMesh) -> list[dict[str, Any]]:
    """Returns the nodes of the joints in the mesh's pose, under a root on the ground."""
    name = ROOT if ROOT not in skeleton.names else f"{ROOT}_motion"
    nodes: list[dict[str, Any]] = [{"name": name, "children": [1]}]
    for joint, parent in enumerate(skeleton.parents):
        offset, turn = mesh.bind_positions[joint], mesh.bind_rotations[joint]
        if parent >= 0:
            back = quat_conjugate(mesh.bind_rotations[parent])
            offset, turn = quat_rotate(back, offset - mesh.bind_positions[parent]), quat_multiply(back, turn)
        pose = {"translation": _plain(offset), "rotation": _plain(np.roll(turn, -1))}
        children = (1 + np.flatnonzero(skeleton.parents == joint)).tolist()
        nodes.append({"name": skeleton.names[joint], **pose, **({"children": children} if children else {})})
    return nodes


def _inverse_binds(mesh: SkinnedMesh) -> np.ndarray:
    """Returns the inverse bind matrices [1 + J, 4, 4] of the root and the joints, by columns as glTF wants them."""
    back = quat_conjugate(mesh.bind_rotations)
    matrices = np.tile(np.eye(4), (1 + len(back), 1, 1))
    matrices[1:, :3, :3] = quat_to_matrix(back)
    matrices[1:, :3, 3] = -quat_rotate(back, mesh.bind_positions)
    return np.swapaxes(matrices, 1, 2).astype("<f4")


def _primitive(binary: _Binary, mesh: SkinnedMesh, kinds: np.ndarray, number: int) -> dict[str, Any]:
    """Returns the faces of one colour, whose number is that of their material."""
    faces = mesh.faces[kinds[mesh.faces[:, 0]] == number]
    used, indices = np.unique(faces, return_inverse=True)
    positions = mesh.vertices[used].astype("<f4")
    weights = mesh.weights[used].astype("<f4")
    joints = np.where(weights > 0, 1 + mesh.joints[used], 0)
    small = joints.max(initial=0) < 256
    attributes = {
        "POSITION": binary.add(positions, FLOAT, "VEC3", _ARRAY_BUFFER),
        "NORMAL": binary.add(unit_normals(mesh.normals[used]).astype("<f4"), FLOAT, "VEC3", _ARRAY_BUFFER),
        "JOINTS_0": binary.add(
            joints.astype("<u1" if small else "<u2"), _UBYTE if small else _USHORT, "VEC4", _ARRAY_BUFFER
        ),
        "WEIGHTS_0": binary.add(weights, FLOAT, "VEC4", _ARRAY_BUFFER),
    }
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    binary.accessors[attributes["POSITION"]] |= bounds
    wide = len(used) > 65535
    rows = indices.ravel().astype("<u4" if wide else "<u2")
    corners = binary.add(rows, _UINT if wide else _USHORT, "SCALAR", _ELEMENT_ARRAY_BUFFER)
    return {"attributes": attributes, "indices": corners, "material": number}


def _material(colour: np.ndarray) -> dict[str, Any]:
    """Returns a material of a colour [3] in sRGB; glTF states colours in linear light."""
    linear = _plain(to_linear(colour / 255.0))
    surface = {"baseColorFactor": [*linear, 1.0], "metallicFactor": 0.0, "roughnessFactor": _ROUGHNESS}
    return {"pbrMetallicRoughness": surface}


def _plain(values: Sequence[float] | np.ndarray) -> list[float]:
    return [round(float(value), 9) for value in values]
