"""The camera of films, as that of players: it follows a body, ahead of it and a little to its left and above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NEAREST = 0.2  # metres in front of the eye


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera, as that of `player_scene.js`.

    Attributes:
        target: [3] metres, what it looks at.
        heading: radians, where the body faces.
        tall: 1 for a person; its distance scales with it.
        width, height: of the picture, pixels.
        yaw: radians between heading and camera.
        pitch: radians above the ground.
        away: distance from a person, metres.
    """

    target: np.ndarray
    heading: float
    tall: float
    width: float
    height: float
    yaw: float = 0.75
    pitch: float = 0.28
    away: float = 4.6

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where points [..., 3] stand in the picture.

        Returns:
            (pixels [..., 2] right and up from the lower left corner, pixels per metre [...], nearness [...] metres in
            front of the target). Pixels are NaN for points behind the eye.
        """
        yaw = self.yaw + self.heading
        cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(self.pitch), np.sin(self.pitch)
        x, y, z = np.moveaxis(points - self.target, -1, 0)
        right, ahead = cy * x - sy * z, sy * x + cy * z
        up, near = cp * y - sp * ahead, sp * y + cp * ahead
        depth = self.away * self.tall - near
        zoom = 1.75 * min(self.height, 1.25 * self.width)
        scale = np.where(depth > NEAREST * self.tall, zoom / np.maximum(depth, 1e-9), np.nan)
        middle = np.array([self.width, self.height]) / 2
        return middle + np.stack([right, up], axis=-1) * scale[..., None], scale, near
