"""Cameras: where a point of the scene lies in a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

NEAREST = 0.2  # metres in front of the eye; nearer points are not drawn


class Projection(Protocol):
    """Where points lie in a picture: the perspective `Camera` of videos, or the `SideView` of pictures."""

    @property
    def axes(self) -> np.ndarray:
        """Directions [3, 3] in the world, as rows: right, up and towards the viewer."""
        ...

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns pixels [..., 2] right and up from the lower left corner, pixels per metre [...], nearness [...]."""
        ...


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera ahead of a body, a little to its left and above.

    Attributes:
        target: [3] metres, the point at the centre of the picture.
        facing: radians, facing direction of the body.
        tall: size of the body relative to a person; the camera's distance scales with it.
        width, height: of the picture, pixels.
        yaw: radians from `facing` to the camera.
        pitch: radians above the ground.
        away: distance from a person, metres.
    """

    target: np.ndarray
    facing: float
    tall: float
    width: float
    height: float
    yaw: float = 0.75
    pitch: float = 0.28
    away: float = 4.6

    @property
    def axes(self) -> np.ndarray:
        """Directions [3, 3] in the world, as rows: right, up and towards the viewer."""
        return view_axes(self.yaw + self.facing, self.pitch)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Projects points [..., 3] into the picture.

        Returns:
            (pixels [..., 2] right and up from the lower left corner, pixels per metre [...], nearness [...] metres in
            front of the target). Pixels are NaN for points behind the eye.
        """
        seen = (points - self.target) @ self.axes.T
        near = seen[..., 2]
        depth = self.away * self.tall - near
        zoom = 1.75 * min(self.height, 1.25 * self.width)
        scale = np.where(depth > NEAREST * self.tall, zoom / np.maximum(depth, 1e-9), np.nan)
        middle = np.array([self.width, self.height]) / 2
        return middle + seen[..., :2] * scale[..., None], scale, near


@dataclass(frozen=True, eq=False)
class SideView:
    """A parallel projection from the side of a body.

    Attributes:
        facing: radians, facing direction of the body.
        scale: pixels per metre.
        turn: radians from the body's front to the viewer at its right: at 0 it faces the viewer, at 90 degrees it is
            seen exactly from the right.
    """

    facing: float
    scale: float
    turn: float

    @property
    def axes(self) -> np.ndarray:
        """Directions [3, 3] in the world, as rows: right, up and towards the viewer."""
        return view_axes(self.facing - self.turn, 0.0)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Projects points [..., 3]: pixels [..., 2] from the world's origin, pixels per metre, and nearness [...]."""
        seen = points @ self.axes.T
        return seen[..., :2] * self.scale, np.full(seen.shape[:-1], self.scale), seen[..., 2]


def view_axes(yaw: float, pitch: float) -> np.ndarray:
    """Returns the directions [3, 3] right, up and towards the viewer, as rows.

    Args:
        yaw: radians about the vertical from +Z to the viewer.
        pitch: radians of the viewer above the ground.
    """
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    return np.array([[cy, 0.0, -sy], [-sp * sy, cp, -sp * cy], [cp * sy, sp, cp * cy]])
