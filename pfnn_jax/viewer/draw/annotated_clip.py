"""A clip to show, with its caption, its foot contacts and its phase over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.clip_files import read_clip
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.local_phase import END_EFFECTORS
from pfnn_jax.motion.labels.phase import PhaseLabels, label_phase, read_phase
from pfnn_jax.viewer.draw.body import upright

FEET = ("left", "right")
SHORTEST = 3  # frames; fewer have no speed to detect contacts by
GAP = 0.5  # seconds without a phase that the note mentions: one step. The ends of a walk lack less


class HasClip(Protocol):
    """A record with a clip, such as `LabelledClip`, `Generated` or `AnnotatedClip`."""

    @property
    def clip(self) -> MotionClip:
        """The motion."""
        ...


Showable = MotionClip | HasClip | str | Path
"""What the viewer's functions show: a clip, a record with one, or the path of a BVH or glTF file."""


@dataclass(frozen=True, eq=False)
class PhaseLine:
    """A phase to draw as a line.

    Attributes:
        name: the end effector whose phase it is; "phase" for the gait cycle's.
        angle: [T] radians in [0, 2π), NaN in frames without a phase.
        weight: [T] in [0, 1], the phase's strength.
    """

    name: str
    angle: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True, eq=False)
class AnnotatedClip:
    """A clip with everything that is shown of it.

    Attributes:
        name: caption.
        clip: the motion, T frames, Y up.
        phase: [T] radians; or local phases [T, B, 2] as vectors (sin, cos) whose length is their strength; NaN in
            frames without a phase; or None.
        contacts: [T, 4] bool: left heel, left toe, right heel, right toe; or [T, 2]: left and right foot; or None.
        note: small print after the name, such as the reason why there is no phase.

    Raises:
        ValueError: for a phase or contacts of another shape.
        InputError: for a clip without frames, or with positions, rotations or a rate that are not finite.
    """

    name: str
    clip: MotionClip
    phase: np.ndarray | None = None
    contacts: np.ndarray | None = None
    note: str = ""

    def __post_init__(self) -> None:
        require_motion(self.clip, self.name)
        frames = self.clip.num_frames
        for name, values in (("phase", self.phase), ("contacts", self.contacts)):
            if values is not None and len(values) != frames:
                raise ValueError(f"{name} of {self.name!r} has {len(values)} frames, its clip {frames}.")
        if self.phase is not None and self.phase.shape[1:] not in ((), (self.phase.size // (2 * frames), 2)):
            raise ValueError(f"phase of {self.name!r} is {list(self.phase.shape)}, must be [T] or [T, B, 2].")
        if self.contacts is not None and self.contacts.shape[1:] not in ((2,), (4,)):
            raise ValueError(f"contacts of {self.name!r} are {list(self.contacts.shape)}, must be [T, 2 or 4].")

    @property
    def seconds(self) -> float:
        """Seconds from the first frame to the last."""
        return (self.clip.num_frames - 1) / self.clip.fps

    @property
    def end(self) -> float:
        """Second from which the clip is shown as ended, while longer ones play: half a frame after its last frame."""
        return (self.clip.num_frames - 0.5) / self.clip.fps

    def cut_seconds(self, start: float, seconds: float | None) -> AnnotatedClip:
        """Returns the part from second `start` on; phase and contacts are those of the whole clip.

        Raises:
            InputError: if no part of the clip lies there, or the seconds are not finite.
        """
        clip = self.clip
        finite = math.isfinite(start) and (seconds is None or math.isfinite(seconds))
        if not (finite and 0 <= start < self.end and (seconds is None or seconds > 0)):
            shown = f"from {start:g}" if seconds is None else f"{seconds:g} from {start:g}"
            rule = f"must lie within the clip's {self.seconds:.1f} seconds"
            raise InputError(clip.source or self.name, "start and seconds", shown, rule)
        first = min(round(start * clip.fps), clip.num_frames - 1)
        length = self.seconds if seconds is None else min(seconds, self.seconds)
        return self.cut_frames(first, min(clip.num_frames, first + round(length * clip.fps) + 1))

    def cut_frames(self, start: int, stop: int) -> AnnotatedClip:
        """Returns frames start to stop (exclusive); phase and contacts are those of the whole clip.

        Raises:
            InputError: unless 0 <= start < stop <= number of frames.
        """
        clip = cut(self.clip, start, stop)
        phase, contacts = (None if values is None else values[start:stop] for values in (self.phase, self.contacts))
        note = self.note
        if note and note == phase_note(self.phase, clip.fps):
            note = phase_note(phase, clip.fps)  # that of the part
        return replace(self, clip=clip, phase=phase, contacts=contacts, note=note)

    def phase_lines(self) -> list[PhaseLine]:
        """Returns one line for each phase; none without a phase."""
        if self.phase is None:
            return []
        finite = np.isfinite(self.phase)
        phase = np.where(finite, self.phase, 0.0)
        if phase.ndim == 1:
            return [PhaseLine("phase", np.where(finite, phase % (2 * np.pi), np.nan), finite.astype(float))]
        known = finite.all(axis=-1)  # [T, B]
        length = np.where(known, np.linalg.norm(phase, axis=-1), 0.0)
        longest = max(float(np.percentile(length[known], 95)), 1e-9) if known.any() else 1.0
        angle = np.where(known, np.arctan2(phase[..., 0], phase[..., 1]) % (2 * np.pi), np.nan)
        weight = np.clip(length / longest, 0.0, 1.0)
        bones = phase.shape[1]
        names = END_EFFECTORS if bones == len(END_EFFECTORS) else [str(bone + 1) for bone in range(bones)]
        return [PhaseLine(names[bone], angle[:, bone], weight[:, bone]) for bone in range(bones)]

    def foot_bars(self) -> list[tuple[str, np.ndarray]]:
        """Returns (left or right, intervals [R, 2] of first and past-the-last frame) in which each foot is down."""
        if self.contacts is None:
            return []
        half = self.contacts.shape[1] // 2
        feet = (self.contacts[:, :half], self.contacts[:, half:])
        return [(name, intervals(np.any(parts, axis=1))) for name, parts in zip(FEET, feet, strict=True)]


def require_motion(clip: MotionClip, name: str = "clip") -> None:
    """Refuses a clip that cannot be shown.

    Args:
        clip: the motion.
        name: how the message names a clip that was not read from a file.

    Raises:
        InputError: for a clip without frames, or with positions, rotations or a rate that are not finite.
    """
    place = clip.source or name
    if not (math.isfinite(clip.fps) and clip.fps > 0):
        raise InputError(place, "frame rate", clip.fps, "frames per second must be positive and finite")
    if clip.num_frames < 1:
        raise InputError(place, "frames", 0, "must have at least one frame")
    for part, values in (("root positions", clip.root_positions), ("rotations", clip.rotations)):
        bad = np.flatnonzero(~np.isfinite(values).reshape(clip.num_frames, -1).all(axis=1))
        if len(bad):
            raise InputError(place, f"frame {bad[0]}", f"{part} not finite", "all frames must be finite")


def annotate(clip: MotionClip, name: str, phase_file: Path | None = None) -> AnnotatedClip:
    """Returns a clip with the contacts and the phase found in its motion; its note says what was not found and why.

    Args:
        clip: the motion, Y up.
        name: caption.
        phase_file: `.phase` file with the clip's labels, used instead of detecting its steps.

    Raises:
        InputError: if the file of labels is bad, or the clip cannot be shown.
    """
    require_motion(clip, name)
    roles = clip.skeleton.roles
    contacts = phase = None
    if roles is not None and clip.num_frames >= SHORTEST:
        positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
        contacts = foot_contacts(positions, roles, clip.fps)
    phase = detect_phase(clip) if phase_file is None else phase_of(read_phase(phase_file, clip.num_frames))
    note = phase_note(phase, clip.fps)
    if roles is None:
        note = "no feet known: no contacts" + (", no phase" if phase is None else "")
    return AnnotatedClip(name, clip, phase, contacts, note)


def annotate_clips(clips: Sequence[Showable], names: Sequence[str] | None = None) -> list[AnnotatedClip]:
    """Returns upright clips with their contacts and phases; clips that are annotated already keep their annotations.

    Args:
        clips: what to show.
        names: captions, one for each clip; by default style and content, or the file's name.

    Raises:
        ValueError: if names are not one for each clip.
        InputError: for anything that is not a clip, a file that cannot be read, or a clip that cannot be shown.
    """
    if names is not None and len(names) != len(clips):
        raise ValueError(f"There are {len(clips)} clips and {len(names)} names.")
    motions = [as_clip(clip, number) for number, clip in enumerate(clips)]
    for number, motion in enumerate(motions):
        require_motion(motion, caption(motion, number))
    annotated = []
    for number, (clip, motion) in enumerate(zip(clips, motions, strict=True)):
        if isinstance(clip, AnnotatedClip):
            annotated.append(clip if names is None else replace(clip, name=names[number]))
        else:
            annotated.append(annotate(upright(motion), caption(motion, number) if names is None else names[number]))
    return annotated


def as_clip(shown: Showable, number: int = 0) -> MotionClip:
    """Returns the clip of anything that can be shown.

    Args:
        shown: a clip, a record with one, or the path of a BVH or glTF file.
        number: position among the arguments, for the message.

    Raises:
        InputError: for anything else, or for a file that cannot be read.
    """
    if isinstance(shown, str | Path):
        return read_clip(Path(shown))
    clip = shown if isinstance(shown, MotionClip) else getattr(shown, "clip", None)
    if not isinstance(clip, MotionClip):
        rule = "pass a MotionClip, a record with one, or the path of a BVH or glTF file"
        raise InputError("viewer", f"clip {number + 1}", type(shown).__name__, rule)
    return clip


def caption(clip: MotionClip, number: int = 0) -> str:
    """Returns a clip's style and content, else its file's name, else its number."""
    known = " ".join(word for word in (clip.style, clip.content) if word and word != "unknown")
    return known or Path(clip.source).stem or f"clip {number + 1}"


def detect_phase(clip: MotionClip) -> np.ndarray | None:
    """Returns the phase [T] found from a clip's steps, NaN in unlabelled frames; None without steps or known feet."""
    if clip.skeleton.roles is not None:
        with suppress(NoGaitError):
            return phase_of(label_phase(clip))
    return None


def phase_of(labels: PhaseLabels) -> np.ndarray:
    """Returns [T] radians, NaN in frames without a label."""
    return np.where(labels.labelled, labels.phase, np.nan)


def phase_note(phase: np.ndarray | None, fps: float) -> str:
    """Returns the note on a phase found from steps; empty if it has no gap of `GAP` seconds or more."""
    if phase is None:
        return "no steps: no phase"
    lacking = np.asarray(np.isnan(phase).any(axis=tuple(range(1, phase.ndim))))
    if lacking.all():
        return "no steps: no phase"
    gaps = np.diff(intervals(lacking))
    return "phase only where there are steps" if (gaps >= GAP * fps).any() else ""


def intervals(on: np.ndarray) -> np.ndarray:
    """Returns the first and the past-the-last index [R, 2] of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    return edges.reshape(-1, 2)
