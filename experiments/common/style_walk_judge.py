"""Judges walks in a style, however they were made: by a classifier, and against real walks of the style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.evaluation.actor_test import MOST_SECONDS, by_part, feet_of
from pfnn_jax.evaluation.gait_cycle import cycle_distance, mean_cycle
from pfnn_jax.evaluation.metrics import jitter, near_ground_skating, planted_heights, sliding_over_travel
from pfnn_jax.evaluation.motion_windows import clip_windows
from pfnn_jax.evaluation.style_classifier import ClassifierConfig, StyleClassifier, scores, train_classifier
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.datasets.labelled import read_cut_clip
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import label_phase
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

Key = tuple[str, str]
"""Style and content of a take."""

TOES = [1, 3]
"""Of the foot joints of `feet_of`: left and right toe."""


@dataclass(frozen=True, eq=False)
class Takes:
    """Takes by style and content, in two halves.

    Attributes:
        known: what the classifier is trained on.
        test: what is judged, transferred and compared with.
    """

    known: Mapping[Key, Sequence[MotionClip]]
    test: Mapping[Key, Sequence[MotionClip]]

    @property
    def styles(self) -> tuple[str, ...]:
        """Names of all styles, sorted."""
        return tuple(sorted({style for style, _ in self.known}))


@dataclass(frozen=True, eq=False)
class Judge:
    """What every clip is judged by.

    Attributes:
        classifier: of styles.
        styles: its labels.
        cycles: mean gait cycles [P, J, 3] of the test takes that have one, by style and content.
        speeds: mean speed in m/s of the same takes.
    """

    classifier: StyleClassifier
    styles: tuple[str, ...]
    cycles: Mapping[Key, Sequence[np.ndarray]]
    speeds: Mapping[Key, float]


def deal_files(files: Sequence[ClipFile]) -> tuple[list[ClipFile], list[ClipFile]]:
    """Returns the files in two halves: those of every style and content are dealt in turn, the first to the first."""
    halves: tuple[list[ClipFile], list[ClipFile]] = [], []
    counts: dict[Key, int] = {}
    for file in files:
        key = file.style, file.content
        halves[counts.get(key, 0) % 2].append(file)
        counts[key] = counts.get(key, 0) + 1
    return halves


def read_takes(files: Sequence[ClipFile]) -> dict[Key, list[MotionClip]]:
    """Returns the clips of files by style and content, at their own rate, cut to what a character can follow."""
    takes: dict[Key, list[MotionClip]] = {}
    for file in files:
        clip = read_cut_clip(file).clip
        short = cut(clip, 0, min(clip.num_frames, round(MOST_SECONDS * clip.fps)))
        takes.setdefault((file.style, file.content), []).append(short)
    return takes


def make_judge(takes: Takes, epochs: int) -> Judge:
    """Returns a judge whose classifier has seen the known half of the takes for a number of epochs."""
    styles = takes.styles
    parts = {key: np.concatenate([clip_windows(clip, mirror=True) for clip in takes.known[key]]) for key in takes.known}
    labels = [np.full(len(windows), styles.index(style)) for (style, _), windows in parts.items()]
    settings = ClassifierConfig(epochs=epochs)
    windows = np.concatenate(list(parts.values()))
    classifier = train_classifier(windows, np.concatenate(labels), len(styles), settings)
    cycles = {key: [c for clip in clips if (c := cycle_of(clip)) is not None] for key, clips in takes.test.items()}
    speeds = {key: float(np.mean([speed_of(world_motion(clip)) for clip in own])) for key, own in takes.test.items()}
    return Judge(classifier, styles, cycles, speeds)


def judge_clip(clip: MotionClip, key: Key, judge: Judge, *, without: int | None = None) -> dict[str, float | None]:
    """Returns the measures of a clip as a walk of a style and content.

    Args:
        clip: on the skeleton of the takes.
        key: what it is to be.
        judge: the judge.
        without: index of the test take that is left out of the comparison, because it is the clip itself.

    Returns:
        `recognition`, the share of windows recognised as the style (None for a clip without a window); `distance` in
        cm from the mean gait cycle of real takes, over the joints of the body, and `trunk`, `arms` and `legs` (None
        for a clip without steps); `sliding`, of toes relative to the root; `skating` in cm/s; `jitter` in m/s³;
        `speed`, of that of real takes; `metres_per_second`.
    """
    world = world_motion(clip)
    feet = feet_of(world)
    speed = speed_of(world)
    real = [cycle for number, cycle in enumerate(judge.cycles[key]) if number != without]
    own = cycle_of(clip)
    distances: dict[str, float | None] = dict.fromkeys(("distance", "trunk", "arms", "legs"))
    if own is not None and real:
        distances |= by_part(np.mean([cycle_distance(other, own) for other in real], axis=0), clip.skeleton)
    return {
        "recognition": recognition(clip, key[0], judge),
        **distances,
        "sliding": sliding_over_travel(feet[:, TOES], world.positions[:, world.roles.hips]),
        "skating": 100.0 * near_ground_skating(feet, world.fps, planted_heights(feet)),
        "jitter": jitter(world.positions, world.fps),
        "speed": speed / judge.speeds[key],
        "metres_per_second": speed,
    }


def recognition(clip: MotionClip, style: str, judge: Judge) -> float | None:
    """Returns the share of a clip's windows that are recognised as a style, None for a clip without a window."""
    windows = clip_windows(clip)
    if not len(windows):
        return None
    return float(np.mean(scores(judge.classifier, windows).argmax(axis=1) == judge.styles.index(style)))


def cycle_of(clip: MotionClip) -> np.ndarray | None:
    """Returns the mean gait cycle [P, J, 3] of a clip, None for one without a whole cycle."""
    world = world_motion(clip)
    try:
        return mean_cycle(world, label_phase(world))
    except NoGaitError:
        return None


def speed_of(world: WorldMotion) -> float:
    """Returns the mean speed of the hips over the ground in m/s."""
    path = world.positions[:, world.roles.hips][:, [0, 2]]
    return float(np.linalg.norm(np.diff(path, axis=0), axis=-1).mean() * world.fps)
