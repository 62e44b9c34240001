"""Turns a clip into the rows that a network reads and writes. The frame rules are documented in `layout`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.features.layout import Blocks, FrameLayout, block_columns, column_names
from pfnn_jax.motion.features.local_motion import localise
from pfnn_jax.motion.features.normaliser import require_finite
from pfnn_jax.motion.features.rule_2017 import current_frame_rows
from pfnn_jax.motion.features.rule_2022 import end_velocities, next_frame_rows
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.local_phase import clip_local_phases
from pfnn_jax.motion.labels.phase import PhaseLabels, label_phase
from pfnn_jax.motion.trajectory import EXTRAPOLATION_SECONDS
from pfnn_jax.motion.world_motion import WorldMotion, world_motion


@dataclass(frozen=True, eq=False)
class Features:
    """Network rows of one clip, in layout units.

    Attributes:
        x: [N, Dx] float32.
        y: [N, Dy] float32.
        phase: the gating input, float32: [N] radians, or [N, G] for layouts of `phase_size` G: local phases (left
            hand, right hand, left toe, right toe; sin and cos each), or the velocities of the four in metres per
            second.
        frames: [N] frame of the clip that each row describes.
    """

    x: np.ndarray
    y: np.ndarray
    phase: np.ndarray
    frames: np.ndarray


def select_rows(part: Features, rows: slice | np.ndarray) -> Features:
    """Returns the rows that a slice, indices or a mask select."""
    return Features(part.x[rows], part.y[rows], part.phase[rows], part.frames[rows])


def join_rows(parts: Sequence[Features]) -> Features:
    """Returns the rows of all parts, one after another."""
    return Features(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("x", "y", "phase", "frames")))


def clip_features(
    clip: MotionClip | WorldMotion,
    layout: FrameLayout,
    labels: PhaseLabels | None = None,
    gait: np.ndarray | None = None,
    local_phases: np.ndarray | None = None,
) -> Features:
    """Returns the rows of all frames of a clip except the first and the last, which lack a neighbour.

    Layouts with a global phase use only frames i for which i and i+1 are labelled. Trajectories are extrapolated beyond
    the clip's ends (`trajectory_windows`). Under `pfnn2017`, heights are above the ground of a flat clip: the mean
    height of the feet in contact minus `STANDING_HEIGHTS`; terrain is therefore 0, and contacts follow the authors'
    rule of speed alone. Under the other layouts heights are those of the file.

    Args:
        clip: T frames at the layout's frame rate, of a skeleton with roles; a `WorldMotion` saves forward kinematics.
        layout: of J joints, as `layout_for` returns it.
        labels: phase of the T frames, for layouts with a global phase; None calls `label_phase`.
        gait: [T, 6] for `pfnn2017`; None estimates it from speed.
        local_phases: [T, 4, 2] as `clip_local_phases` returns them, for layouts with local phases; None computes them
            with principal axes of this clip alone.

    Raises:
        NoGaitError: for a clip shorter than half a second or, with a global phase, without steps or without two
            labelled frames in a row.
        InputError: if the frame rate, the number of joints or a number of frames is wrong, or a value is not finite.
    """
    _check_clip(clip.clip if isinstance(clip, WorldMotion) else clip, layout)
    motion = world_motion(clip)
    clip, local = motion.clip, localise(motion, layout)
    frames = np.arange(1, clip.num_frames - 1)
    if layout.phase_kind == "global":
        labels = label_phase(motion) if labels is None else labels
        frames, phases = _labelled_frames(clip, labels), labels.phase
    elif layout.phase_kind == "local":
        phases = _flat_phases(clip, clip_local_phases(motion) if local_phases is None else local_phases)
    else:
        phases = end_velocities(layout, local)
    if layout.next_frame:
        rows = next_frame_rows(layout, local, phases, frames)
    else:
        rows = current_frame_rows(layout, local, phases, gait, frames)
    x = _fill(layout.inputs, len(frames), rows.input)
    y = _fill(layout.outputs, len(frames), rows.output)
    require_finite(x, layout.input_names, clip.source, "x")
    require_finite(y, layout.output_names, clip.source, "y")
    return Features(x, y, phases[frames].astype(np.float32), frames)


def _labelled_frames(clip: MotionClip, labels: PhaseLabels) -> np.ndarray:
    if labels.num_frames != clip.num_frames:
        raise InputError(
            clip.source, "phase", f"{labels.num_frames} frames", f"must have {clip.num_frames} like the clip"
        )
    usable = labels.labelled[:-1] & labels.labelled[1:]
    usable[0] = False
    if not usable.any():
        raise NoGaitError(clip.source, "phase", "no two labelled frames in a row", "a clip must contain steps")
    return np.flatnonzero(usable)


def _flat_phases(clip: MotionClip, local_phases: np.ndarray) -> np.ndarray:
    """Returns local phases [T, 4, 2] as [T, 8]."""
    if local_phases.shape != (clip.num_frames, 4, 2):
        rule = f"must be ({clip.num_frames}, 4, 2): frames, end effectors, sin and cos"
        raise InputError(clip.source, "local phases", f"shape {local_phases.shape}", rule)
    return local_phases.reshape(clip.num_frames, 8)


def _check_clip(clip: MotionClip, layout: FrameLayout) -> None:
    if abs(clip.fps - layout.fps) > 0.01:
        raise InputError(
            clip.source, "frame rate", f"{clip.fps:g} fps", f"layout {layout.name} needs {layout.fps:g} fps"
        )
    if clip.skeleton.num_joints != layout.num_joints:
        raise InputError(
            clip.source,
            "skeleton",
            f"{clip.skeleton.num_joints} joints",
            f"layout {layout.name} was made for {layout.num_joints}",
        )
    least = round(EXTRAPOLATION_SECONDS * layout.fps)
    if clip.num_frames < least:
        raise NoGaitError(clip.source, "frames", clip.num_frames, f"must be at least {least}, one trajectory window")
    for name, values in (("root position", clip.root_positions), ("rotation", clip.rotations)):
        bad = ~np.isfinite(values)
        if bad.any():
            place = tuple(int(i) for i in np.argwhere(bad)[0])
            raise InputError(clip.source, f"frame {place[0]}, {name}", values[place], "every value must be finite")


def _fill(blocks: Blocks, rows: int, block: Callable[[str], np.ndarray]) -> np.ndarray:
    filled = np.empty((rows, len(column_names(blocks))), np.float32)
    for name, columns in block_columns(blocks).items():
        filled[:, columns] = block(name).reshape(rows, -1)
    return filled
