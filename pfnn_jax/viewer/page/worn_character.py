"""Characters to wear: what a file holds, and the motion of a tab's character on the body of another.

As in `uploads`, a browser sends bytes and a name. They are read as glTF and as nothing else, by a reader that takes
nothing from outside the temporary folder of the file.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.gltf.animations import Track, choose_clip, clip_names, read_tracks
from pfnn_jax.motion.gltf.character import read_character
from pfnn_jax.motion.gltf.container import read_document
from pfnn_jax.motion.gltf.skin import read_mesh
from pfnn_jax.motion.retargeting.retarget import Retargeter, make_retargeter, stance_frames
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.viewer.page import background
from pfnn_jax.viewer.page.recording import bvh_bytes
from pfnn_jax.viewer.page.uploads import (
    LONGEST,
    MOST_BYTES,
    MOST_CHARACTER_BYTES,
    MOST_FRAMES,
    check_size,
    style_name,
    suffix_of,
)
from pfnn_jax.viewer.page.view import View

MOST_FACES = 250_000
"""Triangles of a body that a browser still draws with ease."""

SHORTEST = 0.5
"""Seconds of a motion that is worth learning from; some characters hold a pose as a clip of two frames."""

STEPS_PER_SECOND = 60.0
"""Of every layout."""


class FileContent(NamedTuple):
    """What a file holds.

    Attributes:
        name: the file's name without suffix, reduced to harmless characters.
        clips: names of its motions that can be learned from, the likely walk first; a BVH file has one, "".
        body: whether it holds a rigged body.
        whole: whether it holds no other motion than these one or none, not even one of another length.
    """

    name: str
    clips: tuple[str, ...]
    body: bool
    whole: bool = True


@dataclass(frozen=True, eq=False)
class WornCharacter:
    """A character of a file.

    Attributes:
        name: its file's name without suffix, reduced to harmless characters.
        skeleton: its joints.
        mesh: its body.
        suffix, data: the file.
    """

    name: str
    skeleton: Skeleton
    mesh: SkinnedMesh
    suffix: str
    data: bytes


def read_content(filename: str, data: bytes) -> FileContent:
    """Returns what a file holds.

    Args:
        filename: as sent by the browser.
        data: the file's bytes.

    Raises:
        InputError: for a file of another kind, one that is too large or malformed, or one that holds neither a body nor
            a motion of `SHORTEST` to `LONGEST` seconds.
    """
    name, suffix = style_name(filename), suffix_of(filename)
    if suffix == ".bvh":
        return FileContent(name, ("",), False)
    with _kept(name, suffix, data) as path:
        document = read_document(path)
        clips = tuple(clip for number, clip in enumerate(clip_names(document)) if _fits(read_tracks(document, number)))
        with suppress(InputError):  # several motions, of which none is called a walk
            likely = clip_names(document)[choose_clip(document, None)[0]]
            clips = tuple(sorted(clips, key=lambda clip: clip != likely))
        if not clips and not document.items("skins"):
            rule = f"must hold a rigged character, or a motion of {SHORTEST:g} to {LONGEST:g} s"
            raise InputError(path, "file", "neither body nor motion", rule)
        return FileContent(name, clips, bool(document.items("skins")), len(clip_names(document)) <= 1)


def clip_bytes(filename: str, data: bytes, content: FileContent, clip: str) -> tuple[str, bytes]:
    """Returns the name and the bytes of a file that holds one motion: those given, or the motion as a BVH file.

    Args:
        filename: as sent by the browser.
        data: the file's bytes.
        content: what the file holds.
        clip: name of the motion.

    Raises:
        InputError: as `read_clip`.
    """
    if suffix_of(filename) == ".bvh" or (content.whole and len(data) <= MOST_BYTES):
        return filename, data
    return clip_as_bvh(filename, data, clip)


def clip_as_bvh(filename: str, data: bytes, clip: str) -> tuple[str, bytes]:
    """Returns one motion of a glTF file as a BVH file, its name and its bytes.

    Args:
        filename: as sent by the browser.
        data: the file's bytes.
        clip: name of the motion.

    Raises:
        InputError: as `read_clip`.
    """
    name, suffix = style_name(filename), suffix_of(filename)
    with _kept(name, suffix, data) as path:
        return f"{name} {style_name(f'{clip}.bvh')}.bvh", bvh_bytes(read_clip(path, clip_name=clip))


def read_worn_character(filename: str, data: bytes) -> WornCharacter:
    """Returns the character of a file.

    Args:
        filename: as sent by the browser.
        data: the file's bytes.

    Raises:
        InputError: for a file of another kind, one that is too large, and as `read_character` and `read_mesh`.
    """
    name, suffix = style_name(filename), suffix_of(filename)
    if suffix == ".bvh":
        raise InputError(f"{name}.bvh", "body", "none", "must be a rigged character: a GLB or VRM file")
    with _kept(name, suffix, data) as path:
        character = read_character(path)
        mesh = read_mesh(character)
    if len(mesh.faces) > MOST_FACES:
        rule = f"must be at most {MOST_FACES}: reduce the mesh"
        raise InputError(f"{name}{suffix}", "mesh", f"{len(mesh.faces)} triangles", rule)
    return WornCharacter(name, character.skeleton, mesh, suffix, data)


@contextmanager
def _kept(name: str, suffix: str, data: bytes) -> Iterator[Path]:
    """Writes a file into a folder of its own for the block; errors name it as it was sent."""
    check_size(f"{name}{suffix}", data, MOST_CHARACTER_BYTES)
    with background.temporary_folder() as folder:
        path = Path(folder) / f"{name}{suffix}"
        path.write_bytes(data)
        try:
            yield path
        except InputError as error:
            file = error.file.replace(f"{folder}/", "")
            value = str(error.value).replace(f"{folder}/", "")
            raise InputError(file, error.place, value, error.rule) from error


def _fits(tracks: list[Track]) -> bool:
    """Returns whether a motion is neither too short nor too long to be learned from."""
    times = [track.times for track in tracks if len(track.times)]
    if not times or max(map(len, times)) > MOST_FRAMES:
        return False
    return SHORTEST <= max(float(keys[-1]) for keys in times) - min(float(keys[0]) for keys in times) <= LONGEST


class LiveRetargeter:
    """Puts the poses of one skeleton onto a worn character, in their order.

    A foot stands on the lowest floor of the last second. A clip as a whole also looks a second ahead; on level ground
    that is the same.

    Args:
        skeleton: of the poses.
        worn: the character.

    Attributes:
        retargeter: of both skeletons.

    Raises:
        InputError: as `make_retargeter`.
    """

    def __init__(self, skeleton: Skeleton, worn: WornCharacter) -> None:
        self.retargeter: Retargeter = make_retargeter(skeleton, worn.skeleton)
        self._soles: deque[tuple[int, float]] = deque()
        self._window = stance_frames(STEPS_PER_SECOND)

    def retarget(self, view: View) -> View:
        """Returns what is drawn of a moment: the joints of the worn character, and the ground scaled as its travel.

        Args:
            view: of a character with the skeleton of the poses.
        """
        scale = self.retargeter.scale
        positions, rotations = self.retargeter.pose(view.joints, view.world_rotations, self._floor(view))
        return replace(
            view,
            joints=positions,
            world_rotations=rotations,
            root=scale * view.root,
            past_positions=scale * view.past_positions,
            future_positions=scale * view.future_positions,
        )

    def _floor(self, view: View) -> float:
        """Returns the height in metres of the lowest sole within the last second."""
        height = float(self.retargeter.sole_heights(np.asarray(view.joints, float)[None])[0])
        while self._soles and not view.frame - self._window < self._soles[0][0] <= view.frame:
            self._soles.popleft()
        self._soles.append((view.frame, height))
        return min(height for _, height in self._soles)


def height_of(mesh: SkinnedMesh) -> float:
    """Returns the height in metres of a body in its bind pose."""
    heights = mesh.vertices[:, 1]
    return float(heights.max() - heights.min())
