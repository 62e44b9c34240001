"""Where the camera stands, so that the panels do not cover the character: on a phone above the sheet of controls."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pfnn_jax.viewer.page.scene import CAMERA_FIELD, CAMERA_POSITION, CAMERA_TARGET

if TYPE_CHECKING:
    import viser

NARROW = 576
"""Pixels of width below which viser shows all panels as one sheet at the bottom (its theme's breakpoint `xs`)."""

LOW = 431
"""Pixels of height below which the page's style hides the readouts, and its controls cover the right side: a phone
held sideways."""

SHEET = 262
"""Pixels of height of the collapsed sheet (page style `pfnn-sheet`)."""

SIDE = 335
"""Pixels of width of the controls at the right, with their margin."""


def frame_character(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns the camera's position [3] and target [3] in metres, relative to the character and its heading.

    The character is put into the middle of what the panels leave free, by moving the camera sideways or down; the
    direction in which it looks stays.

    Args:
        width, height: of the window in pixels; 0 if unknown.
    """
    position, target = np.array(CAMERA_POSITION), np.array(CAMERA_TARGET)
    if width <= 0 or height <= 0:
        return position, target
    ahead = target - position
    distance = float(np.linalg.norm(ahead))
    metres = 2.0 * distance * float(np.tan(CAMERA_FIELD / 2.0)) / height  # per pixel, at the character
    right = np.cross(ahead / distance, [0.0, 1.0, 0.0])
    if width < NARROW:
        shift = np.array([0.0, -0.5 * min(SHEET, 0.5 * height) * metres, 0.0])
    elif height < LOW:
        shift = 0.5 * min(SIDE, 0.5 * width) * metres * right / np.linalg.norm(right)
    else:
        return position, target
    return position + shift, target + shift


class Framing:
    """Puts a tab's camera where the character is visible, again whenever the window's shape changes.

    Args:
        client: the tab.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._shape = "wide"  # for which the server's initial camera stands

    def update(self) -> None:
        """Moves the camera if the window has become that of a phone, was turned, or has become wide again."""
        width, height = self._size()
        shape = "narrow" if width < NARROW else "low" if height < LOW else "wide"
        if width > 0 and height > 0 and shape != self._shape:
            self._shape = shape
            self.apply()

    def apply(self) -> None:
        """Moves the camera behind the character."""
        camera = self._client.camera
        camera.fov = CAMERA_FIELD
        camera.position, camera.look_at = frame_character(*self._size())

    def _size(self) -> tuple[int, int]:
        try:
            return int(self._client.camera.image_width), int(self._client.camera.image_height)
        except AssertionError:  # the browser has not said yet
            return 0, 0
