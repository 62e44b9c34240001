"""A posed body, and its shadow on the ground, as pictures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.viewer.draw.camera import Projection, SideView
from pfnn_jax.viewer.draw.palette import SHADE, SHADOW, rgb
from pfnn_jax.viewer.draw.rasteriser import SUN, Surface, cover, draw_surface
from pfnn_jax.viewer.draw.scene import Scene, skin_mesh

STEEP = 0.55  # factor of the sun's slant in shadows: a long shadow would draw the eye away from the feet
LARGEST = 3000.0  # pixels across a picture: a mesh may have parts far from its body
SOFT = 0.012  # standard deviation of the shadow's edge, metres on a person


@dataclass(frozen=True, eq=False)
class Picture:
    """A part of a larger picture.

    Attributes:
        colours: [H, W, 4] in 0..1, with straight opacity.
        left, top: pixels from the upper left corner of the larger picture.
    """

    colours: np.ndarray
    left: int
    top: int

    def paint_on(self, canvas: np.ndarray) -> None:
        """Paints it onto a canvas [..., ..., 3] of bytes, in which it lies whole."""
        height, width = self.colours.shape[:2]
        under = canvas[self.top : self.top + height, self.left : self.left + width]
        opacity = self.colours[..., 3:]
        under[:] = np.round(under + opacity * (255.0 * self.colours[..., :3] - under)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class BodyImage:
    """A body seen from the side.

    Attributes:
        colours: [H, W, 4] in 0..1, with straight opacity.
        left, right: of the body, metres from its root.
        bottom, top: metres above the ground.
        scale: pixels per metre.
    """

    colours: np.ndarray
    left: float
    right: float
    bottom: float
    top: float
    scale: float


def body_image(scene: Scene, frame: int, turn: float, scale: float) -> BodyImage:
    """Returns the body of one frame, turned to its own facing direction.

    Args:
        scene: the scene.
        frame: number of the frame.
        turn: radians from the body's front to the viewer at its right.
        scale: pixels per metre; less where the picture would be larger than `LARGEST`.
    """
    positions = scene.positions[frame] - scene.positions[frame, 0] * [1.0, 0.0, 1.0]
    vertices, normals = skin_mesh(scene.mesh, positions, scene.rotations[frame])
    scale = min(scale, LARGEST / max(float(np.ptp(vertices, axis=0).max()), 1e-9))
    view = SideView(float(scene.facings[frame]), scale, turn)
    pixels, _, near = view.project(vertices)
    pixels = pixels * [1.0, -1.0]
    first, last = np.floor(pixels.min(axis=0)), np.ceil(pixels.max(axis=0))
    surface = Surface(pixels - first, -near, normals @ view.axes.T, scene.mesh.faces, scene.mesh.colours / 255.0)
    width, height = (last - first).astype(int) + 1
    colours = draw_surface(surface, width, height)
    left, bottom = first[0] / scale, -(first[1] + height) / scale
    return BodyImage(colours, left, left + width / scale, bottom, -first[1] / scale, scale)


def draw_body(
    mesh: SkinnedMesh,
    positions: np.ndarray,
    rotations: np.ndarray,
    view: Projection,
    origin: tuple[float, float],
    frame: tuple[int, int, int, int],
    *,
    pale: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    shadow: float = 1.0,
) -> list[Picture]:
    """Returns the pictures of a body's shadow on the ground y = 0 and of the body, to be painted in this order.

    Args:
        mesh: the body.
        positions: [J, 3] of its joints.
        rotations: [J, 4] of its joints.
        view: the camera.
        origin: where its lower left corner lies, in pixels right and down from the upper left corner of the canvas.
        frame: left, top, right and bottom pixel of the canvas between which is drawn.
        pale: colour in 0..1 and share of it that is mixed into the body.
        shadow: scale of the scene in persons, which the softness of the shadow follows.
    """
    vertices, normals = skin_mesh(mesh, positions, rotations)
    pictures = _shadow(mesh, vertices, view, origin, frame, shadow)
    pixels, _, near = view.project(vertices)
    pixels = origin + pixels * [1.0, -1.0]
    window = _window(pixels, frame, 1)
    if window is not None and np.isfinite(pixels).all():
        left, top, right, bottom = window
        colours = mesh.colours / 255.0 + pale[3] * (np.array(pale[:3]) - mesh.colours / 255.0)
        surface = Surface(pixels - [left, top], -near, normals @ view.axes.T, mesh.faces, colours)
        pictures.append(Picture(draw_surface(surface, right - left, bottom - top), left, top))
    return pictures


def _shadow(
    mesh: SkinnedMesh,
    vertices: np.ndarray,
    view: Projection,
    origin: tuple[float, float],
    frame: tuple[int, int, int, int],
    size: float,
) -> list[Picture]:
    from scipy.ndimage import gaussian_filter

    sun = SUN @ view.axes
    slant = STEEP * sun * [1.0, 0.0, 1.0] / max(sun[1], 0.1)
    height = np.maximum(vertices[:, 1:2], 0.0)
    pixels, scale, _ = view.project(vertices * [1.0, 0.0, 1.0] - height * slant)
    pixels = origin + pixels * [1.0, -1.0]
    if not np.isfinite(pixels).all():
        return []
    blur = SOFT * size * float(np.median(scale))
    window = _window(pixels, frame, 1 + int(3 * blur))
    if window is None:
        return []
    left, top, right, bottom = window
    covered = cover(pixels - [left, top], mesh.faces, right - left, bottom - top).astype(np.float32)
    picture = np.empty((*covered.shape, 4))
    picture[..., :3] = np.array(rgb(SHADOW)) / 255.0
    picture[..., 3] = SHADE * gaussian_filter(covered, (0.6 * blur, blur))
    return [Picture(picture, left, top)]


def _window(pixels: np.ndarray, frame: tuple[int, int, int, int], margin: int) -> tuple[int, int, int, int] | None:
    """Returns left, top, right and bottom of the part of a frame that holds points [V, 2]; None if it is empty."""
    if not np.isfinite(pixels).all():
        return None
    low, high = np.floor(pixels.min(axis=0)) - margin, np.ceil(pixels.max(axis=0)) + margin
    left, top = max(frame[0], int(low[0])), max(frame[1], int(low[1]))
    right, bottom = min(frame[2], int(high[0])), min(frame[3], int(high[1]))
    return (left, top, right, bottom) if right > left and bottom > top else None
