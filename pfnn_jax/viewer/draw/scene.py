"""A clip as a scene: the body above its ground, its size, where it faces, and the point that a camera follows.

Pictures, videos and HTML players draw this one description.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.kinematics import forward_kinematics, quat_conjugate, quat_multiply, quat_rotate, quat_slerp
from pfnn_jax.motion.skinned_mesh import SkinnedMesh
from pfnn_jax.viewer.body import grow_body
from pfnn_jax.viewer.draw.camera import Camera
from pfnn_jax.viewer.draw.upright import facing_angles

PERSON = 1.7  # metres
WIDE = 0.55  # the height of a person with arms spread, as a fraction of the width
SWAY = 4.0  # a scene is at least this many times as tall as it departs from the camera's target (a bouncing ball)
DOT = 0.07  # radius of a joint without bones, relative to a person
GROUND_PERCENTILE = 5.0  # of the lowest point over time: feet are on the ground for longer than this
NEAR_GROUND = 0.12  # relative to a person: feet this close to height 0 mean that the file's ground is at 0
FOLLOW = 1.0  # seconds over which the camera's target is averaged, so that it does not sway with every step
STRAIGHT = 0.7  # mean resultant length of the facing directions above which a clip has one direction


@dataclass(frozen=True, eq=False)
class Scene:
    """What pictures, videos and players draw of a clip.

    Attributes:
        positions: [T, J, 3] metres above the ground of the joints, Y up; joint 0 is the root.
        rotations: [T, J, 4] world rotations of the joints.
        mesh: the body, moved by these joints.
        fps: frames per second.
        tall: size relative to a person (1); distances of cameras scale with it.
        facings: [T] radians, facing direction of the body.
        facing: radians, facing direction of the whole clip: the mean, or that of the start if the body turns around.
        focus: [T, 3] metres, target of a following camera.
    """

    positions: np.ndarray
    rotations: np.ndarray
    mesh: SkinnedMesh
    fps: float
    tall: float
    facings: np.ndarray
    facing: float
    focus: np.ndarray

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.positions)

    def pose_at(self, second: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns positions [J, 3], rotations [J, 4] and focus [3] at a second, between two frames of the clip."""
        frame = min(max(second, 0.0) * self.fps, self.num_frames - 1.0)
        before = int(frame)
        after, share = min(before + 1, self.num_frames - 1), frame - before
        position, focus = (
            (1 - share) * values[before] + share * values[after] for values in (self.positions, self.focus)
        )
        return position, quat_slerp(self.rotations[before], self.rotations[after], share), focus

    def camera(self, focus: np.ndarray, width: float, height: float) -> Camera:
        """Returns the camera of a picture of width × height pixels that looks at a point [3]."""
        return Camera(focus, self.facing, self.tall, width, height)


def make_scene(clip: MotionClip, mesh: SkinnedMesh | None = None) -> Scene:
    """Returns the scene of a clip.

    The ground is at height 0 unless the body's lowest points are far from it, as in files that keep the hips in place;
    then it is just below them.

    Args:
        clip: T frames.
        mesh: the body, moved by the joints of the clip's skeleton; by default one that is grown around them.
    """
    skeleton, mesh = clip.skeleton, grow_body(clip.skeleton) if mesh is None else mesh
    positions, rotations = forward_kinematics(skeleton, clip.root_positions, clip.rotations)
    skin = outermost_points(mesh, positions, rotations)
    low, high = skin[..., 1].min(axis=1), skin[..., 1].max(axis=1)
    width = np.ptp(skin[..., [0, 2]], axis=1).max(axis=-1)
    known = skeleton.roles is not None
    tall = max(float(np.median(high - low)), (WIDE if known else 1.0) * float(np.median(width)))
    floor = float(np.percentile(low, GROUND_PERCENTILE))
    floor = 0.0 if abs(floor) < NEAR_GROUND * tall / PERSON else floor
    across = positions[:, 0] if known else (skin.min(axis=1) + skin.max(axis=1)) / 2
    middle = np.stack([across[:, 0], (low + high) / 2 - floor, across[:, 2]], axis=-1)
    focus = _running_mean(middle, clip.fps)
    tall = max(tall, SWAY * float(np.abs(middle - focus).max())) / PERSON
    facings = facing_angles(positions, skeleton.roles)
    return Scene(
        positions=positions - [0.0, floor, 0.0],
        rotations=rotations,
        mesh=_visible(mesh, tall),
        fps=clip.fps,
        tall=tall,
        facings=facings,
        facing=_overall_facing(facings, clip.fps),
        focus=focus,
    )


def outermost_points(mesh: SkinnedMesh, positions: np.ndarray, rotations: np.ndarray) -> np.ndarray:
    """Returns the outermost points [T, N, 3] of a posed body, close to those that all of its vertices would give.

    Every joint carries rigidly the vertices that it moves most and that lie outermost in 26 directions.

    Args:
        mesh: the body.
        positions: [T, J, 3] of its joints.
        rotations: [T, J, 4] of its joints.
    """
    carriers = mesh.joints[np.arange(len(mesh.joints)), np.argmax(mesh.weights, axis=1)]
    steps = np.array([-1.0, 0.0, 1.0])
    directions = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    kept = []
    for joint in np.unique(carriers):
        own = np.flatnonzero(carriers == joint)
        kept.append(own[np.unique(np.argmax(mesh.vertices[own] @ directions.T, axis=0))])
    chosen = np.concatenate(kept)
    joint = carriers[chosen]
    local = quat_rotate(quat_conjugate(mesh.bind_rotations[joint]), mesh.vertices[chosen] - mesh.bind_positions[joint])
    return positions[:, joint] + quat_rotate(rotations[:, joint], local)


def skin_mesh(mesh: SkinnedMesh, positions: np.ndarray, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the vertices [V, 3] and normals [V, 3] of a body in a pose.

    Args:
        mesh: the body.
        positions: [J, 3] of its joints.
        rotations: [J, 4] of its joints.
    """
    turns = quat_multiply(rotations, quat_conjugate(mesh.bind_rotations))
    normals = np.zeros_like(mesh.normals)
    for slot in range(mesh.joints.shape[1]):
        moved = np.flatnonzero(mesh.weights[:, slot])
        turned = quat_rotate(turns[mesh.joints[moved, slot]], mesh.normals[moved])
        normals[moved] += mesh.weights[moved, slot, None] * turned
    return mesh.pose(positions, rotations), normals


def _visible(mesh: SkinnedMesh, tall: float) -> SkinnedMesh:
    """Returns the body; a dot, which has no size of its own, with one that can be seen in its scene."""
    reach = np.ptp(mesh.bind_positions, axis=0).max() if len(mesh.bind_positions) else 0.0
    extent = float(np.ptp(mesh.vertices, axis=0).max()) / 2
    if reach > 0.0 or extent <= 0.0:
        return mesh
    centre = mesh.bind_positions[0]
    return replace(mesh, vertices=centre + (mesh.vertices - centre) * DOT * tall / extent)


def _overall_facing(facings: np.ndarray, fps: float) -> float:
    whole = np.mean(np.exp(1j * facings))
    start = np.mean(np.exp(1j * facings[: max(1, round(fps / 2))]))
    return float(np.angle(whole if abs(whole) > STRAIGHT else start))


def _running_mean(points: np.ndarray, fps: float) -> np.ndarray:
    """Returns the centred running mean over `FOLLOW` seconds of points [T, 3].

    Both ends are extended by point reflection, so that the mean does not lag behind there.
    """
    half = max(1, round(FOLLOW * fps / 2))
    before = 2 * points[:1] - points[1 : half + 1][::-1]
    after = 2 * points[-1:] - points[-half - 1 : -1][::-1]
    extended = np.concatenate([before, points, after])
    pad = (half, half)  # clips shorter than the window repeat their outermost point
    sums = np.cumsum(np.pad(extended, (pad, (0, 0)), mode="edge"), axis=0)
    sums = np.concatenate([np.zeros((1, 3)), sums])
    means = (sums[2 * half + 1 :] - sums[: -2 * half - 1]) / (2 * half + 1)
    return means[len(before) : len(before) + len(points)]
