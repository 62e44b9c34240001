"""Recordings of a character's poses, as a clip and as the bytes of a BVH file."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.bvh import bvh_text
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import quat_conjugate, quat_multiply, quat_normalise
from pfnn_jax.motion.length_unit import CENTIMETRE
from pfnn_jax.motion.skeleton import Skeleton

LONGEST = 600.0
"""Longest recording in seconds, so that a forgotten one does not fill the memory."""


class Recording:
    """Records poses of one skeleton at equal time steps, until it is closed or reaches `LONGEST`.

    Args:
        skeleton: of the poses.
        fps: poses per second.
        style, source: of the clip.
    """

    def __init__(self, skeleton: Skeleton, fps: float, style: str, source: str) -> None:
        self._skeleton, self._fps, self._style, self._source = skeleton, fps, style, source
        self._hips: list[np.ndarray] = []
        self._rotations: list[np.ndarray] = []
        self._closed = False

    @property
    def seconds(self) -> float:
        """Present length in seconds."""
        return len(self._hips) / self._fps

    @property
    def open(self) -> bool:
        """Whether it still records."""
        return not self._closed and self.seconds < LONGEST

    def close(self) -> None:
        """Ends the recording; later frames would not continue from the last one."""
        self._closed = True

    def add(self, hips: np.ndarray, rotations: np.ndarray) -> None:
        """Appends a frame if it is open.

        Args:
            hips: [3] world position in metres.
            rotations: [J, 4] world rotations.
        """
        if self.open:
            self._hips.append(np.array(hips, np.float32))
            self._rotations.append(np.array(rotations, np.float32))

    def clip(self) -> MotionClip | None:
        """Returns the frames as a clip, or None without frames."""
        if not self._hips:
            return None
        hips, world = np.stack(self._hips).astype(float), quat_normalise(np.stack(self._rotations).astype(float))
        rotations = quat_multiply(quat_conjugate(world[:, np.maximum(self._skeleton.parents, 0)]), world)
        rotations[:, 0] = world[:, 0]
        return MotionClip(self._skeleton, self._fps, hips, rotations, self._style, "played", source=self._source)


def bvh_bytes(clip: MotionClip, unit: float = CENTIMETRE) -> bytes:
    """Returns the BVH file of a clip as bytes, for a download.

    Args:
        clip: the motion.
        unit: metres per unit of the file.

    Raises:
        InputError: if the clip is not finite or has no frames.
    """
    return bvh_text(clip, unit=unit).encode()
