"""The body of a character's own file, for a clip that was read from it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.clip_files import is_character_file
from pfnn_jax.motion.skinned_mesh import SkinnedMesh


def own_mesh(path: str | Path, clip: MotionClip) -> SkinnedMesh | None:
    """Returns the mesh of a file of glTF, moved by the joints of a clip from it; None if the file has none.

    Args:
        path: the file.
        clip: a clip of this file, whose skeleton begins at the hips.
    """
    if not is_character_file(path):
        return None
    from pfnn_jax.motion.gltf.character import read_character  # with Pillow, which clips of BVH files do not need
    from pfnn_jax.motion.gltf.clips import below_hips
    from pfnn_jax.motion.gltf.skin import read_mesh

    try:
        character = read_character(path)
        mesh = read_mesh(character)
    except InputError:  # it holds motion alone
        return None
    part, kept = below_hips(character.skeleton)
    if part.names != clip.skeleton.names:
        return None
    sizes = [float(np.linalg.norm(skeleton.offsets, axis=-1).sum()) for skeleton in (clip.skeleton, part)]
    return mesh_on(mesh, kept, sizes[0] / sizes[1] if sizes[1] > 0 else 1.0)


def mesh_on(mesh: SkinnedMesh, kept: np.ndarray, scale: float = 1.0) -> SkinnedMesh:
    """Returns a mesh that follows only some of its joints; what follows another one follows the first of them.

    Args:
        mesh: on J joints.
        kept: [K] indices of the joints, which are joints 0 to K - 1 of the result.
        scale: that of the result, as where a clip was read with another unit than its character.
    """
    rows = np.zeros(len(mesh.bind_positions), int)
    rows[kept] = np.arange(len(kept))
    return replace(
        mesh,
        vertices=scale * mesh.vertices,
        joints=rows[mesh.joints],
        bind_positions=scale * mesh.bind_positions[kept],
        bind_rotations=mesh.bind_rotations[kept],
    )
