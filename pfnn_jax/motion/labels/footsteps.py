"""Times at which each foot comes down: alternating steps, found from the speeds of the feet.

A swing is an interval in which one foot is much faster than the other. Swings that alternate between the feet are
steps, in any direction, with or without a flight phase. After its swing a foot is flat once heel and toe are both slow.
If the other foot is on the ground too, the contact is timed halfway between foot flat and the other foot's toe-off:
this is when the weight passes over, and agrees with labels made by hand. (Compared with these, foot flat is early in
slow steps, and touch-down earlier still.) Thresholds scale with leg length and, in fast gaits, with the swing's speed.

Frames in which the character stands belong to no cycle: steps are found as if they were cut out. In motion whose
feet skate, as from video, some swings end without a contact; they still count as steps between two contacts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

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

STANDING_SECONDS = 0.25
"""A character stands in pauses of at least this length; in slow walks both feet rest for a moment in every step."""

MAX_HALF_CYCLE = 1.3
"""Seconds between two contacts beyond which the character has paused."""

MIN_CONTACTS = 3
"""Contacts that make a run of steps a gait even where the hips do not travel: one whole cycle."""

MIN_TRAVEL = 0.5
"""Leg lengths that the hips must travel in a run of only two contacts, as in takes of a single cycle."""

EXTENSION = 1.2
"""Half cycles by which a run may extend beyond its first and last contact."""

SEEN = 0.9
"""Half cycles that a contact reaches towards a swing without a contact: when that foot came down is not known."""

MIN_SWING = 0.15
"""Seconds of the shortest swing without a contact that counts."""

SPEED_SMOOTHING = 1 / 60  # seconds; more would blur the onset of a contact
SWING_SMOOTHING = 0.05  # seconds; enough to bridge ripples within a swing


class NoGaitError(InputError):
    """A valid clip without a gait cycle: it has no steps or is too short. `prepare` skips such clips."""


@dataclass(frozen=True, eq=False)
class StepRun:
    """An uninterrupted run of alternating contacts.

    Times count only the frames in which the character moves.

    Attributes:
        times: [n] of the contacts, fractional, increasing.
        halves: [n] half cycles from the first contact: one more at each contact, and one more for each swing without.
        left_first: whether the first contact is of the left foot.
        clock: [m] times of the frames around the contacts that belong to the run.
        frames: [m] indices in the clip of these frames.
    """

    times: np.ndarray
    halves: np.ndarray
    left_first: bool
    clock: np.ndarray
    frames: np.ndarray


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
    points = positions[:, joints] / leg
    speed = _speeds(points, clip.fps)
    frames = np.flatnonzero(~_pauses(points, speed, clip.fps))
    if len(frames) < 3:
        raise _no_steps(clip, 0)
    if len(frames) < clip.num_frames:
        speed = _speeds(_without_pauses(points, frames), clip.fps)
    moving = gaussian_filter(speed.max(axis=1), SWING_SMOOTHING * motion.fps) > MOVING
    contacts, missed = _contacts(speed[:, :4].reshape(-1, 2, 2), clip.fps)
    hips = positions[frames, roles.hips][:, [0, 2]] / leg
    runs = [run for run in _split(contacts, missed, clip.fps) if _is_gait(run.times, hips)]
    if not runs:
        raise _no_steps(clip, len(contacts))
    return [_in_clip(run, frames) for run in _bound(runs, missed, moving)]


def _no_steps(clip: MotionClip, contacts: int) -> NoGaitError:
    found = f"{contacts} foot contacts in {clip.num_frames} frames ({clip.num_frames / clip.fps:.1f} s)"
    rule = "no steps: feet must come down alternately while the character travels, as in a walk"
    rate = clip.fps if clip.reading is None else clip.reading.fps  # the clip may be resampled
    doubt = f"if the file's {rate:.4g} frames per second are wrong, pass `--source-fps`"
    return NoGaitError(clip.source, "phase", found, f"{rule}; {doubt}")


def half_cycles(times: np.ndarray, halves: np.ndarray) -> tuple[float, float]:
    """Returns the lengths of the half cycle before the first contact and of the one after the last.

    Left and right steps may differ in length, so each is taken to be as long as the nearest half cycle of the same
    foot, the second from that end, or as the only one if there are two contacts.

    Args:
        times: [n] of contacts.
        halves: [n] half cycles at them.
    """
    lengths = np.diff(times) / np.diff(halves)
    return (lengths[1], lengths[-2]) if len(lengths) > 1 else (lengths[0], lengths[0])


def _speeds(points: np.ndarray, fps: float) -> np.ndarray:
    """Returns the speeds [T, P] of points [T, P, 3], smoothed, per second."""
    smooth = gaussian_filter(points, SPEED_SMOOTHING * fps)
    return np.linalg.norm(np.gradient(smooth, 1 / fps, axis=0), axis=-1)


def _pauses(points: np.ndarray, speed: np.ndarray, fps: float) -> np.ndarray:
    """Returns which frames [T] lie in a pause, in which no point moves; whatever is left begins and ends in motion.

    Smoothed speeds [T, P] bridge the noise of a pause, and those of single steps find its first and last frame.
    """
    step = np.linalg.norm(np.diff(points, axis=0), axis=-1).max(axis=1) * fps
    still = (speed.max(axis=1) < MOVING) | (np.append(step, step[-1]) < MOVING)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    pause = np.zeros(len(still), bool)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        pause[start:stop] = stop - start >= STANDING_SECONDS * fps
    return pause


def _without_pauses(points: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Returns points [M, P, 3] that move as in the frames [M] that are left, as if there were no pauses between."""
    steps = np.diff(points[frames], axis=0)
    seams = np.flatnonzero(np.diff(frames) > 1)
    steps[seams] = (steps[np.maximum(seams - 1, 0)] + steps[np.minimum(seams + 1, len(steps) - 1)]) / 2
    return np.concatenate([points[frames[:1]], points[frames[:1]] + np.cumsum(steps, axis=0)])


def _contacts(speed: np.ndarray, fps: float) -> tuple[list[tuple[float, int]], np.ndarray]:
    """Returns (time, foot) of every contact in time order, and the times of swings that end without one.

    Args:
        speed: [T, foot, (heel, toe)]; foot 0 is the left.
        fps: frames per second.
    """
    mean = gaussian_filter(speed.mean(axis=-1), SWING_SMOOTHING * fps)
    swings = _swings(mean[:, 0] - mean[:, 1])
    peaks = [start + int(np.argmax(mean[start:stop, foot])) for foot, start, stop in swings]
    found, missed = [], []
    for index, (foot, start, stop) in enumerate(swings):
        # swings alternate: the next one is of the other foot, the one after that of this foot again
        end = swings[index + 2][1] if index + 2 < len(swings) else len(speed)
        flat = _foot_flat(speed[peaks[index] : end, foot])
        if flat is None:
            if index + 1 < len(swings) and stop - start > MIN_SWING * fps:  # a clip may end within a swing
                missed.append(stop)
            continue
        time = peaks[index] + flat
        if index + 1 < len(swings):
            time += PASSING * max(0.0, _toe_off(speed[: peaks[index + 1], 1 - foot, 1]) - time)
        found.append((time, foot))
    return sorted(found), np.array(missed)


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


def _split(contacts: list[tuple[float, int]], missed: np.ndarray, fps: float) -> list[StepRun]:
    """Splits contacts into runs that alternate without a pause; they hold no frames yet."""
    runs: list[list[tuple[float, int]]] = []
    for time, foot in contacts:
        last = runs[-1][-1] if runs else None
        if last is None or last[1] == foot or time - last[0] > MAX_HALF_CYCLE * fps or time <= last[0]:
            runs.append([])
        runs[-1].append((time, foot))
    none = np.empty(0, np.int64)
    found = []
    for run in runs:
        times = np.array([time for time, _ in run])
        between = _count_between(missed, times)
        steps = 1 + between - between % 2  # feet alternate, so that an even number of contacts is missing
        halves = np.concatenate([[0], np.cumsum(steps)])
        found.append(StepRun(times, halves, run[0][1] == 0, none, none))
    return found


def _count_between(missed: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Returns how many missed contacts lie between each two times [n]."""
    return np.diff(np.searchsorted(missed, times))


def _is_gait(times: np.ndarray, hips: np.ndarray) -> bool:
    if len(times) != 2:
        return len(times) >= MIN_CONTACTS
    first, last = (hips[min(int(time), len(hips) - 1)] for time in times)
    return bool(np.linalg.norm(last - first) > MIN_TRAVEL)


def _bound(runs: list[StepRun], missed: np.ndarray, moving: np.ndarray) -> list[StepRun]:
    """Extends each run beyond its contacts for as long as the character moves, up to halfway to the next run.

    Times around swings without a contact belong to no run.
    """
    bounded = []
    for index, run in enumerate(runs):
        times = run.times
        before, after = half_cycles(times, run.halves)
        last_before = runs[index - 1].times[-1] if index > 0 else -np.inf
        next_after = runs[index + 1].times[0] if index + 1 < len(runs) else np.inf
        unseen = _count_between(missed, np.array([last_before, times[0], times[-1], next_after]))
        reach = np.ceil(times[0] - SEEN * before) if unseen[0] else times[0] - EXTENSION * before
        earliest = max(reach, (times[0] + last_before) / 2)
        latest = min(times[-1] + (SEEN if unseen[2] else EXTENSION) * after, (times[-1] + next_after) / 2)
        first, last = int(np.ceil(times[0])), int(times[-1])
        start, stop = first, last + 1
        while start > max(0, earliest) and moving[start - 1]:
            start -= 1
        while stop <= min(len(moving) - 1, latest) and moving[stop]:
            stop += 1
        clock = np.arange(start, stop)
        bounded.append(replace(run, clock=clock[_near_contacts(clock, run)]))
    return bounded


def _near_contacts(clock: np.ndarray, run: StepRun) -> np.ndarray:
    """Returns which times [m] are no farther than `SEEN` half cycles from a contact wherever contacts are missing."""
    steps = np.diff(run.halves)
    gap = np.clip(np.searchsorted(run.times, clock, side="right") - 1, 0, len(steps) - 1)
    reach = SEEN * np.diff(run.times)[gap] / steps[gap]
    far = (clock - run.times[gap] > reach) & (run.times[gap + 1] - clock > reach)
    return (steps[gap] == 1) | (clock <= run.times[0]) | (clock >= run.times[-1]) | ~far


def _in_clip(run: StepRun, frames: np.ndarray) -> StepRun:
    """Returns the run with the indices of its frames in the clip."""
    return replace(run, frames=frames[run.clock])
