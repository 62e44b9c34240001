"""When each foot comes down: alternating steps found from the speeds of the feet.

A swing is a stretch in which one foot is much faster than the other; swings that alternate between the feet are
steps, whatever their direction, with or without a flight phase. After its swing a foot is flat where heel and toe are
both slow. If the other foot stands as well, until it leaves for its own swing, then the contact is timed halfway
between: where the weight passes over, as labels made by hand have it. (Against those, foot flat alone is early in slow
steps, and touch-down earlier still.) The limits scale with the skeleton's legs and, in fast gaits, with the speed of
the swing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.labels.contacts import foot_joints, measured_leg_length
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

# speeds in leg lengths per second
SWING = 0.6
"""A foot this much faster than the other is swinging."""

HEEL_DOWN, TOE_DOWN = 0.4, 0.2
"""A foot is flat when its heel and toe are slower than this."""

SWING_SHARE = 0.08
"""... or than this share of its swing's greatest speed."""

PASSING = 0.5
"""Share of the double support after which the weight passes over: the best on clips with labels made by hand."""

TOE_OFF = 0.6
"""A foot leaves the ground when its toe becomes faster than this."""

MOVING = 0.25
"""Below this speed of hips and feet the character stands."""

MAX_HALF_CYCLE = 1.3
"""Seconds between two contacts beyond which the character has paused."""

MIN_CONTACTS = 3
"""Contacts of the shortest run that is a gait whatever the hips do: one whole cycle."""

MIN_TRAVEL = 0.5
"""Leg lengths that the hips travel between two contacts where these are all there is, as in takes of one cycle."""

EXTENSION = 1.2
"""Half cycles by which a run may go on beyond its first and last contact."""

SPEED_SMOOTHING = 1 / 60  # seconds; the onset's sharpness
SWING_SMOOTHING = 0.05  # seconds; bridges ripple within a swing


class NoGaitError(InputError):
    """A clip that is sound but has no gait to learn from: no steps, or too short. One such in many is left out."""


@dataclass(frozen=True, eq=False)
class StepRun:
    """Alternating contacts without a pause.

    Attributes:
        times: [n] contacts in frames, fractional, increasing.
        left_first: whether the first is the left foot's.
        start, stop: frames over which the character moves, around the contacts.
    """

    times: np.ndarray
    left_first: bool
    start: int
    stop: int


def find_steps(clip: MotionClip | WorldMotion) -> list[StepRun]:
    """Runs of alternating steps.

    Args:
        clip: of a skeleton with roles.

    Raises:
        NoGaitError: where there are no runs.
        InputError: where the skeleton has no roles.
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
            "no steps: feet must come down in turn while the character travels",
        )
    return _bound(runs, moving)


def half_cycles(times: np.ndarray) -> tuple[float, float]:
    """Frames of the half cycle before the first contact and of the one after the last.

    A step with the left foot may last longer than one with the right: each is taken as long as the nearest half cycle
    of the same foot, which is the second from that end; the only one, where there are but two contacts.
    """
    lengths = np.diff(times)
    return (lengths[1], lengths[-2]) if len(lengths) > 1 else (lengths[0], lengths[0])


def _contacts(speed: np.ndarray, fps: float) -> list[tuple[float, int]]:
    """(frame, foot) of every contact in time order; foot 0 is the left. speed is [T, foot, (heel, toe)]."""
    mean = gaussian_filter(speed.mean(axis=-1), SWING_SMOOTHING * fps)
    swings = _swings(mean[:, 0] - mean[:, 1])
    peaks = [start + int(np.argmax(mean[start:stop, foot])) for foot, start, stop in swings]
    found = []
    for index, (foot, _, _) in enumerate(swings):
        # swings alternate: the next is the other foot's, the one after this foot's again
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
    """Fractional frame at which heel and toe [T, 2] are first slow after the peak of a swing, at frame 0."""
    allowed = np.maximum([HEEL_DOWN, TOE_DOWN], SWING_SHARE * speed[0])
    return _first_below((speed / allowed).max(axis=-1), 1.0)


def _toe_off(speed: np.ndarray) -> float:
    """Last frame before the peak of a swing, at the end of the array, at which the toe [T] is slow."""
    slow = np.flatnonzero(speed < TOE_OFF)
    return float(slow[-1]) if len(slow) else 0.0


def _swings(lead: np.ndarray) -> list[tuple[int, int, int]]:
    """(foot, start, stop) of every stretch in which one foot leads; stretches of the same foot in a row are joined."""
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
    """Fractional index at which values first fall below the limit."""
    below = np.flatnonzero(values < limit)
    if not len(below):
        return None
    i = int(below[0])
    if i == 0:
        return 0.0
    return i - (limit - values[i]) / (values[i - 1] - values[i])


def _split(contacts: list[tuple[float, int]], fps: float) -> list[tuple[np.ndarray, bool]]:
    """Runs (times, left first) of alternating contacts without a pause between two of them."""
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
    """How far each run goes on beyond its contacts: while the character moves, and clear of its neighbours."""
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
