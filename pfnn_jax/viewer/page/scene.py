"""The three-dimensional scene of a tab: body, ground, trajectory and foot contacts.

The mouse controls the camera. A camera that follows the character is therefore made by moving the world instead: all
that stands in it hangs below one node, which is moved so that the character stays in the middle and, if wanted, is seen
from behind. Orbiting stays smooth whatever the network does, and no camera message is ever sent.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.kinematics import quat_from_yaw
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.viewer.body import grow_body
from pfnn_jax.viewer.draw.palette import (
    FUTURE,
    HORIZON,
    PAST,
    SCENE_CELL,
    SCENE_GROUND,
    SCENE_SECTION,
    SCENE_SIDES,
    SKY,
)
from pfnn_jax.viewer.page.skinned_body import BODY, SkinnedBody
from pfnn_jax.viewer.page.view import View, at_moment
from pfnn_jax.viewer.page.worn_character import LiveRetargeter, WornCharacter, height_of

if TYPE_CHECKING:
    import viser

CELL_SIZE, SECTION_SIZE = 0.5, 2.0  # metres
EASE = 0.1  # seconds, time constant of the following camera's position: it lags behind by twice as much
EASE_TURN = 0.24  # seconds, time constant of its turning
ARROW = 0.15  # metres, length of the arrowheads along the trajectory
LAMP = (2.4, 5.2, -2.8)
"""Metres from the character: behind its left, so that the camera sees the lit side. One lamp that moves along needs one
shadow map; the default lights need three and leave the back dark."""

MARK = 0.075  # metres, radius of the disc of a full contact
LIFT = 0.006  # metres above the ground at which flat shapes are drawn

CAMERA_POSITION, CAMERA_TARGET = (1.05, 1.75, -4.1), (0.0, 0.84, 0.25)
"""Behind the left shoulder, in the frame of the heading."""

CAMERA_FIELD = math.radians(40.0)
"""Vertical field of view."""


class Mesh(NamedTuple):
    """A triangle mesh: vertices [V, 3], faces [F, 3] anticlockwise as seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray


class Spring:
    """Follows a target like a critically damped spring: without a jerk when the target jumps, and without overshoot.

    The motion is computed exactly between two moments, so it does not depend on how often it is drawn.

    Args:
        value: [...] start, at rest.
        seconds: time constant.
    """

    def __init__(self, value: np.ndarray, seconds: float) -> None:
        self.value, self._rate = np.asarray(value, float), 1.0 / seconds
        self._velocity = np.zeros_like(self.value)

    def follow(self, target: np.ndarray, seconds: float) -> None:
        """Moves on by some seconds in which the target [...] stands still."""
        behind, decay = self.value - target, math.exp(-self._rate * seconds)
        pull = self._velocity + self._rate * behind
        self.value = target + (behind + pull * seconds) * decay
        self._velocity = (self._velocity - self._rate * pull * seconds) * decay

    def jump(self, value: np.ndarray) -> None:
        """Stands at a value at once."""
        self.value, self._velocity = np.asarray(value, float), np.zeros_like(self.value)


class PageScene:
    """Draws body, ground, trajectory and contact discs of one tab.

    Args:
        scene: the tab's viser scene.

    Attributes:
        follow: whether the camera follows the character.
        turn: whether it turns with the heading.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._own: Skeleton | None = None
        self._worn: WornCharacter | None = None
        self._live: LiveRetargeter | None = None
        self._skeleton: Skeleton | None = None  # of what is drawn
        self._parts: list[Any] = []
        self._zoom = 1.0
        self.follow, self.turn = True, True
        self._origin, self._yaw = Spring(np.zeros(2), EASE), Spring(np.zeros(()), EASE_TURN)
        self._light()
        self._world = scene.add_frame("/world", show_axes=False)
        self._body = SkinnedBody(scene, BODY)
        # Browsers apply poses of nodes at once, but other changes some pictures later: what is drawn around the
        # character is given relative to it, so that it does not lag behind.
        self._around = scene.add_frame("/world/around", show_axes=False)
        self._grid = scene.add_grid(
            "/ground",
            plane="xz",
            infinite_grid=True,
            cell_size=CELL_SIZE,
            section_size=SECTION_SIZE,
            cell_color=SCENE_CELL,
            section_color=SCENE_SECTION,
            section_thickness=1.4,
            plane_color=SCENE_GROUND,
            plane_opacity=1.0,
            shadow_opacity=0.3,
            fade_distance=28.0,
            fade_strength=1.6,
        )

    @property
    def worn(self) -> WornCharacter | None:
        """The character that is worn."""
        return self._worn

    @property
    def _travel(self) -> float:
        """Factor on the ground covered by the character that is driven."""
        return 1.0 if self._live is None else self._live.retargeter.scale

    @property
    def origin(self) -> np.ndarray:
        """Point of the ground [2] in metres that is drawn in the middle."""
        return self._origin.value

    @property
    def yaw(self) -> float:
        """Direction in radians about +Y that is drawn as ahead."""
        return float(self._yaw.value)

    def set_skeleton(self, skeleton: Skeleton) -> None:
        """Sets the skeleton of the views that follow, and draws its body unless another is worn.

        Raises:
            InputError: if its motion cannot be put onto what is worn; its own body is drawn then.
        """
        self._own = skeleton
        try:
            self.wear(self._worn)
        except InputError:
            self.wear(None)
            raise

    def wear(self, worn: WornCharacter | None) -> None:
        """Replaces the body by that of a character, or by the skeleton's own.

        All is drawn so that a body of another height fills as much of the picture.

        Raises:
            InputError: if the skeleton's motion cannot be put onto the character; nothing has changed then.
        """
        if self._own is None:
            self._worn = worn
            return
        live, before = None if worn is None else LiveRetargeter(self._own, worn), self._travel
        own = grow_body(self._own)
        if worn is None or live is None:
            self._show(self._own, own, np.arange(self._own.num_joints), 1.0)
        else:
            zoom = height_of(own) / height_of(worn.mesh)
            self._show(worn.skeleton, worn.mesh, live.retargeter.carriers, zoom)
        self._worn, self._live = worn, live
        self._origin.jump(self._origin.value * (self._travel / before))

    def _show(self, skeleton: Skeleton, mesh: SkinnedMesh, carriers: np.ndarray, zoom: float) -> None:
        for part in self._parts:
            part.remove()
        self._zoom = zoom
        self._grid.cell_size, self._grid.section_size = zoom * CELL_SIZE, zoom * SECTION_SIZE
        self._body.show(mesh, carriers, zoom)
        self._skeleton, self._parts = skeleton, self._tracks(skeleton)

    def jump_to(self, view: View) -> None:
        """Moves the following camera to the character at once: at the start, and after a reset."""
        self._origin.jump(view.root * self._travel)
        if self.turn:
            self._yaw.jump(np.array(view.heading))

    def draw(self, view: View, seconds: float) -> None:
        """Draws a moment.

        Args:
            view: of a character with the skeleton that was set.
            seconds: since the last call.
        """
        view = at_moment(view)
        if self._live is not None:
            view = self._live.retarget(view)
        self._move_camera(view, seconds)
        self._world.wxyz = quat_from_yaw(-self.yaw)
        self._world.position = -self._zoom * self._turned(self.origin)
        self._body.place(view.joints, view.world_rotations)
        self._lamp.position = self._zoom * self._turned(view.root - self.origin) + np.array(LAMP)
        self._move_ground()
        self._draw_tracks(view)

    def _light(self) -> None:
        scene = self._scene
        scene.set_background_image(_sky(), format="png")
        scene.configure_default_lights(False)
        scene.configure_environment_map(None)
        scene.add_light_hemisphere("/sky", sky_color=(255, 255, 255), ground_color=(150, 156, 168), intensity=1.5)
        self._lamp = scene.add_light_spot(
            "/lamp",
            position=LAMP,
            direction=(-LAMP[0], -LAMP[1], -LAMP[2]),
            angle=0.42,
            penumbra=1.0,
            decay=0.0,
            intensity=2.3,
            cast_shadow=True,
        )
        scene.configure_fog(12.0, 34.0, color=HORIZON)

    def _batch(self, name: str, mesh: Mesh, colours: np.ndarray | tuple[int, int, int], scales: np.ndarray) -> Any:
        identity = np.tile([1.0, 0.0, 0.0, 0.0], (len(scales), 1))
        return self._scene.add_batched_meshes_simple(
            name,
            mesh.vertices,
            mesh.faces,
            identity,
            np.zeros((len(scales), 3)),
            batched_scales=scales,
            batched_colors=colours,
            lod="off",
            receive_shadow=False,  # its own shadow would look speckled
        )

    def _tracks(self, skeleton: Skeleton) -> list[Any]:
        none = np.zeros((0, 2, 3))
        scene = self._scene
        self._past = scene.add_line_segments("/world/around/past", none, PAST, thickness=0.012)
        self._future = scene.add_line_segments("/world/around/future", none, FUTURE, thickness=0.018)
        self._arrows = self._batch("/world/around/arrows", _arrow(), FUTURE, np.ones((1, 3)))
        parts = [self._past, self._future, self._arrows]
        if skeleton.roles is None:
            return parts
        self._feet = np.array([*skeleton.roles.left_foot, *skeleton.roles.right_foot])
        sides = np.array([SCENE_SIDES["left"]] * 2 + [SCENE_SIDES["right"]] * 2, np.uint8)
        self._marks = self._batch("/world/around/contacts", _disc(), sides, np.full((4, 3), MARK))
        return [*parts, self._marks]

    def _draw_tracks(self, view: View) -> None:
        self._around.position = self._zoom * np.array([view.root[0], 0.0, view.root[1]])
        past, future = self._flat(view.past_positions - view.root), self._flat(view.future_positions - view.root)
        self._past.points = np.stack([past[:-1], past[1:]], axis=1)
        self._future.points = np.stack([future[:-1], future[1:]], axis=1)
        self._draw_arrows(np.concatenate([past[:-1], future]), len(past) - 1, view)
        if self._skeleton is not None and self._skeleton.roles is not None:
            self._marks.batched_positions = self._flat(view.joints[self._feet][:, [0, 2]] - view.root)
            size = MARK * np.clip(view.contacts, 0.0, 1.0)[:, None] + 1e-4
            self._marks.batched_scales = np.concatenate([size, np.ones_like(size), size], axis=1)

    def _draw_arrows(self, points: np.ndarray, behind: int, view: View) -> None:
        directions = np.concatenate([view.past_directions[:behind], view.future_directions])
        if len(points) != len(self._arrows.batched_positions):
            self._arrows.remove()
            colours = np.array([PAST] * behind + [FUTURE] * (len(points) - behind), np.uint8)
            self._parts = [part for part in self._parts if part is not self._arrows]
            self._arrows = self._batch("/world/around/arrows", _arrow(), colours, np.ones((len(points), 3)))
            self._parts.append(self._arrows)
        self._arrows.batched_positions = points + np.array([0.0, LIFT, 0.0])
        self._arrows.batched_wxyzs = quat_from_yaw(np.arctan2(directions[:, 0], directions[:, 1]))

    def _move_camera(self, view: View, seconds: float) -> None:
        if self.follow:
            self._origin.follow(view.root, seconds)
        if self.follow and self.turn:
            behind = math.remainder(view.heading - self.yaw, 2.0 * math.pi)
            self._yaw.follow(self._yaw.value + behind, seconds)

    def _move_ground(self) -> None:
        """Shifts the ground by less than one period of its pattern, so that the plane stays near the origin."""
        self._grid.position = self._zoom * self._turned(-(self.origin % SECTION_SIZE))
        self._grid.wxyz = quat_from_yaw(-self.yaw)

    def _turned(self, vector: np.ndarray) -> np.ndarray:
        """Returns a vector [2] on the world's ground as [3] in the picture's frame."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([c * vector[0] - s * vector[1], 0.0, s * vector[0] + c * vector[1]])

    def _flat(self, points: np.ndarray) -> np.ndarray:
        """Returns points [N, 2] in metres as [N, 3] just above the ground, as they are drawn."""
        return np.stack([self._zoom * points[:, 0], np.full(len(points), LIFT), self._zoom * points[:, 1]], axis=1)


def camera_yaw(position: Any, target: Any) -> float | None:
    """Returns the yaw of a camera's view in radians about +Y from +Z; None if it looks straight down.

    Args:
        position, target: [3] metres.
    """
    ahead, left = float(target[2] - position[2]), float(target[0] - position[0])
    return math.atan2(left, ahead) if math.hypot(ahead, left) > 1e-3 else None


def _sky(height: int = 64) -> np.ndarray:
    """Returns a vertical gradient [H, 2, 3]."""
    share = np.clip(np.linspace(0.0, 1.8, height), 0.0, 1.0)[:, None, None]
    colours = (1.0 - share) * np.array(SKY, float) + share * np.array(HORIZON, float)
    return np.broadcast_to(colours, (height, 2, 3)).round().astype(np.uint8)


def _arrow() -> Mesh:
    """Returns a flat arrowhead around the origin that points along +Z."""
    tip, wing, notch = 0.6 * ARROW, 0.32 * ARROW, -0.12 * ARROW
    vertices = np.array([[0.0, 0.0, tip], [wing, 0.0, -0.4 * ARROW], [0.0, 0.0, notch], [-wing, 0.0, -0.4 * ARROW]])
    return Mesh(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


def _disc(segments: int = 24) -> Mesh:
    """Returns a flat disc of radius 1 around the origin."""
    angles = 2.0 * np.pi * np.arange(segments) / segments
    rim = np.stack([np.cos(angles), np.zeros(segments), np.sin(angles)], axis=1)
    here = np.arange(segments)
    faces = np.stack([np.zeros(segments, int), 1 + (here + 1) % segments, 1 + here], axis=1)
    return Mesh(np.concatenate([np.zeros((1, 3)), rim]), faces)
