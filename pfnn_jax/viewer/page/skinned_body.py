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
"""Colours in which a body is drawn, at most."""

BODY = "/world/body"
"""Node of the page's body. Those of its colours hang below, see `node_names`."""

MOST_BONES = 63
"""Bones of all its colours together: viser sends up to 128 messages at once, and a pose in parts would tear. A body
with textures, where many joints move every colour, is drawn in fewer colours."""

ROUNDS = 8  # of k-means, after which colours hardly change

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


def node_names(body: str = BODY) -> tuple[str, ...]:
    """Returns the names of all nodes that a body can have, one for each colour."""
    return tuple(f"{body}/{number}" for number in range(MOST_COLOURS))


def split_mesh(mesh: SkinnedMesh, carriers: np.ndarray | None = None) -> list[Piece]:
    """Returns the pieces of a mesh, one for each colour.

    Args:
        mesh: V vertices on J joints.
        carriers: [J] joint with which each moves rigidly, as it does in the bind pose; by default itself. Fingers that
            are never moved need no bones of their own then.
    """
    carriers = np.arange(len(mesh.bind_positions)) if carriers is None else carriers
    weights = _carried_weights(mesh, carriers)
    of_face = mesh.colours[mesh.faces].astype(float).mean(axis=1)
    pieces: list[Piece] = []
    for count in range(MOST_COLOURS, 0, -1):
        colours, nearest = _few_colours(of_face, count)
        pieces = [_piece(mesh, mesh.faces[nearest == number], weights, c) for number, c in enumerate(colours)]
        if sum(len(piece.bones) for piece in pieces) <= MOST_BONES:
            break
    return pieces


def _few_colours(colours: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns at most some colours [C, 3] for those of faces [F, 3], by k-means, and which of them each face has [F].

    They begin with the most frequent colour, then each with the one that is farthest from all before.
    """
    different, inverse, counts = np.unique(colours, axis=0, return_inverse=True, return_counts=True)
    chosen = different[[np.argmax(counts)]]
    while len(chosen) < min(most, len(different)):
        apart = np.linalg.norm(different[:, None] - chosen, axis=-1).min(axis=1)
        chosen = np.concatenate([chosen, different[[np.argmax(apart)]]])
    for _ in range(ROUNDS):
        nearest = np.linalg.norm(different[:, None] - chosen, axis=-1).argmin(axis=1)
        sums = np.zeros_like(chosen)
        np.add.at(sums, nearest, different * counts[:, None])
        total = np.bincount(nearest, counts, len(chosen))[:, None]
        chosen = np.where(total > 0, sums / np.maximum(total, 1.0), chosen)
    nearest = np.linalg.norm(different[:, None] - chosen, axis=-1).argmin(axis=1)
    used, nearest = np.unique(nearest, return_inverse=True)
    return chosen[used], nearest.reshape(-1)[inverse.reshape(-1)]


def _carried_weights(mesh: SkinnedMesh, carriers: np.ndarray) -> np.ndarray:
    """Returns weights [V, J]: the four largest, with sum one, after those of carried joints went to their carriers."""
    count = len(mesh.vertices)
    weights = np.zeros((count, len(carriers)))
    np.add.at(weights, (np.arange(count)[:, None], carriers[mesh.joints]), mesh.weights)
    if weights.shape[1] > 4:
        weights[weights < np.partition(weights, -4, axis=1)[:, -4:-3]] = 0.0
    return weights / weights.sum(axis=1, keepdims=True)


def _piece(mesh: SkinnedMesh, faces: np.ndarray, weights: np.ndarray, colour: np.ndarray) -> Piece:
    used = np.unique(faces)
    places = np.concatenate([np.round(mesh.vertices[used], 5), np.round(mesh.normals[used] / ALIKE)], axis=1)
    _, first, merged = np.unique(places, axis=0, return_index=True, return_inverse=True)
    number = np.zeros(len(mesh.vertices), int)
    number[used] = merged.reshape(-1)
    kept = used[first]
    bones = np.flatnonzero(weights[kept].any(axis=0))
    red, green, blue = np.rint(colour).astype(int).tolist()
    return Piece((red, green, blue), mesh.vertices[kept], number[faces], bones, weights[np.ix_(kept, bones)])


class SkinnedBody:
    """A body in a scene, of which another mesh can take the place.

    Args:
        scene: the tab's.
        name: of the node that it hangs below.
    """

    def __init__(self, scene: viser.SceneApi, name: str) -> None:
        # Viser's bone handles compare each value with the last before they queue these messages, which takes four times
        # as long as all the rest of drawing.
        from viser._messages import SetBoneOrientationMessage, SetBonePositionMessage

        self._turn, self._shift = SetBoneOrientationMessage, SetBonePositionMessage
        self._scene, self._name, self._zoom = scene, name, 1.0
        self._nodes: list[Any] = []
        self._bones: list[np.ndarray] = []
        self._rotations, self._positions = np.zeros((0, 4)), np.zeros((0, 3))

    def show(self, mesh: SkinnedMesh, carriers: np.ndarray | None = None, zoom: float = 1.0) -> None:
        """Replaces the body, which stands in its bind pose until `place` is called.

        Nodes take other meshes or are hidden, and never removed: that ends viser's page.

        Args:
            mesh: the body.
            carriers: as in `split_mesh`.
            zoom: factor on all positions.
        """
        pieces = split_mesh(mesh, carriers)
        shown = [
            self._scene.add_mesh_skinned(
                node,
                zoom * piece.vertices,
                piece.faces,
                bone_wxyzs=mesh.bind_rotations[piece.bones],
                bone_positions=zoom * mesh.bind_positions[piece.bones],
                skin_weights=piece.weights,
                color=piece.colour,
                side="double",  # hair, capes and hats are often open
                receive_shadow=False,  # its own shadow would look speckled
            )
            for node, piece in zip(node_names(self._name), pieces, strict=False)
        ]
        for node in self._nodes[len(shown) :]:
            node.visible = False
        self._nodes = [*shown, *self._nodes[len(shown) :]]
        self._bones, self._zoom = [piece.bones for piece in pieces], zoom
        self._rotations, self._positions = np.array(mesh.bind_rotations, float), np.array(mesh.bind_positions, float)

    def place(self, positions: np.ndarray, rotations: np.ndarray) -> None:
        """Moves the bones that have moved since they were sent last.

        Args:
            positions: [J, 3] metres.
            rotations: [J, 4] of the joints' frames.
        """
        turned = np.abs(rotations - self._rotations).max(axis=1) > TURNED
        shifted = np.abs(positions - self._positions).max(axis=1) > SHIFTED
        self._rotations[turned], self._positions[shifted] = rotations[turned], positions[shifted]
        send = self._scene._queue_scene_message
        for node, bones in zip(self._nodes, self._bones, strict=False):
            for bone, joint in enumerate(bones):
                if turned[joint]:
                    send(self._turn(node.name, bone, tuple(rotations[joint].tolist())))
                if shifted[joint]:
                    send(self._shift(node.name, bone, tuple((self._zoom * positions[joint]).tolist())))
