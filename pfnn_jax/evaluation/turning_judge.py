"""Judges walks along real turning takes against what the actor did there, in centimetres on one skeleton.

Two walks of one style are never in step. Every frame of the actor is therefore compared with the frame of the walk in
which the gait has the same phase, at the place on the path nearest to the actor's (`match_frames`). No method of
learning a style sees any of this, so that nothing is tuned on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.evaluation.actor_test import by_part, skating_of_feet, without_sway
from pfnn_jax.evaluation.driven_takes import DrivenTake, Walk
from pfnn_jax.evaluation.gait_cycle import (
    LARGEST_SHIFT,
    NUM_PHASES,
    cycle_distance,
    mean_cycle_of_poses,
    poses_at,
)
from pfnn_jax.evaluation.metrics import nearest_pose_distance, path_error
from pfnn_jax.evaluation.motion_windows import clip_windows, motion_windows
from pfnn_jax.evaluation.style_classifier import (
    ClassifierConfig,
    StyleClassifier,
    features,
    frechet_distance,
    scores,
    train_classifier,
)
from pfnn_jax.evaluation.transfer_metrics import dynamic_time_warping, frame_distances
from pfnn_jax.motion.body_poses import body_joints
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import moving_minimum
from pfnn_jax.motion.ground import angle_between, wrap_angle
from pfnn_jax.motion.labels.contacts import foot_joints
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import CYCLE, runs_of

MEASURES = {
    "distance": "cm, joints of the body from the actor's, relative to the root, at the same phase and place",
    "turning": "cm, the same over the frames in which the actor turns",
    "trunk": "cm, the same as the distance over the trunk",
    "arms": "cm, the same over the arms",
    "legs": "cm, the same over the legs",
    "cycle": "cm, between the mean gait cycles while turning",
    "warped": "cm, between poses after dynamic time warping",
    "path": "cm, of the root from the actor's path, both without the sway of the hips",
    "end": "degrees, between the headings at the end of the take",
    "speed": "mean speed over the actor's",
    "contacts": "share of frames and foot joints whose contact is the actor's, at the same phase and place",
    "flicker": "changes of contacts per second over the actor's, contacts found in the motion",
    "network flicker": "the same of the contacts that the network predicts",
    "sliding": "speed of feet over the ground where the actor's stand, over that of the actor's",
    "skating": "the same of feet near their resting height (`metrics.foot_skating`), which also counts low swings",
    "airborne": "share of frames in which no foot is on the floor over the actor's; NaN where the actor walks",
    "turn rate": "mean turn rate over the actor's, at the places where the actor turns",
    "failed": "1 for a walk that is not finite, leaves the range of heights, does not get to the end or has no steps",
}
"""What `judge_walk` measures."""

STYLE_MEASURES = {
    "precision": "cm, from the poses of the walks while turning to the nearest real ones (root mean square)",
    "recall": "cm, from real poses while turning to the nearest of the walks",
    "recognised": "share of windows that the classifier takes for the style",
    "frechet": "Fréchet distance between the classifier's features of the walks and of the takes",
}
"""What `judge_style` adds."""

WORST_DISTANCE = 50.0
"""Centimetres that count as the distance of a walk that failed, and at most of any other, so that diverging is never
better than walking badly: about that of a body lying on the ground from one that walks."""

TURNING = np.deg2rad(20.0)
"""Radians per second beyond which the actor turns."""

LEAST_MATCHED = 0.9
"""Share of the actor's frames that a walk must have a phase for; with less, the network's own phase is used."""

LEAST_COMMON = 0.7
"""The same share for two takes of the actor, which are of different lengths."""

WARPING_FPS = 30.0
"""Frame rate at which poses are warped in time, the data's own: twice the rate would cost four times as much."""

WARPING_SECONDS = 0.5
"""Seconds by which warped frames may differ from uniform timing: half a cycle."""

STANDING_SECONDS = 0.05
"""Seconds from the beginning and the end of a contact after and before which a foot stands: phases agree no better."""

LEAST_AIRBORNE = 0.05
"""Share of frames without a foot on the floor from which on the actor runs: walks of Bandai-Namco-2 have at most 0.04
by contacts found in the motion, runs 0.3 to 0.7, those of the elderly 0.03 to 0.11."""

END_SECONDS = 0.5
"""Seconds over which the heading at the end is measured."""

DISTANCES = ("distance", "turning", "trunk", "arms", "legs", "cycle", "warped")
"""The measures of how far poses are apart."""

Judged = dict[str, float]
"""Measures by name; NaN where something cannot be measured."""


@dataclass(frozen=True, eq=False)
class Match:
    """Frames of a walk in which its gait has the phase of the actor's.

    Attributes:
        true: [N] frames of the actor.
        walk: [N] frames of the walk, fractional.
    """

    true: np.ndarray
    walk: np.ndarray


def match_frames(actor: Walk, walk: Walk, joints: np.ndarray, least: float = LEAST_MATCHED) -> Match | None:
    """Returns the frames of a walk that the actor's frames are compared with, None for a walk without steps.

    The walk's frame has the same phase and is the nearest in place along the path, within the length of a stride.
    Labels of contacts differ between real and generated walks: all phases of the walk are shifted by up to
    `LARGEST_SHIFT` samples of `NUM_PHASES`, to where the distance is least.

    Args:
        actor: with a phase.
        walk: along the same take. Where too few of its frames have a phase, that of its network is used.
        joints: that count.
        least: share of the actor's frames that must be matched.
    """
    for phase in (walk.phase, walk.network_phase):
        if phase is None:
            continue
        shifts = np.arange(-LARGEST_SHIFT, LARGEST_SHIFT + 1) * (CYCLE / NUM_PHASES)
        # The smallest shift comes first, so that it wins where a shift changes nothing.
        found = [_matched(actor, walk, phase, shift) for shift in shifts[np.argsort(np.abs(shifts), kind="stable")]]
        usable = [match for match in found if len(match.true) >= least * np.isfinite(actor.phase).sum()]
        if usable:
            return min(usable, key=lambda match: float(_apart(actor, walk, match)[:, joints].mean()))
    return None


def _matched(actor: Walk, walk: Walk, phase: np.ndarray, shift: float) -> Match:
    """Returns the match for phases [T] of the walk and one shift in radians."""
    true = np.flatnonzero(np.isfinite(actor.phase))
    wanted, place = actor.phase[true] + shift, actor.place[true]
    best, frames = np.full(len(true), _stride(actor)), np.full(len(true), np.nan)
    for start, stop in runs_of(np.isfinite(phase)):
        unwrapped, places = np.unwrap(phase[start:stop]), walk.place[start:stop]
        unwrapped = np.maximum.accumulate(unwrapped)  # a network's phase may step back
        own = np.arange(stop - start)
        here = np.interp(np.interp(place, places, own), own, unwrapped)
        nearest = here + wrap_angle(wanted - here)
        for target in (nearest, nearest - CYCLE, nearest + CYCLE):
            frame = np.interp(target, unwrapped, own)
            away = np.abs(np.interp(frame, own, places) - place)
            better = (target >= unwrapped[0]) & (target <= unwrapped[-1]) & (away < best)
            best, frames = np.where(better, away, best), np.where(better, frame + start, frames)
    found = np.isfinite(frames)
    return Match(true[found], frames[found])


def _stride(actor: Walk) -> float:
    """Returns the metres along the path that the actor travels in a cycle."""
    start, stop = max(runs_of(np.isfinite(actor.phase)), key=lambda run: run[1] - run[0])
    turned = np.unwrap(actor.phase[start:stop])
    cycles = max(turned[-1] - turned[0], 1e-9) / CYCLE
    return float((actor.place[stop - 1] - actor.place[start]) / cycles)


def _apart(actor: Walk, walk: Walk, match: Match) -> np.ndarray:
    """Returns the distance [N, J] in metres of each joint in matched frames."""
    return np.linalg.norm(actor.poses[match.true] - poses_at(walk.poses, match.walk), axis=-1)


def judge_walk(take: DrivenTake, walk: Walk) -> Judged:
    """Returns the `MEASURES` of a walk along a take.

    A walk that failed has the `WORST_DISTANCE` in every distance between poses and no contact in common with the actor;
    its other measures are NaN.
    """
    if walk.faults:
        return _worst()
    actor, joints = take.actor, body_joints(take.skeleton)
    match = match_frames(actor, walk, joints)
    if match is None:
        return _worst()
    judged = {
        **_pose_distances(take, walk, match, joints),
        "path": _path(take, walk),
        "end": _end(take, walk),
        "speed": _speed(walk) / _speed(actor),
        **_feet(take, walk, match),
        "turn rate": _turn_rate(take, walk),
        "failed": 0.0,
    }
    return {name: float(judged.get(name, np.nan)) for name in MEASURES}


def _pose_distances(take: DrivenTake, walk: Walk, match: Match, joints: np.ndarray) -> Judged:
    """Returns the `DISTANCES` in centimetres, at most `WORST_DISTANCE`."""
    apart = _apart(take.actor, walk, match)
    turning = turning_frames(take.actor, take.fps)[match.true]
    found = {
        **by_part(apart.mean(axis=0), take.skeleton),
        "turning": 100 * float(apart[turning][:, joints].mean()) if turning.any() else np.nan,
        "cycle": _cycle(take, walk),
        "warped": _warped(take, walk, joints),
    }
    return {name: min(value, WORST_DISTANCE) for name, value in found.items()}


def _feet(take: DrivenTake, walk: Walk, match: Match) -> Judged:
    """Returns the measures of feet and contacts."""
    actor, predicted = take.actor, walk.network_contacts
    own = walk.contacts[np.round(match.walk).astype(int)]
    itself = Match(match.true, match.true.astype(float))
    flicker = _flicker(actor.contacts)
    return {
        "contacts": float((own == actor.contacts[match.true]).mean()),
        "flicker": _flicker(walk.contacts[walk.part]) / flicker,
        "network flicker": np.nan if predicted is None else _flicker(predicted[walk.part]) / flicker,
        "sliding": _sliding(take, walk, match) / _sliding(take, actor, itself),
        "skating": _skating(take, walk) / _skating(take, actor),
        "airborne": _airborne(take, walk),
    }


def _airborne(take: DrivenTake, walk: Walk) -> float:
    own, true = ((~one.contacts[one.part].any(axis=-1)).mean() for one in (walk, take.actor))
    return float(own / true) if true >= LEAST_AIRBORNE else np.nan


def _worst() -> Judged:
    distances = dict.fromkeys(DISTANCES, WORST_DISTANCE)
    return {**dict.fromkeys(MEASURES, np.nan), **distances, "contacts": 0.0, "failed": 1.0}


def mean_measures(judged: Sequence[Judged]) -> Judged:
    """Returns the mean of each measure over the walks that have it; NaN where none has."""
    values = np.array([list(one.values()) for one in judged])
    has = np.isfinite(values)
    sums, counts = np.where(has, values, 0.0).sum(axis=0), has.sum(axis=0)
    means = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return dict(zip(judged[0], means.tolist(), strict=True))


def turning_frames(walk: Walk, fps: float) -> np.ndarray:
    """Returns which frames [T] turn faster than `TURNING`."""
    return np.abs(_yaw_rate(walk, fps)) > TURNING


def _yaw_rate(walk: Walk, fps: float) -> np.ndarray:
    return np.gradient(np.unwrap(walk.root.yaw)) * fps


def frames_at(walk: Walk, place: np.ndarray) -> np.ndarray:
    """Returns the fractional frames at which a walk is at places in metres along the path."""
    return np.interp(place, walk.place, np.arange(len(walk.place)))


def _turn_rate(take: DrivenTake, walk: Walk) -> float:
    true, turning = _yaw_rate(take.actor, take.fps), turning_frames(take.actor, take.fps)
    if not turning.any():
        return np.nan
    own = _yaw_rate(walk, take.fps)
    frames = frames_at(walk, take.actor.place[turning])
    achieved = np.interp(frames, np.arange(len(own)), own)
    return float((np.sign(true[turning]) * achieved).sum() / np.abs(true[turning]).sum())


def _turn(take: DrivenTake, walk: Walk) -> slice:
    """Returns the frames of a walk from where the actor begins to turn to where the actor ends; all without a turn."""
    turning = np.flatnonzero(turning_frames(take.actor, take.fps))
    if not len(turning):
        return walk.part
    first, last = np.round(frames_at(walk, take.actor.place[turning[[0, -1]]])).astype(int)
    return slice(int(first), int(last) + 1)


def _cycle(take: DrivenTake, walk: Walk) -> float:
    """Returns the distance in centimetres between mean gait cycles while turning, NaN without a whole cycle."""
    try:
        true, own = (_mean_cycle(one, _turn(take, one)) for one in (take.actor, walk))
    except NoGaitError:
        return np.nan
    return by_part(cycle_distance(true, own), take.skeleton)["distance"]


def _mean_cycle(walk: Walk, part: slice) -> np.ndarray:
    phase = walk.phase[part]
    return mean_cycle_of_poses(walk.poses[part], phase, np.isfinite(phase), "walk")


def _warped(take: DrivenTake, walk: Walk, joints: np.ndarray) -> float:
    return 100 * warped_distance(take.actor.poses[:, joints], walk.poses[walk.part][:, joints], take.fps)


def warped_distance(true: np.ndarray, own: np.ndarray, fps: float) -> float:
    """Returns the mean distance in metres of poses [T, J, 3] and [U, J, 3] after dynamic time warping.

    Frames of `WARPING_FPS` are matched that differ by at most `WARPING_SECONDS` from uniform timing.
    """
    every = max(round(fps / WARPING_FPS), 1)
    distances = frame_distances(true[::every], own[::every])
    rows, columns = (np.linspace(0.0, 1.0, count) for count in distances.shape)
    seconds = np.abs(rows[:, None] - columns[None]) * (max(distances.shape) * every / fps)
    distances[seconds > WARPING_SECONDS] = np.inf
    return dynamic_time_warping(distances)[0]


def _path(take: DrivenTake, walk: Walk) -> float:
    return 100 * path_error(without_sway(walk.root.positions, take.fps)[walk.part], take.path.points).mean


def _end(take: DrivenTake, walk: Walk) -> float:
    headings = []
    for one in (take.actor, walk):
        smooth = without_sway(one.root.positions, take.fps)
        headings.append(smooth[one.last] - smooth[max(one.last - round(END_SECONDS * take.fps), 0)])
    return float(np.rad2deg(np.abs(angle_between(*headings))))


def _speed(walk: Walk) -> float:
    return float((walk.place[walk.last] - walk.place[walk.first]) / max(walk.last - walk.first, 1))


def _flicker(contacts: np.ndarray) -> float:
    """Returns the changes of contacts [T, 4] per frame."""
    return max(np.count_nonzero(contacts[1:] != contacts[:-1]), 1e-9) / (len(contacts) - 1)


def _sliding(take: DrivenTake, walk: Walk, match: Match) -> float:
    """Returns the mean speed in metres per second of the walk's feet in frames in which the actor's feet stand.

    Found in the walk itself, contacts would be those of feet that are slow, and heights above the ground depend on
    where a foot lock holds the toes.
    """
    frames = 2 * round(STANDING_SECONDS * take.fps) + 1
    stands = moving_minimum(take.actor.contacts.astype(float), frames)[match.true] > 0.5
    feet = walk.joints[:, foot_joints(take.roles)][..., [0, 2]]
    speed = np.linalg.norm(np.gradient(feet, axis=0), axis=-1) * take.fps
    return float(speed[np.round(match.walk).astype(int)][stands].mean()) if stands.any() else np.nan


def _skating(take: DrivenTake, walk: Walk) -> float:
    return skating_of_feet(walk.joints[walk.part][:, foot_joints(take.roles)], take.fps)


def repetition_distance(takes: Sequence[DrivenTake]) -> float:
    """Returns the distance in centimetres between takes of one actor that turn to the same side, NaN without any.

    One take is moved along the path of the other until their turns coincide, and frames are matched as those of a walk.
    No method can be expected to come nearer to a take than the actor himself in another one.
    """
    found = []
    for one in takes:
        for other in takes:
            (place, side), (there, same) = _turn_of(one), _turn_of(other)
            if other is one or side != same:
                continue
            walk, joints = replace(other.actor, place=other.actor.place + place - there), body_joints(one.skeleton)
            if (match := match_frames(one.actor, walk, joints, least=LEAST_COMMON)) is not None:
                found.append(_apart(one.actor, walk, match)[:, joints].mean())
    return 100 * float(np.mean(found)) if found else np.nan


def _turn_of(take: DrivenTake) -> tuple[float, float]:
    """Returns the mean place in metres along the path at which the actor turns, and to which side (1 is left)."""
    rate, turning = _yaw_rate(take.actor, take.fps), turning_frames(take.actor, take.fps)
    weights = np.where(turning, np.abs(rate), 0.0)
    return float((take.actor.place * weights).sum() / max(weights.sum(), 1e-9)), float(np.sign(rate[turning].sum()))


@dataclass(frozen=True, eq=False)
class StyleRecogniser:
    """A classifier of styles that saw real takes of all of them, straight and turning.

    Attributes:
        classifier: of windows of all joints (`motion_windows`).
        styles: names, in the order of its outputs.
    """

    classifier: StyleClassifier
    styles: tuple[str, ...]


def train_recogniser(
    takes: Mapping[str, Sequence[MotionClip]], config: ClassifierConfig | None = None
) -> StyleRecogniser:
    """Trains a recogniser on real takes by style, all on one skeleton, and on their mirror images."""
    styles = tuple(sorted(takes))
    windows = [np.concatenate([clip_windows(clip, mirror=True) for clip in takes[style]]) for style in styles]
    labels = np.repeat(np.arange(len(styles)), [len(part) for part in windows])
    return StyleRecogniser(train_classifier(np.concatenate(windows), labels, len(styles), config), styles)


def judge_style(
    takes: Sequence[DrivenTake],
    walks: Sequence[Walk],
    style: str | None = None,
    recogniser: StyleRecogniser | None = None,
) -> Judged:
    """Returns the `STYLE_MEASURES` of walks along takes of one style: how their poses are distributed.

    Poses of turns are those at places where the actor turns. Walks with `faults` have none.

    Args:
        takes, walks: N of each.
        style: name of the style, for the recogniser.
        recogniser: without one, its measures are NaN.
    """
    judged = dict.fromkeys(STYLE_MEASURES, np.nan)
    good = [(take, walk) for take, walk in zip(takes, walks, strict=True) if not walk.faults]
    if not good:
        return judged
    joints = body_joints(takes[0].skeleton)
    real = np.concatenate([_turning_poses(take, take.actor) for take in takes])[:, joints]
    made = np.concatenate([_turning_poses(take, walk) for take, walk in good])[:, joints]
    judged["precision"] = 100 * float(nearest_pose_distance(made, real).mean())
    judged["recall"] = 100 * float(nearest_pose_distance(real, made).mean())
    if recogniser is not None and style is not None:
        true, own = _windows(takes, [take.actor for take in takes]), _windows(*zip(*good, strict=True))
        likely = scores(recogniser.classifier, own).argmax(axis=1)
        judged["recognised"] = float((likely == recogniser.styles.index(style)).mean())
        judged["frechet"] = frechet_distance(*(features(recogniser.classifier, part) for part in (own, true)))
    return judged


def _turning_poses(take: DrivenTake, walk: Walk) -> np.ndarray:
    """Returns the poses [N, J, 3] of a walk between the places where the actor turns."""
    return walk.poses[_turn(take, walk)]


def _windows(takes: Sequence[DrivenTake], walks: Sequence[Walk]) -> np.ndarray:
    pairs = zip(takes, walks, strict=True)
    return np.concatenate([motion_windows(w.joints[w.part], t.roles, t.fps, pad=True) for t, w in pairs])
