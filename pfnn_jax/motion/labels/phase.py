"""Gait phase: 0 where the right foot comes down, π where the left foot does, and linear in time in between.

Labels are computed from the motion (`label_phase`) or read from `.phase` files, which can be corrected by hand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.io.files import refuse_existing, write_whole
from pfnn_jax.io.text_rows import read_rows
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.ground import wrap_angle
from pfnn_jax.motion.labels.footsteps import StepRun, find_steps, half_cycles
from pfnn_jax.motion.world_motion import WorldMotion

CYCLE = 2 * np.pi
ROUNDING = 1e-9  # radians; keeps whole cycles at exactly 0 when they are wrapped


@dataclass(frozen=True, eq=False)
class PhaseLabels:
    """Phase of every frame of a clip.

    Attributes:
        phase: [T] radians in [0, 2π); 0 in frames without a label.
        labelled: [T] bool, whether a frame has a label.
        contacts_right: indices of frames at which the right foot comes down (phase 0).
        contacts_left: indices of frames at which the left foot comes down (phase π).
    """

    phase: np.ndarray
    labelled: np.ndarray
    contacts_right: np.ndarray
    contacts_left: np.ndarray

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.phase)


def label_phase(clip: MotionClip | WorldMotion) -> PhaseLabels:
    """Labels the phase of a clip from its foot contacts.

    Steps are found by `footsteps.find_steps`. Between two contacts the phase is linear in the time in which the
    character moves. Before the first and after the last contact it is extrapolated at the rate of the nearest half
    cycle of the same foot, for as long as the character moves and by about half a cycle at most: without this a short
    walk would lose a quarter of its frames, and a short run more than half. Frames in which the character stands have
    no label, nor do those around a contact that is not seen because the feet skate.

    Args:
        clip: of a skeleton with roles; a `WorldMotion` saves forward kinematics.

    Raises:
        NoGaitError: if there are no alternating steps.
        InputError: if the skeleton has no roles.
    """
    phases = [(run.frames, np.pi * _half_cycles(run)) for run in find_steps(clip)]
    return _labels(clip.num_frames, [part for phase in phases for part in _successive(*phase)])


def mirror_phase(labels: PhaseLabels) -> PhaseLabels:
    """Returns the labels of the mirrored clip: contacts exchanged, and the phase shifted by half a cycle."""
    phase = np.where(labels.labelled, (labels.phase + np.pi) % CYCLE, 0.0)
    return replace(labels, phase=phase, contacts_right=labels.contacts_left, contacts_left=labels.contacts_right)


def cut_phase(labels: PhaseLabels, start: int, stop: int) -> PhaseLabels:
    """Returns the labels of frames start to stop (exclusive), with frame `start` as frame 0."""
    right, left = ((c[(c >= start) & (c < stop)] - start) for c in (labels.contacts_right, labels.contacts_left))
    return PhaseLabels(labels.phase[start:stop], labels.labelled[start:stop], right, left)


def pad_phase(labels: PhaseLabels, start: int, num_frames: int) -> PhaseLabels:
    """Returns labels for all frames of a file, of which frame `start` is the first that `labels` has.

    Args:
        labels: of some successive frames.
        start: index in the file of the first of them.
        num_frames: of the file; the others have no label.
    """
    after = num_frames - start - labels.num_frames
    phase, labelled = (np.pad(values, (start, after)) for values in (labels.phase, labels.labelled))
    return PhaseLabels(phase, labelled, labels.contacts_right + start, labels.contacts_left + start)


def read_phase(path: Path, num_frames: int | None = None) -> PhaseLabels:
    """Reads a `.phase` file: one number in cycles [0, 1] for each frame of the BVH file, where 1 equals 0.

    Frames in a run of two or more zeros, or with a zero at either end of the file, have no label: files labelled by
    hand hold 0 before the first and after the last step.

    Args:
        path: text file.
        num_frames: frames of the BVH file; None does not check the number of lines.

    Raises:
        InputError: if the number of lines is wrong, a value is not a number in [0, 1], or no frame has a label.
    """
    cycles = read_rows(path, 1, num_frames)[:, 0]
    zero = np.concatenate([[True], cycles == 0, [True]])
    labelled = ~(zero[1:-1] & (zero[:-2] | zero[2:]))
    if not labelled.any():
        raise InputError(path, "file", f"{len(cycles)} zeros", "at least one frame must have a phase")
    unwrapped = np.full(len(cycles), np.nan)
    for start, stop in runs_of(labelled):
        unwrapped[start:stop] = np.unwrap(cycles[start:stop] * CYCLE)
    return _labels(len(cycles), [(np.arange(*run), unwrapped[slice(*run)]) for run in runs_of(labelled)])


def write_phase(path: Path, labels: PhaseLabels, overwrite: bool = False) -> None:
    """Writes a `.phase` file: one line per frame, in cycles with six decimals; frames without a label are 0.

    A labelled 0 next to a frame without a label, or at an end of the file, is written as 1, so that reading restores
    every label. Only a gap of a single frame would be read as a contact; it is widened by a frame.

    Args:
        path: text file.
        labels: at the frame rate of the BVH file.
        overwrite: whether to replace an existing file.

    Raises:
        InputError: if the file exists and `overwrite` is false, or it cannot be written.
    """
    path = Path(path)
    refuse_existing(path, overwrite)
    labelled = labels.labelled.copy()
    labelled[[stop for start, stop in runs_of(~labels.labelled) if stop - start == 1 and stop < len(labelled)]] = False
    values = np.round(np.where(labelled, labels.phase / CYCLE, 0.0), 6)
    zero = np.concatenate([[True], values == 0, [True]])
    values[labelled & zero[1:-1] & (zero[:-2] | zero[2:])] = 1.0
    write_whole(path, "".join(f"{value:.6f}\n" for value in values))


def resample_phase(labels: PhaseLabels, fps_from: float, fps_to: float, num_frames: int) -> PhaseLabels:
    """Resamples labels to another frame rate, at which frame k is at k / fps_to seconds.

    A new frame has a label if both neighbouring frames of the source have one.

    Args:
        labels: at `fps_from`.
        fps_from: frames per second of the labels.
        fps_to: frames per second of the result.
        num_frames: frames of the result.
    """
    source = np.arange(num_frames) * (fps_from / fps_to)
    source = np.where(np.abs(source - np.round(source)) < 1e-6, np.round(source), source)
    below = np.minimum(source.astype(int), labels.num_frames - 1)
    above = np.minimum(np.ceil(source).astype(int), labels.num_frames - 1)
    unwrapped = np.full(labels.num_frames, np.nan)
    for start, stop in runs_of(labels.labelled):
        unwrapped[start:stop] = np.unwrap(labels.phase[start:stop])
    between = source - below
    # runs are unwrapped separately; the NaN between two runs keeps a frame from mixing both
    values = unwrapped[below] + between * wrap_angle(unwrapped[above] - unwrapped[below])
    continuous = np.full(num_frames, np.nan)
    for start, stop in runs_of(np.isfinite(values)):
        continuous[start:stop] = np.unwrap(values[start:stop])
    return _labels(num_frames, [(np.arange(*run), continuous[slice(*run)]) for run in runs_of(np.isfinite(values))])


def _half_cycles(run: StepRun) -> np.ndarray:
    """Returns half cycles at a run's frames: right contacts are even, left contacts odd.

    Between contacts they are interpolated linearly, beyond both ends extrapolated at the rates of `half_cycles`.
    """
    times, halves = run.times, run.halves + (1.0 if run.left_first else 0.0)
    before, after = half_cycles(times, halves)
    values = np.interp(run.clock, times, halves)
    values = np.where(run.clock < times[0], halves[0] + (run.clock - times[0]) * (1 / before), values)
    return np.where(run.clock > times[-1], halves[-1] + (run.clock - times[-1]) * (1 / after), values)


def _successive(frames: np.ndarray, values: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Splits frames and their values into parts of successive frames."""
    cuts = np.flatnonzero(np.diff(frames) > 1) + 1
    return list(zip(np.split(frames, cuts), np.split(values, cuts), strict=True))


def _labels(num_frames: int, parts: list[tuple[np.ndarray, np.ndarray]]) -> PhaseLabels:
    """Returns labels from parts of successive frames, each with its unwrapped phase in radians.

    Parts may adjoin each other with different phases; crossings are therefore found in each part alone.
    """
    labelled, phase = np.zeros(num_frames, bool), np.zeros(num_frames)
    right, left = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for frames, unwrapped in parts:
        labelled[frames], phase[frames] = True, unwrapped % CYCLE
        right.append(frames[_crossings(unwrapped)])
        left.append(frames[_crossings(unwrapped - np.pi)])
    phase = np.where(np.minimum(phase, CYCLE - phase) < ROUNDING, 0.0, phase)
    return PhaseLabels(phase, labelled, *(np.unique(np.concatenate(contacts)) for contacts in (right, left)))


def _crossings(unwrapped: np.ndarray) -> np.ndarray:
    """Returns the frame nearest to each whole cycle that the phase reaches or passes."""
    cycles = unwrapped / CYCLE
    nearest = np.round(cycles)
    if len(cycles) < 2:
        return np.flatnonzero(np.abs(cycles - nearest) < 1e-6)
    away = np.abs(cycles - nearest)
    # the frame nearest to a crossing is less than half a frame's advance from the whole cycle
    step = np.abs(np.gradient(cycles))
    near = away <= np.maximum(0.5 * step, 1e-6)
    frames = np.flatnonzero(near)
    _, first = np.unique(nearest[frames], return_index=True)
    return np.sort(frames[first])


def runs_of(mask: np.ndarray) -> list[tuple[int, int]]:
    """Returns (start, stop) of every run of True in a mask [T]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
