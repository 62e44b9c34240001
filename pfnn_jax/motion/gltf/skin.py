"""Reads the mesh of a glTF character as one skinned mesh in the bind pose, in metres."""

from __future__ import annotations

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.gltf.bind_pose import bind_matrices, mesh_nodes, read_skins
from pfnn_jax.motion.gltf.character import Character
from pfnn_jax.motion.gltf.colours import SEEN, Palette
from pfnn_jax.motion.gltf.geometry import Part, read_parts
from pfnn_jax.motion.gltf.nodes import read_nodes
from pfnn_jax.motion.kinematics import quat_rotate
from pfnn_jax.motion.skinned_mesh import SkinnedMesh, merge_meshes


def read_mesh(character: Character) -> SkinnedMesh:
    """Returns all meshes of a character as one, with the colours of materials and textures at the vertices.

    Meshes of the scene that hang on no joint, and invisible faces of transparent materials, are left out. Its joints
    are those of the character's skeleton, its bind rotations the zero pose.

    Raises:
        InputError: if the file is malformed, or shows no mesh on the character's joints.
    """
    document = character.document
    tree, skins = read_nodes(document), read_skins(document)
    bind = bind_matrices(tree, skins, mesh_nodes(document, len(skins)))
    parts = read_parts(document, tree, skins, bind, character.nodes.tolist())
    if not parts:
        raise InputError(document.path, "meshes", "none", "must have a mesh that follows the joints")
    palette = Palette(document)
    return merge_meshes([_mesh(character, part, palette) for part in parts])


def _mesh(character: Character, part: Part, palette: Palette) -> SkinnedMesh:
    """Returns a part in metres, with colours."""
    colours, opacity = palette.vertex_colours(part.primitive, len(part.vertices), part.place)
    faces = part.faces
    if opacity is not None:
        faces = faces[opacity[faces].max(axis=1) >= SEEN] if len(faces) else faces
    zero = np.zeros((len(character.nodes), 4))
    zero[:, 0] = 1.0
    return SkinnedMesh(
        vertices=character.placement.to_ours(part.vertices),
        normals=quat_rotate(character.placement.rotation, part.normals),
        faces=faces,
        joints=part.joints,
        weights=part.weights,
        colours=colours,
        bind_positions=character.bind_positions,
        bind_rotations=zero,
    )
