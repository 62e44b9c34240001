"""The body of capsules as instances of a few meshes, so that a frame of the page is a few positions and rotations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.motion.kinematics import quat_between, quat_rotate
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.viewer.draw.body import Capsule, body_capsules, capsule_ends

TAPER = 0.76
"""Radius of a tapered limb's far end relative to its near end, a typical value of `body_capsules`."""

_STRAIGHT_FROM = 0.88  # ratio of radii above which a limb is drawn without taper


@dataclass(frozen=True, eq=False)
class Mesh:
    """A triangle mesh: vertices [V, 3], faces [F, 3] anticlockwise as seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray


def frustum(ratio: float, segments: int = 20) -> Mesh:
    """Returns the side of a cone from radius 1 at y = 0 to `ratio` at y = 1, open at both ends."""
    angles = 2.0 * np.pi * np.arange(segments) / segments
    ring = np.stack([np.cos(angles), np.zeros(segments), np.sin(angles)], axis=1)
    top = ring * ratio + np.array([0.0, 1.0, 0.0])
    here = np.arange(segments)
    after = (here + 1) % segments
    lower = np.stack([here, here + segments, after], axis=1)
    upper = np.stack([after, here + segments, after + segments], axis=1)
    return Mesh(np.concatenate([ring, top]), np.concatenate([lower, upper]))


def sphere(rings: int = 12, segments: int = 20) -> Mesh:
    """Returns a sphere of radius 1 around the origin."""
    polar = np.pi * np.arange(1, rings) / rings
    angles = 2.0 * np.pi * np.arange(segments) / segments
    circle = np.stack([np.cos(angles), np.zeros(segments), np.sin(angles)], axis=1)
    rows = [np.sin(p) * circle + np.array([0.0, np.cos(p), 0.0]) for p in polar]
    vertices = np.concatenate([np.array([[0.0, 1.0, 0.0]]), *rows, np.array([[0.0, -1.0, 0.0]])])
    here = np.arange(segments)
    after = (here + 1) % segments
    faces = [np.stack([np.zeros(segments, int), 1 + after, 1 + here], axis=1)]
    for row in range(rings - 2):
        first, second = 1 + row * segments, 1 + (row + 1) * segments
        faces.append(np.stack([first + here, first + after, second + here], axis=1))
        faces.append(np.stack([first + after, second + after, second + here], axis=1))
    last = 1 + (rings - 2) * segments
    faces.append(np.stack([last + here, last + after, np.full(segments, len(vertices) - 1)], axis=1))
    return Mesh(vertices, np.concatenate(faces))


class BodyMeshes:
    """The mesh instances that make up one skeleton's body.

    Attributes:
        capsules: its limb segments.
        tapered: [C] bool, which of them are tapered and which straight.
        limb_scales: [C, 3] radius, length, radius in metres; bones are rigid, so they never change.
        ball_radii: [2 C] metres, of the balls at both ends of every limb.

    Args:
        skeleton: with roles for a person; without them all bones have the same small radius.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self._end_joints = np.array([joint for joint, _ in skeleton.end_sites], int)
        self._end_offsets = np.array([offset for _, offset in skeleton.end_sites], float).reshape(-1, 3)
        self.capsules: list[Capsule] = body_capsules(skeleton)
        first = np.array([capsule.start_radius for capsule in self.capsules])
        second = np.array([capsule.end_radius for capsule in self.capsules])
        self.tapered = second < _STRAIGHT_FROM * first
        near = np.where(self.tapered, (first + second / TAPER) / 2.0, (first + second) / 2.0)
        self.ball_radii = np.concatenate([near, np.where(self.tapered, TAPER * near, near)])
        lengths = self._lengths(skeleton)
        self.limb_scales = np.stack([near, lengths, near], axis=1)

    def place(self, joints: np.ndarray, world_rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places the instances for a pose.

        Args:
            joints: [J, 3] world positions.
            world_rotations: [J, 4] quaternions of the joints' frames, which place the End Sites.

        Returns:
            Origins [C, 3] and orientations [C, 4] of the limbs (their length is along y), and centres [2 C, 3] of the
            balls.
        """
        starts, ends = self._ends(self._points(joints, world_rotations))
        return starts, quat_between(np.array([0.0, 1.0, 0.0]), ends - starts), np.concatenate([starts, ends])

    def _points(self, joints: np.ndarray, world_rotations: np.ndarray) -> np.ndarray:
        ends = joints[self._end_joints] + quat_rotate(world_rotations[self._end_joints], self._end_offsets)
        return np.concatenate([joints, ends])

    def _ends(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        pairs = [capsule_ends(points, capsule) for capsule in self.capsules]
        return np.stack([start for start, _ in pairs]), np.stack([end for _, end in pairs])

    def _lengths(self, skeleton: Skeleton) -> np.ndarray:
        joints = np.zeros((len(skeleton.parents), 3))
        for joint, parent in enumerate(skeleton.parents):
            if parent >= 0:
                joints[joint] = joints[parent] + skeleton.offsets[joint]
        still = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))
        starts, ends = self._ends(self._points(joints, still))
        return np.linalg.norm(ends - starts, axis=1)
