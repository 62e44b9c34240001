"""A skinned body in the page's scene: a mesh for each of a few colours, whose bones are sent only when they move.

Viser draws a skinned mesh in one colour, blends four bones a vertex, and takes two messages for each bone and pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pfnn_jax.motion.skinned_mesh import SkinnedMesh

if TYPE_CHECKING:
    import viser

MOST_COLOURS = 8
"""Colours in which a body is drawn; those of a character with more are replaced by their nearest."""

TURNED, SHIFTED = np.radians(0.01) / 2, 1e-4
"""Change of a bone's quaternion, and of its position in metres, up to which it is not sent."""

ALIKE = 0.35
"""Distance of unit normals up to which vertices at one place are drawn as one, so that no seam of a texture shows."""


@dataclass(frozen=True, eq=False)
class Piece:
    """The part of a mesh that has one colour.

    Attributes:
        colour: red, green, blue in 0..255.
        vertices: [V, 3] metres in the bind pose.
        faces: [F, 3].
        bones: [B] the joints that move it.
        weights: [V, B] with at most four above 0 in a row, which sum to one.
    """

    colour: tuple[int, int, int]
    vertices: np.ndarray
    faces: np.ndarray
    bones: np.ndarray
    weights: np.ndarray


def split_mesh(mesh: SkinnedMesh, carriers: np.ndarray | None = None) -> list[Piece]:
    """Returns the pieces of a mesh, one for each colour.

    Args:
        mesh: V vertices on J joints.
        carriers: [J] joint with which each moves rigidly, as it does in the bind pose; by default itself. Fingers that
            are never moved need no bones of their own then.
    """
    carriers = np.arange(len(mesh.bind_positions)) if carriers is None else carriers
    colours, of_face = _few_colours(mesh.colours[mesh.faces[:, 0]])
    weights = _carried_weights(mesh, carriers)
    return [_piece(mesh, mesh.faces[of_face == number], weights, colour) for number, colour in enumerate(colours)]


def _few_colours(colours: np.ndarray) -> tuple[list[tuple[int, int, int]], np.ndarray]:
    """Returns the most frequent colours of faces [F, 3], at most `MOST_COLOURS`, and the nearest of each face [F]."""
    different, first, counts = np.unique(colours, axis=0, return_inverse=True, return_counts=True)
    kept = different[np.argsort(-counts, kind="stable")[:MOST_COLOURS]].astype(float)
    apart = np.linalg.norm(different[:, None].astype(float) - kept, axis=-1)
    red_green_blue = [(int(colour[0]), int(colour[1]), int(colour[2])) for colour in kept]
    return red_green_blue, apart.argmin(axis=1)[first.reshape(-1)]


def _carried_weights(mesh: SkinnedMesh, carriers: np.ndarray) -> np.ndarray:
    """Returns weights [V, J]: the four largest, with sum one, after those of carried joints went to their carriers."""
    count = len(mesh.vertices)
    weights = np.zeros((count, len(carriers)))
    np.add.at(weights, (np.arange(count)[:, None], carriers[mesh.joints]), mesh.weights)
    if weights.shape[1] > 4:
        weights[weights < np.partition(weights, -4, axis=1)[:, -4:-3]] = 0.0
    return weights / weights.sum(axis=1, keepdims=True)


def _piece(mesh: SkinnedMesh, faces: np.ndarray, weights: np.ndarray, colour: tuple[int, int, int]) -> Piece:
    used = np.unique(faces)
    places = np.concatenate([np.round(mesh.vertices[used], 5), np.round(mesh.normals[used] / ALIKE)], axis=1)
    _, first, merged = np.unique(places, axis=0, return_index=True, return_inverse=True)
    number = np.zeros(len(mesh.vertices), int)
    number[used] = merged.reshape(-1)
    kept = used[first]
    bones = np.flatnonzero(weights[kept].any(axis=0))
    return Piece(colour, mesh.vertices[kept], number[faces], bones, weights[np.ix_(kept, bones)])


class SkinnedBody:
    """A body in a scene.

    Args:
        scene: the tab's.
        name: of the node that it hangs below.
        mesh: the body.
        carriers: as in `split_mesh`.
        zoom: factor on all positions.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        mesh: SkinnedMesh,
        carriers: np.ndarray | None = None,
        zoom: float = 1.0,
    ) -> None:
        # Viser's bone handles compare each value with the last before they queue these messages, which takes four times
        # as long as all the rest of drawing.
        from viser._messages import SetBoneOrientationMessage, SetBonePositionMessage

        self._turn, self._shift = SetBoneOrientationMessage, SetBonePositionMessage
        self._zoom = zoom
        self._meshes: list[tuple[Any, np.ndarray]] = []
        for number, piece in enumerate(split_mesh(mesh, carriers)):
            handle = scene.add_mesh_skinned(
                f"{name}/{number}",
                zoom * piece.vertices,
                piece.faces,
                bone_wxyzs=mesh.bind_rotations[piece.bones],
                bone_positions=zoom * mesh.bind_positions[piece.bones],
                skin_weights=piece.weights,
                color=piece.colour,
                receive_shadow=False,  # its own shadow would look speckled
            )
            self._meshes.append((handle, piece.bones))
        self._rotations = np.array(mesh.bind_rotations, float)
        self._positions = np.array(mesh.bind_positions, float)

    def place(self, positions: np.ndarray, rotations: np.ndarray) -> None:
        """Moves the bones that have moved since they were sent last.

        Args:
            positions: [J, 3] metres.
            rotations: [J, 4] of the joints' frames.
        """
        turned = np.abs(rotations - self._rotations).max(axis=1) > TURNED
        shifted = np.abs(positions - self._positions).max(axis=1) > SHIFTED
        self._rotations[turned], self._positions[shifted] = rotations[turned], positions[shifted]
        for handle, bones in self._meshes:
            send = handle._impl.api._queue_scene_message
            for bone, joint in enumerate(bones):
                if turned[joint]:
                    send(self._turn(handle.name, bone, tuple(rotations[joint].tolist())))
                if shifted[joint]:
                    send(self._shift(handle.name, bone, tuple((self._zoom * positions[joint]).tolist())))

    def remove(self) -> None:
        """Removes it from the scene."""
        for handle, _ in self._meshes:
            handle.remove()
