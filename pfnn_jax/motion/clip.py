"""The record of one take of motion, and what can be done to it whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.skeleton import Skeleton


@dataclass(frozen=True, eq=False)
class MotionClip:
    """One take of motion on one skeleton.

    Attributes:
        skeleton: the joints.
        fps: frames per second.
        root_positions: [T, 3] metres, world position of joint 0.
        rotations: [T, J, 4] wxyz, each joint's rotation in its parent's frame (joint 0: in the world).
        style: name of the style, as `angry`.
        content: what is done, as `walk`.
        mirrored: whether left and right were exchanged.
        source: file the clip came from, for messages.
    """

    skeleton: Skeleton
    fps: float
    root_positions: np.ndarray
    rotations: np.ndarray
    style: str = "unknown"
    content: str = ""
    mirrored: bool = False
    source: str = ""

    @property
    def num_frames(self) -> int:
        return len(self.root_positions)
