"""The axis that points up in a file, found from how the body stands, and turning it to +Y."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.arrays import unit
from pfnn_jax.motion.clip import MotionClip, move_clip
from pfnn_jax.motion.humanoid.map import LEG, SIDES, HumanoidMap
from pfnn_jax.motion.reading import AXES, Axis

HALF = np.sqrt(0.5)

TURNS: dict[Axis, np.ndarray] = {
    "x": np.array([HALF, 0.0, 0.0, HALF]),
    "y": np.array([1.0, 0.0, 0.0, 0.0]),
    "z": np.array([HALF, -HALF, 0.0, 0.0]),
    "-x": np.array([HALF, 0.0, 0.0, -HALF]),
    "-y": np.array([0.0, 1.0, 0.0, 0.0]),  # about X, so that a camera's view stays the right way round
    "-z": np.array([HALF, HALF, 0.0, 0.0]),
}
"""The rotation that turns each axis to +Y."""

STANDING = 0.8
"""Least cosine, in half of the poses, between an axis and the line from feet to head of a body that stands along it."""

BENDING = 0.5
"""... and in nine tenths of the poses."""


def find_up(positions: np.ndarray, humanoid: HumanoidMap) -> tuple[Axis, bool]:
    """Finds the axis along which a body stands.

    Y is kept unless the body stands along another axis: people also crouch, crawl and lie.

    Args:
        positions: [N, J, 3] joint positions of poses in any unit.
        humanoid: with feet, or shins without them, and a head, or the top of neck and spine without it.

    Returns:
        The axis, and whether the body stands along it.
    """
    trunk = (humanoid.hips, *humanoid.spine, *humanoid.neck)
    top = trunk[-1] if humanoid.head is None else humanoid.head
    left, right = (shin if foot is None else foot for shin, foot in (humanoid.limb(side, LEG)[1:3] for side in SIDES))
    body = positions[:, top] - (positions[:, left] + positions[:, right]) / 2
    shares = np.sort(unit(body), axis=0)
    middle = shares[len(shares) // 2]
    axis = int(np.argmax(np.abs(middle)))
    sign = 1.0 if middle[axis] > 0 else -1.0
    tenth = len(shares) // 10
    bent = shares[tenth if sign > 0 else -1 - tenth, axis]
    stands = abs(middle[axis]) > STANDING and sign * bent > BENDING
    if not stands:
        return "y", bool(middle[1] > BENDING)
    return (AXES[axis] if sign > 0 else AXES[axis + 3]), True


def stand_up(clip: MotionClip, up: Axis) -> MotionClip:
    """Returns the clip with `up` turned to +Y; a clip with Y up is returned unchanged.

    Args:
        clip: the motion.
        up: key of `TURNS`.
    """
    if up == "y":
        return clip
    return move_clip(clip, TURNS[up], np.zeros(3))
