"""The body of a character's own file, for a clip that was read from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.clips import below_hips
from pfnn_jax.motion.gltf.skin import read_mesh
from pfnn_jax.motion.skinned_mesh import SkinnedMesh

SUFFIXES = (".glb", ".gltf", ".vrm")


def own_mesh(path: str | Path, clip: MotionClip) -> SkinnedMesh | None:
    """Returns the mesh of a file of glTF, moved by the joints of a clip from it; None if the file has none.

    Args:
        path: the file.
        clip: a clip of this file, whose skeleton begins at the hips.
    """
    if Path(path).suffix.lower() not in SUFFIXES:
        return None
    try:
        character = read_character(path)
        mesh = read_mesh(character)
    except InputError:  # it holds motion alone
        return None
    part, kept = below_hips(character.skeleton)
    return mesh_on(mesh, kept) if part.names == clip.skeleton.names else None


def mesh_on(mesh: SkinnedMesh, kept: np.ndarray) -> SkinnedMesh:
    """Returns a mesh that follows only some of its joints; what follows another one follows the first of them.

    Args:
        mesh: on J joints.
        kept: [K] indices of the joints, which are joints 0 to K - 1 of the result.
    """
    rows = np.zeros(len(mesh.bind_positions), int)
    rows[kept] = np.arange(len(kept))
    return replace(
        mesh,
        joints=rows[mesh.joints],
        bind_positions=mesh.bind_positions[kept],
        bind_rotations=mesh.bind_rotations[kept],
    )
