"""The columns of the rows that transfer networks read and write: points relative to the root, and the root's motion.

A row holds one frame at 60 fps. The root lies on the ground under the hips and faces as hips and shoulders do; both are
smoothed. With p the points of a row in its root's frame, v its root velocity and r its yaw rate, the next root has

    yaw' = yaw - r,    x' = x + R(yaw') v,

where R turns about +Y (`motion.ground.turn`), and a point moves, in the next root's frame, by p' - R(r) p + v.
Velocity and yaw rate are as in the code of Holden et al. 2016: the velocity is relative to the root of the next frame,
and the rate is positive for a turn to the right.
"""

from __future__ import annotations

from dataclasses import dataclass

from pfnn_jax.motion.body_points import POINT_NAMES

LAYOUT_FPS = 60.0
"""Frame rate of all rows."""

WINDOW_FRAMES = 240
"""Frames of a training window (Holden et al. 2017)."""


@dataclass(frozen=True)
class ClipLayout:
    """The columns of a row, which holds one frame of a clip.

    Attributes:
        name: of the layout.
        num_points: points of a body, 21, or 22 where the first is the reference point: the root itself, at the origin.
        length_unit: metres per unit of length.
        has_contacts: whether the row ends with four foot contacts: left heel, left toe, right heel, right toe.
    """

    name: str
    num_points: int
    length_unit: float
    has_contacts: bool

    @property
    def size(self) -> int:
        """Returns D, the number of columns."""
        return 3 * self.num_points + 3 + 4 * self.has_contacts

    @property
    def has_reference(self) -> bool:
        """Returns whether the first point is the reference point."""
        return self.num_points > len(POINT_NAMES)

    @property
    def joint_position(self) -> slice:
        """Columns of the points, relative to the root, x y z of each in turn; units."""
        return slice(0, 3 * self.num_points)

    @property
    def root_velocity(self) -> slice:
        """Columns of the root's velocity to the left and forward, in the next frame's root; units per frame."""
        return slice(3 * self.num_points, 3 * self.num_points + 2)

    @property
    def root_yaw_rate(self) -> slice:
        """The column of the root's turn to the right, in radians per frame."""
        return slice(3 * self.num_points + 2, 3 * self.num_points + 3)

    @property
    def foot_contacts(self) -> slice:
        """Columns of the contacts, 0 or 1; empty in a layout without them."""
        return slice(3 * self.num_points + 3, self.size)


HOLDEN2017 = ClipLayout("holden2017", 21, 1.0, has_contacts=False)
"""66 numbers a frame, in metres (Holden et al. 2017, Data Representation)."""

HOLDEN2016 = ClipLayout("holden2016", 22, 0.056444, has_contacts=True)
"""73 numbers a frame, of the released autoencoder; a unit is 5.6444 cm, as in the CMU files."""

CLIP_LAYOUTS = {layout.name: layout for layout in (HOLDEN2017, HOLDEN2016)}
"""Layout by name."""
