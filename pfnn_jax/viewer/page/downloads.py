"""Downloads of a recording: as BVH or GLB, with the tab's own body or on the character that is worn."""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.gltf.write import glb_bytes
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.viewer.body import grow_body
from pfnn_jax.viewer.page import background
from pfnn_jax.viewer.page.recording import bvh_bytes
from pfnn_jax.viewer.page.scene import PageScene
from pfnn_jax.viewer.page.worn_character import WornCharacter
from pfnn_jax.workflows.characters import put_onto

if TYPE_CHECKING:
    from collections.abc import Callable

    import viser

BVH, GLB = "BVH", "GLB"
"""Formats, on the skeleton of the network."""

LONGEST_NAME = 60
"""Most characters of the file's name before its number of frames."""


class Downloads:
    """The choice of a format, and the sending of recordings in it.

    Args:
        client: the tab; the control is added to its present folder.
        scene: of the tab, which knows what is worn.
        refuse: shows a message of a kind.
    """

    def __init__(self, client: viser.ClientHandle, scene: PageScene, refuse: Callable[[str, str], None]) -> None:
        self._client, self._scene, self._refuse = client, scene, refuse
        self._worn: WornCharacter | None = None
        hint = "GLB holds the body too; both keep the travel."
        self._format: Any = client.gui.add_dropdown("Download as", (BVH, GLB), initial_value=BVH, hint=hint)

    def refresh(self) -> None:
        """Offers the formats for what is worn now, that of the character first."""
        if self._scene.worn is self._worn:
            return
        self._worn = self._scene.worn
        worn = () if self._worn is None else tuple(f"{kind} of {self._worn.name}" for kind in (GLB, BVH))
        self._format.options = (*worn, BVH, GLB)
        self._format.value = (*worn, BVH)[0]

    def send(self, name: str, clip: MotionClip) -> None:
        """Sends a recording in the chosen format, in a thread of its own: long ones take seconds to write.

        Args:
            name: of the file, without suffix.
            clip: on the skeleton of the network.
        """
        worn = self._worn if " of " in str(self._format.value) else None
        kind = GLB if str(self._format.value).startswith(GLB) else BVH
        threading.Thread(target=self._send, args=(name, clip, kind, worn), name="download", daemon=True).start()

    def _send(self, name: str, clip: MotionClip, kind: str, worn: WornCharacter | None) -> None:
        name = f"{name[:LONGEST_NAME]}_{clip.num_frames}.{kind.lower()}"
        with background.shown_errors(partial(self._refuse, "bad"), name):
            self._client.send_file_download(name, recording_bytes(clip, kind, worn), save_immediately=True)


def recording_bytes(clip: MotionClip, kind: str, worn: WornCharacter | None = None) -> bytes:
    """Returns the file of a recording, with its travel.

    Args:
        clip: the motion.
        kind: `BVH` or `GLB`.
        worn: put it onto this character: its own file with the clip added, or a BVH file of its skeleton.

    Raises:
        InputError: if the clip is not finite or has no frames, or cannot be put onto the character.
    """
    if kind == BVH:
        clip = clip if worn is None else retarget(clip, worn.skeleton).clip
        return bvh_bytes(clip)
    if worn is None:
        return glb_bytes(clip.skeleton, grow_body(clip.skeleton), {clip.style: clip}, root_motion=True)
    with background.temporary_folder() as folder:
        path = Path(folder) / f"{worn.name}{worn.suffix}"
        path.write_bytes(worn.data)
        return put_onto(clip, path, root_motion=True)
