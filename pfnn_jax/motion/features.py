"""From a clip to the rows a network reads and writes, and back. The frame rule is in `layout`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.contacts import foot_joints, leg_length, slow_feet
from pfnn_jax.motion.footsteps import NoGaitError
from pfnn_jax.motion.gait import estimate_gait
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_exp,
    quat_from_forward_up,
    quat_from_yaw,
    quat_log,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.layout import NOW, FrameLayout
from pfnn_jax.motion.normaliser import require_finite
from pfnn_jax.motion.phase import PhaseLabels, label_phase
from pfnn_jax.motion.skeleton import Skeleton, need_roles
from pfnn_jax.motion.trajectory import (
    EXTRAPOLATION_SECONDS,
    Root,
    root_motion,
    sample_offsets,
    to_local,
    to_world,
    trajectory_windows,
    wrap_angle,
)

CONTACT_SPEED = 0.01 * np.sqrt(0.02) * 60
"""Metres per second: a squared displacement of 0.02 cm² in a frame (Holden's `contacts`; no height test)."""

STANDING_HEIGHTS = (0.05, 0.04, 0.05, 0.04)
"""Metres from the ground to left heel, left toe, right heel and right toe of a standing foot, as Holden's terrain has
them: the ground under a flat clip is the mean over contacts of a foot joint's height less this."""


@dataclass(frozen=True, eq=False)
class Features:
    """Rows of one clip, in layout units.

    Attributes:
        x: [N, Dx] float32.
        y: [N, Dy] float32.
        phase: [N] float32, radians.
        frames: [N] index of each row's frame in the clip.
    """

    x: np.ndarray
    y: np.ndarray
    phase: np.ndarray
    frames: np.ndarray


def select_rows(part: Features, rows: slice | np.ndarray) -> Features:
    """Some rows of a part: a slice, indices or a mask."""
    return Features(part.x[rows], part.y[rows], part.phase[rows], part.frames[rows])


def join_rows(parts: Sequence[Features]) -> Features:
    """The rows of all parts, one after another."""
    return Features(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("x", "y", "phase", "frames")))


@dataclass(frozen=True, eq=False)
class _Local:
    """A clip seen from its root, metres and metres per second; velocities look to the next frame and lack the last."""

    root: Root
    windows: tuple[np.ndarray, np.ndarray]
    positions: np.ndarray
    velocities: np.ndarray
    rotations: np.ndarray
    world_positions: np.ndarray


def clip_features(
    clip: MotionClip, layout: FrameLayout, labels: PhaseLabels | None = None, gait: np.ndarray | None = None
) -> Features:
    """Rows of every labelled frame of a clip.

    Frames i for which i and i+1 have a phase, except the first and last of the clip, which lack a neighbour.
    Velocities of frame i go from i to i+1, seen from root i. Trajectories go on beyond the clip's ends
    (`trajectory_windows`). Under `pfnn2017`, heights are above the ground of a flat clip: the mean height of the feet
    in contact less `STANDING_HEIGHTS`; terrain is therefore 0, and contacts follow the authors' rule of speed alone.

    Args:
        clip: T frames at the layout's frame rate, with roles.
        layout: of J joints.
        labels: phase of the T frames; None finds them with `label_phase`.
        gait: [T, 6] for `pfnn2017`; None estimates it from speed.

    Raises:
        NoGaitError: for a clip shorter than half a second, without steps, or without two labelled frames in a row.
        InputError: for another frame rate or number of joints or frames, or values that are not finite.
    """
    _check_clip(clip, layout)
    labels = label_phase(clip) if labels is None else labels
    if labels.num_frames != clip.num_frames:
        raise InputError(clip.source, "phase", f"{labels.num_frames} frames", f"the clip has {clip.num_frames}")
    usable = labels.labelled[:-1] & labels.labelled[1:]
    usable[0] = False
    frames = np.flatnonzero(usable)
    if not len(frames):
        raise NoGaitError(clip.source, "phase", "no two frames in a row are labelled", "a clip must hold steps")
    local = _localise(clip)
    ground = _ground(clip, local.world_positions) if layout.has_input("terrain_height") else 0.0
    x = _fill(layout.inputs, len(frames), lambda name: _input(name, clip, layout, local, frames, ground, gait))
    y = _fill(layout.outputs, len(frames), lambda name: _output(name, clip, layout, local, frames, ground, labels))
    require_finite(x, layout.inputs, clip.source, "x")
    require_finite(y, layout.outputs, clip.source, "y")
    return Features(x, y, labels.phase[frames].astype(np.float32), frames)


def clip_from_outputs(
    skeleton: Skeleton,
    layout: FrameLayout,
    y: np.ndarray,
    root_positions: np.ndarray,
    root_yaw: np.ndarray,
    fps: float = 60.0,
) -> MotionClip:
    """The motion that outputs describe, on roots that the caller has integrated.

    Joint rotations come from the output; joint 0 stands where the output has it; the other joints follow from the
    skeleton's bones, so that bones are rigid whatever the output says.

    Args:
        skeleton: J joints.
        layout: of J joints.
        y: [T, Dy] in layout units.
        root_positions: [T, 2] metres on the ground.
        root_yaw: [T] radians about +Y.
        fps: frames per second.

    Raises:
        InputError: for another width, or values that are not finite.
    """
    y = np.asarray(y, np.float64)
    if y.ndim != 2 or y.shape[1] != layout.output_size or skeleton.num_joints != layout.num_joints:
        raise InputError(
            "outputs",
            "array",
            f"shape {y.shape} on {skeleton.num_joints} joints",
            f"layout {layout.name} has {layout.output_size} columns for {layout.num_joints}",
        )
    require_finite(y, layout.outputs, "outputs", "y")
    yaw = np.asarray(root_yaw, np.float64)
    hips = y[:, layout.output_slice("joint_position")][:, :3] * layout.length_unit
    hips = to_world(yaw, hips)
    hips[:, [0, 2]] += root_positions
    world = quat_multiply(quat_from_yaw(yaw)[:, None], _output_rotations(layout, y))
    above = world[:, np.maximum(skeleton.parents, 0)]
    local = quat_multiply(quat_conjugate(above), world)
    local[:, 0] = world[:, 0]
    return MotionClip(skeleton, fps, hips, local)


def _output_rotations(layout: FrameLayout, y: np.ndarray) -> np.ndarray:
    """[T, J, 4] rotations relative to the root."""

    def block(name: str) -> np.ndarray:
        return y[:, layout.output_slice(name)].reshape(len(y), layout.num_joints, 3)

    if layout.has_output("joint_rotation"):
        return quat_exp(block("joint_rotation"))
    return quat_from_forward_up(block("joint_forward"), block("joint_up"))


def _check_clip(clip: MotionClip, layout: FrameLayout) -> None:
    if abs(clip.fps - layout.fps) > 0.01:
        raise InputError(clip.source, "frame rate", f"{clip.fps:g} fps", f"layout {layout.name} needs {layout.fps:g}")
    if clip.skeleton.num_joints != layout.num_joints:
        raise InputError(
            clip.source,
            "skeleton",
            f"{clip.skeleton.num_joints} joints",
            f"layout {layout.name} was made for {layout.num_joints}",
        )
    least = round(EXTRAPOLATION_SECONDS * layout.fps)
    if clip.num_frames < least:
        raise NoGaitError(clip.source, "frames", clip.num_frames, f"one trajectory window needs at least {least}")
    for name, values in (("root position", clip.root_positions), ("rotation", clip.rotations)):
        bad = ~np.isfinite(values)
        if bad.any():
            place = tuple(int(i) for i in np.argwhere(bad)[0])
            raise InputError(clip.source, f"frame {place[0]}, {name}", values[place], "every value must be finite")


def _localise(clip: MotionClip) -> _Local:
    roles = need_roles(clip.skeleton, clip.source)
    positions, rotations = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    root = root_motion(positions, roles, clip.fps)
    yaw = root.yaw
    offset = positions.copy()
    offset[..., [0, 2]] -= root.positions[:, None]
    return _Local(
        root=root,
        windows=trajectory_windows(root, clip.fps),
        positions=to_local(yaw, offset),
        velocities=to_local(yaw[:-1], np.diff(positions, axis=0) * clip.fps),
        rotations=quat_multiply(quat_from_yaw(-yaw)[:, None], rotations),
        world_positions=positions,
    )


def _ground(clip: MotionClip, positions: np.ndarray) -> float:
    """Height of the ground of a flat clip, metres; 0 where no foot ever stands."""
    roles = need_roles(clip.skeleton, clip.source)
    contact = slow_feet(positions, roles, clip.fps, CONTACT_SPEED)[:-1]
    heights = positions[:-1, foot_joints(roles), 1] - np.array(STANDING_HEIGHTS)
    return float(heights[contact].mean()) if contact.any() else 0.0


def _fill(blocks, rows: int, block) -> np.ndarray:
    filled, start = np.empty((rows, sum(size for _, size in blocks)), np.float32), 0
    for name, size in blocks:
        filled[:, start : start + size] = block(name).reshape(rows, size)
        start += size
    return filled


def _input(name, clip, layout, local: _Local, frames, ground: float, gait) -> np.ndarray:
    if name.startswith("trajectory"):
        return _trajectory(name, local.windows, frames, 0, layout)
    if name.startswith("joint"):
        return _joints(name, local, frames - 1, layout, ground)
    if name == "gait":
        return _gait_windows(clip, local, frames, gait)
    return np.zeros(dict(layout.inputs)[name] * len(frames))  # terrain: a flat clip stands on its ground


def _output(name, clip, layout, local: _Local, frames, ground: float, labels: PhaseLabels) -> np.ndarray:
    rate = layout.time_unit * clip.fps
    if name.startswith("trajectory"):
        return _trajectory(name, local.windows, frames + 1, NOW, layout)
    if name.startswith("joint"):
        return _joints(name, local, frames, layout, ground)
    if name == "contacts":
        roles = need_roles(clip.skeleton, clip.source)
        return slow_feet(local.world_positions, roles, clip.fps, CONTACT_SPEED)[frames]
    if name == "root_velocity":
        return local.velocities[frames][:, 0, [0, 2]] * (layout.time_unit / layout.length_unit)
    if name == "root_yaw_rate":
        yaw = local.root.yaw
        return wrap_angle(yaw[frames + 1] - yaw[frames]) * (rate / layout.yaw_unit)
    return wrap_angle(labels.phase[frames + 1] - labels.phase[frames]) * (rate / layout.phase_unit)


def _trajectory(name: str, windows, frames: np.ndarray, first: int, layout: FrameLayout) -> np.ndarray:
    _, kind, axis = name.split("_")
    samples = windows[0] if kind == "position" else windows[1]
    return samples[frames, first:, "xz".index(axis)] / (layout.length_unit if kind == "position" else 1.0)


def _joints(name: str, local: _Local, frames: np.ndarray, layout: FrameLayout, ground: float) -> np.ndarray:
    if name == "joint_position":
        return (local.positions[frames] - np.array([0.0, ground, 0.0])) / layout.length_unit
    if name == "joint_velocity":
        return local.velocities[frames] * (layout.time_unit / layout.length_unit)
    if name == "joint_rotation":
        return quat_log(local.rotations[frames])
    axis = np.array([0.0, 0.0, 1.0] if name == "joint_forward" else [0.0, 1.0, 0.0])
    return quat_rotate(local.rotations[frames], axis)


def _gait_windows(clip: MotionClip, local: _Local, frames: np.ndarray, gait: np.ndarray | None) -> np.ndarray:
    """[N, 6, 12]: beyond the clip's ends the first and last label hold."""
    if gait is None:
        leg = leg_length(local.world_positions, need_roles(clip.skeleton, clip.source))
        gait = estimate_gait(local.root.positions, leg, clip.fps)
    if len(gait) != clip.num_frames:
        raise InputError(clip.source, "gait", f"{len(gait)} frames", f"the clip has {clip.num_frames}")
    index = np.clip(frames[:, None] + sample_offsets(clip.fps), 0, clip.num_frames - 1)
    return np.moveaxis(gait[index], 2, 1)
