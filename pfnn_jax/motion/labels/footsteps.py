"""Times at which each foot comes down: alternating steps, found from the speeds of the feet.

A swing is an interval in which one foot is much faster than the other. Swings that alternate between the feet are
steps, in any direction, with or without a flight phase. After its swing a foot is flat once heel and toe are both slow.
If the other foot is on the ground too, the contact is timed halfway between foot flat and the other foot's toe-off:
this is when the weight passes over, and agrees with labels made by hand. (Compared with these, foot flat is early in
slow steps, and touch-down earlier still.) Thresholds scale with leg length and, in fast gaits, with the swing's speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.labels.contacts import foot_joints, measured_leg_length
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

# Speeds are in leg lengths per second.
SWING = 0.6
"""A foot that is faster than the other by this is swinging."""

HEEL_DOWN, TOE_DOWN = 0.4, 0.2
"""A foot is flat while its heel and toe are slower than these."""

SWING_SHARE = 0.08
"""... or slower than this share of the peak speed of its swing."""

PASSING = 0.5
"""Share of the double support after which the weight passes over; tuned on clips with labels made by hand."""

TOE_OFF = 0.6
"""A foot leaves the ground when its toe becomes faster than this."""

MOVING = 0.25
"""While hips and feet are all slower than this the character stands."""

MAX_HALF_CYCLE = 1.3
"""Seconds between two contacts beyond which the character has paused."""

MIN_CONTACTS = 3
"""Contacts that make a run of steps a gait even where the hips do not travel: one whole cycle."""

MIN_TRAVEL = 0.5
"""Leg lengths that the hips must travel in a run of only two contacts, as in takes of a single cycle."""

EXTENSION = 1.2
"""Half cycles by which a run may extend beyond its first and last contact."""

SPEED_SMOOTHING = 1 / 60  # seconds; more would blur the onset of a contact
SWING_SMOOTHING = 0.05  # seconds; enough to bridge ripples within a swing


class NoGaitError(InputError):
    """A valid clip without a gait cycle: it has no steps or is too short. `prepare` skips such clips."""


@dataclass(frozen=True, eq=False)
class StepRun:
    """An uninterrupted run of alternating contacts.

    Attributes:
        times: [n] contacts in frames, fractional, increasing.
        left_first: whether the first contact is of the left foot.
        start, stop: range of frames around the contacts in which the character moves.
    """

    times: np.ndarray
    left_first: bool
    start: int
    stop: int


def find_steps(clip: MotionClip | WorldMotion) -> list[StepRun]:
    """Finds the runs of alternating steps in a clip.

    Args:
        clip: of a skeleton with roles.

    Raises:
        NoGaitError: if there are none.
        InputError: if the skeleton has no roles.
    """
    motion = world_motion(clip)
    clip, positions, roles = motion.clip, motion.positions, motion.roles
    if clip.num_frames < 3:
        raise NoGaitError(clip.source, "frames", clip.num_frames, "steps need at least 3")
    leg = measured_leg_length(positions, roles)
    joints = [*foot_joints(roles), roles.hips]
    smooth = gaussian_filter(positions[:, joints], SPEED_SMOOTHING * motion.fps)
    speed = np.linalg.norm(np.gradient(smooth, 1 / clip.fps, axis=0), axis=-1) / leg
    contacts = _contacts(speed[:, :4].reshape(-1, 2, 2), clip.fps)
    moving = gaussian_filter(speed.max(axis=1), SWING_SMOOTHING * motion.fps) > MOVING
    hips = positions[:, roles.hips][:, [0, 2]] / leg
    runs = [run for run in _split(contacts, clip.fps) if _is_gait(run[0], hips)]
    if not runs:
        raise NoGaitError(
            clip.source,
            "phase",
            f"{len(contacts)} foot contacts in {clip.num_frames} frames",
            "no steps: feet must come down alternately while the character travels",
        )
    return _bound(runs, moving)


def half_cycles(times: np.ndarray) -> tuple[float, float]:
    """Returns the lengths in frames of the half cycle before the first contact and of the one after the last.

    Left and right steps may differ in length, so each is taken to be as long as the nearest half cycle of the same
    foot, the second from that end, or as the only one if there are two contacts.
    """
    lengths = np.diff(times)
    return (lengths[1], lengths[-2]) if len(lengths) > 1 else (lengths[0], lengths[0])


def _contacts(speed: np.ndarray, fps: float) -> list[tuple[float, int]]:
    """Returns (frame, foot) of every contact in time order; foot 0 is the left. `speed` is [T, foot, (heel, toe)]."""
    mean = gaussian_filter(speed.mean(axis=-1), SWING_SMOOTHING * fps)
    swings = _swings(mean[:, 0] - mean[:, 1])
    peaks = [start + int(np.argmax(mean[start:stop, foot])) for foot, start, stop in swings]
    found = []
    for index, (foot, _, _) in enumerate(swings):
        # swings alternate: the next one is of the other foot, the one after that of this foot again
        end = swings[index + 2][1] if index + 2 < len(swings) else len(speed)
        flat = _foot_flat(speed[peaks[index] : end, foot])
        if flat is None:
            continue
        time = peaks[index] + flat
        if index + 1 < len(swings):
            time += PASSING * max(0.0, _toe_off(speed[: peaks[index + 1], 1 - foot, 1]) - time)
        found.append((time, foot))
    return sorted(found)


def _foot_flat(speed: np.ndarray) -> float | None:
    """Returns the fractional frame at which heel and toe [T, 2] are first slow; frame 0 is the peak of the swing."""
    allowed = np.maximum([HEEL_DOWN, TOE_DOWN], SWING_SHARE * speed[0])
    return _first_below((speed / allowed).max(axis=-1), 1.0)


def _toe_off(speed: np.ndarray) -> float:
    """Returns the last frame at which the toe [T] is slow; the array ends at the peak of the swing."""
    slow = np.flatnonzero(speed < TOE_OFF)
    return float(slow[-1]) if len(slow) else 0.0


def _swings(lead: np.ndarray) -> list[tuple[int, int, int]]:
    """Returns (foot, start, stop) of every interval in which one foot is faster; adjacent ones of a foot are merged."""
    side = np.where(lead > SWING, 1, np.where(lead < -SWING, 2, 0))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], side, [0]])))
    swings: list[tuple[int, int, int]] = []
    for start, stop in zip(edges[:-1], edges[1:], strict=True):
        if side[start] == 0:
            continue
        foot = int(side[start]) - 1
        if swings and swings[-1][0] == foot:
            swings[-1] = (foot, swings[-1][1], int(stop))
        else:
            swings.append((foot, int(start), int(stop)))
    return swings


def _first_below(values: np.ndarray, limit: float) -> float | None:
    """Returns the fractional index at which values first fall below the limit."""
    below = np.flatnonzero(values < limit)
    if not len(below):
        return None
    i = int(below[0])
    if i == 0:
        return 0.0
    return i - (limit - values[i]) / (values[i - 1] - values[i])


def _split(contacts: list[tuple[float, int]], fps: float) -> list[tuple[np.ndarray, bool]]:
    """Splits contacts into runs (times, left first) that alternate without a pause."""
    runs: list[list[tuple[float, int]]] = []
    for time, foot in contacts:
        last = runs[-1][-1] if runs else None
        if last is None or last[1] == foot or time - last[0] > MAX_HALF_CYCLE * fps or time <= last[0]:
            runs.append([])
        runs[-1].append((time, foot))
    return [(np.array([t for t, _ in run]), run[0][1] == 0) for run in runs]


def _is_gait(times: np.ndarray, hips: np.ndarray) -> bool:
    if len(times) != 2:
        return len(times) >= MIN_CONTACTS
    first, last = (hips[min(int(time), len(hips) - 1)] for time in times)
    return bool(np.linalg.norm(last - first) > MIN_TRAVEL)


def _bound(runs: list[tuple[np.ndarray, bool]], moving: np.ndarray) -> list[StepRun]:
    """Extends each run beyond its contacts for as long as the character moves, up to halfway to the next run."""
    bounded = []
    for index, (times, left_first) in enumerate(runs):
        before, after = half_cycles(times)
        earliest, latest = times[0] - EXTENSION * before, times[-1] + EXTENSION * after
        if index > 0:
            earliest = max(earliest, (times[0] + runs[index - 1][0][-1]) / 2)
        if index + 1 < len(runs):
            latest = min(latest, (times[-1] + runs[index + 1][0][0]) / 2)
        first, last = int(np.ceil(times[0])), int(times[-1])
        start, stop = first, last + 1
        while start > max(0, earliest) and moving[start - 1]:
            start -= 1
        while stop <= min(len(moving) - 1, latest) and moving[stop]:
            stop += 1
        bounded.append(StepRun(times, left_first, start, stop))
    return bounded
