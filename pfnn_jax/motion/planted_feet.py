"""Removes foot sliding from a whole clip whose contacts are known, with all frames in view.

Where a heel or toe is in contact it stays at one place, at a given height; between contacts its correction passes over
smoothly, with the velocity that it has at either end, so that nothing lags and no foot jumps. Hips rise or sink so that
legs stay as straight as they are; then legs bend in closed form. The controller, which knows only the past, holds feet
by `control.ik.foot_lock` instead.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import gaussian_filter, moving_minimum
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_between,
    quat_conjugate,
    quat_multiply,
    quat_normalise,
    quat_rotate,
)
from pfnn_jax.motion.labels.phase import runs_of
from pfnn_jax.motion.retargeting.body import SIDES, UP, humanoid_of, limb
from pfnn_jax.motion.retargeting.legs import Legs, excess_height, leg_extension, match_extension
from pfnn_jax.motion.two_bone import bend

SHORTEST_SECONDS = 0.05
"""Contacts and gaps between contacts that are shorter than this are noise of the labels."""

FADE_SECONDS = 0.1
"""Time in which a foot begins and ceases to turn about its toe."""

RELEASE_SECONDS = 0.3
"""Time in which a correction fades where no other contact follows sooner."""

MAX_SPEED = 0.5
"""Metres per second with which a correction grows on after a contact, or has grown before it, at the most."""

MAX_OFFSET = 0.15
"""Leg lengths by which a foot in contact may be moved; a foot farther from its place is let go."""

CLEARANCE = 0.1
"""Share of the largest offset (1.3 cm) by which a foot that swings is kept above the ground, if it was meant to be."""

SMOOTH_SECONDS = 1 / 60
"""Standard deviation of the Gaussian that smooths the corrections: a foot comes to rest, and does not stop dead."""

HIPS_SECONDS = 0.15
"""Standard deviation of the Gaussian that smooths the height of the hips."""

KNEE_SECONDS = 1 / 30
"""Standard deviation of the Gaussian that smooths the rotations of thighs and shins."""

LIFT_SECONDS = 0.05
"""Time before and after a foot would enter the ground in which it is raised."""


def plant_feet(clip: MotionClip, contacts: np.ndarray, heights: np.ndarray) -> MotionClip:
    """Returns the clip with feet that stay in place while they are in contact.

    Args:
        clip: T frames of a humanoid with ankles.
        contacts: [T, 4] bool, left heel, left toe, right heel, right toe; the heel is the ankle joint.
        heights: [T, 4] metres above y = 0 of these joints in the motion that the contacts are of. In contact that joint
            which would be lower comes to its height, so that the foot keeps its pitch; in between a foot is raised
            where it would scuff.

    Returns:
        A clip that differs in the rotations of thighs, shins and feet and in the height of its root.

    Raises:
        InputError: if an array does not fit the clip, or the skeleton has no humanoid map or no ankles.
    """
    source = clip.source or "clip"
    for name, values in (("contacts", contacts), ("heights", heights)):
        if values.shape != (clip.num_frames, 4):
            raise InputError(source, name, f"shape {values.shape}", f"must be {(clip.num_frames, 4)}")
    body = humanoid_of(clip.skeleton, source)
    positions, world = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    furthest = MAX_OFFSET * leg_length_of(clip.skeleton, body)
    joints = [limb(body, side, "thigh", "shin", "foot", "toe") for side in SIDES]
    turns, ankles = [], []
    for number, (_, _, heel, toe) in enumerate(joints):
        own = slice(2 * number, 2 * number + 2)
        foot = positions[:, [heel, heel if toe is None else toe]]
        turn, ankle = _place_foot(foot, contacts[:, own], heights[:, own], clip.fps, furthest)
        turns.append(turn)
        ankles.append(ankle)
    targets = np.stack(ankles, axis=1)
    raised = positions + _hips_rise(body, positions, targets, clip.fps)[:, None, None] * UP
    left = positions[:, body.left_thigh] - positions[:, body.right_thigh]
    rotations = clip.rotations.copy()
    for number, (thigh, shin, heel, _) in enumerate(joints):
        top, knee, ankle = (raised[:, joint] for joint in (thigh, shin, heel))
        over, under, _ = bend(top, knee, ankle, targets[:, number], np.cross(knee - top, left))
        # a leg that is almost straight bends by degrees for millimetres, and passes through straight in no time
        over, under = (quat_normalise(gaussian_filter(delta, KNEE_SECONDS * clip.fps)) for delta in (over, under))
        foot = quat_multiply(quat_conjugate(quat_multiply(over, under)), turns[number])
        for joint, delta in ((thigh, over), (shin, under), (heel, foot)):
            above = world[:, clip.skeleton.parents[joint]]
            local = quat_multiply(quat_conjugate(above), quat_multiply(delta, above))
            rotations[:, joint] = quat_multiply(local, rotations[:, joint])
    root = clip.root_positions + raised[:, body.hips] - positions[:, body.hips]
    return replace(clip, root_positions=root, rotations=rotations)


def _hips_rise(body: HumanoidMap, positions: np.ndarray, targets: np.ndarray, fps: float) -> np.ndarray:
    """Returns how far the hips rise [T] in metres for legs to stay as straight as they are, and reach their targets."""
    legs: Legs = [tuple(positions[:, joint] for joint in limb(body, side, "thigh", "shin", "foot")) for side in SIDES]
    rise = gaussian_filter(match_extension(legs, targets, leg_extension(positions, body)), HIPS_SECONDS * fps)
    sink = excess_height([(top + rise[:, None] * UP, knee, ankle) for top, knee, ankle in legs], targets)
    return rise - _envelope(sink, HIPS_SECONDS * fps)


def foot_offsets(
    foot: np.ndarray, contacts: np.ndarray, heights: np.ndarray, fps: float, furthest: float
) -> np.ndarray:
    """Returns by how much heel and toe [T, 2, 3] must move, in metres, to stay in place while they are in contact.

    Args:
        foot: [T, 2, 3] metres, heel and toe.
        contacts: [T, 2] bool.
        heights: [T, 2] metres, as in `plant_feet`.
        fps: frames per second.
        furthest: metres that one may be moved in contact; beyond, it is let go.
    """
    contacts = clean_contacts(contacts, fps)
    away = np.linalg.norm(_to_places(foot, contacts), axis=-1)
    contacts = clean_contacts(contacts & (away < furthest), fps)
    offsets = np.zeros_like(foot)
    offsets[..., [0, 2]] = _to_places(foot, contacts)
    fall = np.where(contacts, foot[..., 1] - heights, np.inf).min(axis=1)
    stands = contacts[:, 0] | contacts[:, 1]
    offsets[stands, :, 1] = -np.clip(fall[stands], -furthest, furthest)[:, None]
    apart = _fade(offsets[:, 0] - offsets[:, 1], contacts[:, 0] & contacts[:, 1], fps)
    whole = np.where(contacts[:, 1:], offsets[:, 1], offsets[:, 0] - apart)  # of the toe
    whole = _bridge(whole, stands, fps)
    return np.stack([whole + apart, whole], axis=1)


def _envelope(values: np.ndarray, frames: float) -> np.ndarray:
    """Returns a smooth curve [T] hardly ever below values [T] and zero farther than some frames from where they are."""
    reach = max(1, round(frames))
    return gaussian_filter(-moving_minimum(-values, 2 * reach + 1), reach / 2)


def clean_contacts(contacts: np.ndarray, fps: float) -> np.ndarray:
    """Returns contacts [T, N] without gaps, then without contacts, shorter than `SHORTEST_SECONDS`."""
    contacts = contacts.copy()
    for values in contacts.T:
        for fill in (True, False):
            for start, stop in runs_of(values != fill):
                inside = fill is False or (start > 0 and stop < len(values))
                if inside and stop - start < SHORTEST_SECONDS * fps:
                    values[start:stop] = fill
    return contacts


def _to_places(foot: np.ndarray, contacts: np.ndarray) -> np.ndarray:
    """Returns the vectors [T, 2, 2] on the ground from heel and toe in contact to the places where they stay.

    The longest contact of a stance stays at its mean place, and others follow from it, one after the other, by where
    heel and toe are to each other while both are in contact: a foot is rigid.
    """
    level, away = foot[..., [0, 2]], np.zeros(foot.shape[:2] + (2,))
    open_runs = [(stop - start, start, stop, joint) for joint in (0, 1) for start, stop in runs_of(contacts[:, joint])]
    open_runs.sort()
    placed: list[tuple[int, int, int, np.ndarray]] = []
    while open_runs:
        pick = next((run for run in reversed(open_runs) if _touching(run, placed)), open_runs[-1])
        open_runs.remove(pick)
        _, start, stop, joint = pick
        near = _touching(pick, placed)
        if near is None:
            place = level[start:stop, joint].mean(axis=0)
        else:
            first, last = max(start, near[0]), min(stop, near[1])
            shared = slice(first, last) if first < last else slice(min(first, last) - 1, max(first, last) + 1)
            place = near[3] + (level[shared, joint] - level[shared, near[2]]).mean(axis=0)
        away[start:stop, joint] = place - level[start:stop, joint]
        placed.append((start, stop, joint, place))
    return away


def _touching(
    run: tuple[int, int, int, int], placed: list[tuple[int, int, int, np.ndarray]]
) -> tuple[int, int, int, np.ndarray] | None:
    """Returns a contact of the other joint that overlaps or adjoins a run (length, start, stop, joint), or None."""
    _, start, stop, joint = run
    return next((other for other in placed if other[2] != joint and other[0] <= stop and start <= other[1]), None)


def _fade(values: np.ndarray, known: np.ndarray, fps: float) -> np.ndarray:
    """Lets values [T, 3] fade to zero within `FADE_SECONDS` before and after the frames in which they are known."""
    faded = np.where(known[:, None], values, 0.0)
    length = FADE_SECONDS * fps
    for start, stop in runs_of(~known):
        frames = np.arange(start, stop)
        if start > 0:
            faded[start:stop] += values[start - 1] * _ease((frames - start + 1) / length)[:, None]
        if stop < len(known):
            faded[start:stop] += values[stop] * _ease((stop - frames) / length)[:, None]
    return faded


def _bridge(values: np.ndarray, known: np.ndarray, fps: float) -> np.ndarray:
    """Continues values [T, 3] over the frames in which they are not known, with their own velocity at both ends.

    A gap of more than twice `RELEASE_SECONDS`, and what lies before the first and after the last known frame, fades to
    zero.
    """
    bridged, length, most = np.where(known[:, None], values, 0.0), round(RELEASE_SECONDS * fps), MAX_SPEED / fps
    for start, stop in runs_of(~known):
        ends = []
        for at, beyond, inside in ((start - 1, start - 2, start > 0), (stop, stop + 1, stop < len(known))):
            if not inside:
                ends.append((np.zeros(3), np.zeros(3)))
                continue
            step = values[at] - values[beyond] if 0 <= beyond < len(known) and known[beyond] else np.zeros(3)
            ends.append((values[at], step * min(1.0, most / max(float(np.linalg.norm(step)), 1e-12))))
        (first, leaving), (last, arriving) = ends
        frames = np.arange(start, stop)
        if 0 < start and stop < len(known) and stop - start + 1 <= 2 * length:
            span = stop - start + 1
            bridged[start:stop] = _hermite((frames - start + 1) / span, first, span * leaving, last, -span * arriving)
            continue
        zero = np.zeros(3)
        if start > 0:
            bridged[start:stop] += _hermite((frames - start + 1) / length, first, length * leaving, zero, zero)
        if stop < len(known):
            bridged[start:stop] += _hermite((stop - frames) / length, last, length * arriving, zero, zero)
    return bridged


def _hermite(
    share: np.ndarray, first: np.ndarray, leaving: np.ndarray, last: np.ndarray, arriving: np.ndarray
) -> np.ndarray:
    """Returns the cubic [n, 3] at shares [n] of its span from one value [3] to another with these derivatives [3]."""
    s = np.clip(share, 0.0, 1.0)[:, None]
    return (
        (1 + 2 * s) * (1 - s) ** 2 * first + s * (1 - s) ** 2 * leaving + s * s * (3 - 2 * s) * last
        + s * s * (s - 1) * arriving
    )  # fmt: skip


def _ease(share: np.ndarray) -> np.ndarray:
    """Returns 1 at shares of 0 and 0 from 1 on, smooth at both ends."""
    s = np.clip(share, 0.0, 1.0)
    return 1.0 - s * s * (3.0 - 2.0 * s)


def _place_foot(
    foot: np.ndarray, contacts: np.ndarray, heights: np.ndarray, fps: float, furthest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rotations [T, 4] of a foot and the places [T, 3] of its ankle that keep it in place in contact.

    The foot is rigid: where heel and toe should be nearer or farther than it is long, a toe in contact decides, else
    the heel. Arguments are those of `foot_offsets`.
    """
    moved = foot + gaussian_filter(foot_offsets(foot, contacts, heights, fps, furthest), SMOOTH_SECONDS * fps)
    lowest = np.minimum(heights, heights.min(axis=0) + CLEARANCE * furthest)
    below = np.maximum(lowest - moved[..., 1], 0.0).max(axis=1)
    moved[..., 1] += _envelope(below, LIFT_SECONDS * fps)[:, None]
    along, bone = moved[:, 1] - moved[:, 0], foot[:, 1] - foot[:, 0]
    turn = quat_between(bone, along)
    share = np.maximum(gaussian_filter(contacts[:, 1].astype(float), FADE_SECONDS / 2 * fps), contacts[:, 1])[:, None]
    return turn, moved[:, 0] + share * (along - quat_rotate(turn, bone))
