"""Judges walks in a style, however they were made: by a classifier, and against real walks of the style."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.evaluation.actor_test import MOST_SECONDS, by_part
from pfnn_jax.evaluation.clip_classifier import WindowConfig, train_clip_classifier
from pfnn_jax.evaluation.gait_cycle import cycle_distance, mean_cycle
from pfnn_jax.evaluation.style_classifier import ClassifierConfig
from pfnn_jax.evaluation.transfer_judge import Recognisers, judge_transfer
from pfnn_jax.motion.clip import MotionClip, cut
from pfnn_jax.motion.datasets.labelled import read_cut_clip
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.labels.footsteps import NoGaitError
from pfnn_jax.motion.labels.phase import label_phase
from pfnn_jax.motion.world_motion import WorldMotion, world_motion

Key = tuple[str, str]
"""Style and content of a take."""

TIME_SCALES = (0.8, 1.0, 1.25)
"""Speeds at which the classifier sees every take, so that it does not tell styles by their speed alone."""


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
        recognisers: a classifier of styles.
        cycles: mean gait cycles [P, J, 3] of the test takes that have one, by style and content.
        speeds: mean speed in m/s of the same takes.
    """

    recognisers: Recognisers
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
    clips = [(style, clip) for (style, _), own in takes.known.items() for clip in own]
    style = train_clip_classifier(
        [clip for _, clip in clips],
        [name for name, _ in clips],
        windows=WindowConfig(time_scales=TIME_SCALES),
        config=ClassifierConfig(epochs=epochs),
    )
    cycles = {key: [c for clip in own if (c := cycle_of(clip)) is not None] for key, own in takes.test.items()}
    speeds = {key: float(np.mean([speed_of(world_motion(clip)) for clip in own])) for key, own in takes.test.items()}
    return Judge(Recognisers(style=style), cycles, speeds)


def judge_clip(
    result: MotionClip, content: MotionClip, style: MotionClip, judge: Judge, *, without: int | None = None
) -> dict[str, float | None]:
    """Returns the measures of a walk that is to have the content of one clip and the style of another.

    Args:
        result: on the skeleton of the takes.
        content: what it is to do; at its frame rate everything is judged.
        style: the style clip, with the name of its style.
        judge: the judge.
        without: index of the test take that is left out of the comparison, because it is the result itself.

    Returns:
        Measures of `evaluation.transfer_judge`; and `distance` in cm from the mean gait cycles of real takes of that
        style and content, over the joints of the body, with `trunk`, `arms` and `legs` (None for a clip without
        steps), and `speed`, of that of the same takes.
    """
    key, world = (style.style, content.content), world_motion(result)
    real = [cycle for number, cycle in enumerate(judge.cycles[key]) if number != without]
    own = cycle_of(result)
    distances: dict[str, float | None] = dict.fromkeys(("distance", "trunk", "arms", "legs"))
    if own is not None and real:
        distances |= by_part(np.mean([cycle_distance(other, own) for other in real], axis=0), result.skeleton)
    judged = judge_transfer(content, style, result, None, judge.recognisers, fps=content.fps)
    return {**judged, **distances, "speed": speed_of(world) / judge.speeds[key]}


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
