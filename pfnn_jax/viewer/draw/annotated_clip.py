"""One clip to be shown, with what is known about its feet and its phase over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.kinematics import forward_kinematics
from pfnn_jax.motion.labels.contacts import foot_contacts
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.local_phase import END_EFFECTORS
from pfnn_jax.motion.labels.phase import PhaseLabels, label_phase, read_phase
from pfnn_jax.viewer.draw.body import upright

FEET = ("left", "right")
SHORTEST = 3  # frames below which there is no speed to tell contacts by
GAP = 0.5  # seconds without a phase that are told of: a step. The ends of a walk lack less


@dataclass(frozen=True, eq=False)
class AnnotatedClip:
    """One clip to show.

    Attributes:
        name: caption.
        clip: the motion, T frames, Y up.
        phase: [T] radians; or local phases [T, B, 2] as vectors (sin, cos) of any length, the longer the surer; NaN
            where there is none; or None.
        contacts: [T, 4] bool: left heel, left toe, right heel, right toe; or [T, 2]: left and right foot; or None.
        note: small print beside the name, as why there is no phase.

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
        """From the first frame to the last."""
        return (self.clip.num_frames - 1) / self.clip.fps

    @property
    def over(self) -> float:
        """Second after which the clip has ended and waits for longer ones: half a frame behind its last."""
        return (self.clip.num_frames - 0.5) / self.clip.fps


@dataclass(frozen=True, eq=False)
class PhaseLine:
    """A phase to draw as a line.

    Attributes:
        name: what it is the phase of; "phase" for that of the whole gait.
        angle: [T] radians in [0, 2π), NaN where there is none.
        weight: [T] in [0, 1]: how much there is of it.
    """

    name: str
    angle: np.ndarray
    weight: np.ndarray


def require_motion(clip: MotionClip, name: str = "clip") -> None:
    """Refuse what no picture can show.

    Args:
        clip: the motion.
        name: what a message calls it where it comes from no file.

    Raises:
        InputError: for a clip without frames, or with positions, rotations or a rate that are not finite.
    """
    place = clip.source or name
    if not (math.isfinite(clip.fps) and clip.fps > 0):
        raise InputError(place, "frame rate", clip.fps, "frames per second must be positive and finite")
    if clip.num_frames < 1:
        raise InputError(place, "frames", 0, "a clip that is shown has at least one")
    for part, values in (("root positions", clip.root_positions), ("rotations", clip.rotations)):
        bad = np.flatnonzero(~np.isfinite(values).reshape(clip.num_frames, -1).all(axis=1))
        if len(bad):
            raise InputError(place, f"frame {bad[0]}", f"{part} not finite", "what is shown is finite")


def annotate(clip: MotionClip, name: str, phase_file: Path | None = None) -> AnnotatedClip:
    """A clip with its contacts and its phase, as far as they can be told; its note says what cannot and why.

    Args:
        clip: the motion, Y up.
        name: caption.
        phase_file: labels that lie beside the clip's file; without it the steps are found from the motion.

    Raises:
        InputError: if the file of labels is bad, or the clip is not to be shown.
    """
    require_motion(clip, name)
    roles = clip.skeleton.roles
    contacts = phase = None
    if roles is not None and clip.num_frames >= SHORTEST:
        positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
        contacts = foot_contacts(positions, roles, clip.fps)
    if phase_file is not None:
        phase = phase_of(read_phase(phase_file, clip.num_frames))
    elif roles is not None:
        with suppress(NoGaitError):
            phase = phase_of(label_phase(clip))
    note = phase_note(phase, clip.fps)
    if roles is None:
        note = "no feet known: no contacts" + (", no phase" if phase is None else "")
    return AnnotatedClip(name, clip, phase, contacts, note)


def phase_note(phase: np.ndarray | None, fps: float) -> str:
    """What is to be said beside a phase that comes from steps; empty where no more than a moment lacks one."""
    if phase is None:
        return "no steps: no phase"
    lacking = np.asarray(np.isnan(phase).any(axis=tuple(range(1, phase.ndim))))
    if lacking.all():
        return "no steps: no phase"
    gaps = np.diff(runs(lacking))
    return "phase only where there are steps" if (gaps >= GAP * fps).any() else ""


def phase_of(labels: PhaseLabels) -> np.ndarray:
    """[T] radians, NaN in frames without a label."""
    return np.where(labels.labelled, labels.phase, np.nan)


def cut_seconds(annotated: AnnotatedClip, start: float, seconds: float | None) -> AnnotatedClip:
    """The part of a annotated from second `start` on; phase and contacts stay those of the whole clip.

    Raises:
        InputError: if nothing of the clip lies there, or the seconds are not finite.
    """
    clip = annotated.clip
    known = math.isfinite(start) and (seconds is None or math.isfinite(seconds))
    if not (known and 0 <= start < annotated.over and (seconds is None or seconds > 0)):
        shown = f"from {start:g}" if seconds is None else f"{seconds:g} from {start:g}"
        rule = f"what is shown lies in the clip's {annotated.seconds:.1f} seconds"
        raise InputError(clip.source or annotated.name, "start and seconds", shown, rule)
    first = min(round(start * clip.fps), clip.num_frames - 1)
    length = annotated.seconds if seconds is None else min(seconds, annotated.seconds)
    return cut_frames(annotated, first, min(clip.num_frames, first + round(length * clip.fps) + 1))


def cut_frames(annotated: AnnotatedClip, start: int, stop: int) -> AnnotatedClip:
    """Frames start to stop (exclusive) of a annotated; phase and contacts stay those of the whole clip.

    Raises:
        InputError: unless 0 <= start < stop <= number of frames.
    """
    clip = cut(annotated.clip, start, stop)
    phase, contacts = (
        None if values is None else values[start:stop] for values in (annotated.phase, annotated.contacts)
    )
    note = annotated.note
    if note and note == phase_note(annotated.phase, clip.fps):
        note = phase_note(phase, clip.fps)  # of the part that is shown
    return replace(annotated, clip=clip, phase=phase, contacts=contacts, note=note)


def phase_lines(annotated: AnnotatedClip) -> list[PhaseLine]:
    """The phases of a annotated, one line each; none without a phase."""
    if annotated.phase is None:
        return []
    finite = np.isfinite(annotated.phase)
    phase = np.where(finite, annotated.phase, 0.0)
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


def foot_bars(annotated: AnnotatedClip) -> list[tuple[str, np.ndarray]]:
    """(left or right, runs [R, 2] of first and past-the-last frame) in which each foot stands."""
    if annotated.contacts is None:
        return []
    half = annotated.contacts.shape[1] // 2
    feet = (annotated.contacts[:, :half], annotated.contacts[:, half:])
    return [(name, runs(np.any(parts, axis=1))) for name, parts in zip(FEET, feet, strict=True)]


def runs(on: np.ndarray) -> np.ndarray:
    """First and past-the-last index [R, 2] of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    return edges.reshape(-1, 2)


def annotate_clips(clips: Sequence[MotionClip], names: Sequence[str] | None = None) -> list[AnnotatedClip]:
    """Upright clips with their labels, named by their style and content where no names are given.

    Raises:
        ValueError: if names are not one for each clip.
        InputError: for a clip that cannot be shown, see `require_motion`.
    """
    if names is not None and len(names) != len(clips):
        raise ValueError(f"There are {len(clips)} clips and {len(names)} names.")
    for number, clip in enumerate(clips):
        require_motion(clip, caption(clip, number))
    captions = list(names) if names is not None else [caption(clip, number) for number, clip in enumerate(clips)]
    return [annotate(upright(clip), name) for clip, name in zip(clips, captions, strict=True)]


def caption(clip: MotionClip, number: int = 0) -> str:
    """A clip's style and content, else its file's name, else its number."""
    known = " ".join(word for word in (clip.style, clip.content) if word and word != "unknown")
    return known or Path(clip.source).stem or f"clip {number + 1}"
