"""The judge of style transfer: one function from clips to numbers, for every method alike, and tables with spread.

It sees nothing but clips, so that outputs of other systems, of few-shot learning and of a controller can be judged by
the same numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pfnn_jax.evaluation.clip_classifier import ClipClassifier
from pfnn_jax.evaluation.metrics import (
    bone_length_error,
    jitter,
    near_ground_skating,
    planted_heights,
    sliding_over_travel,
)
from pfnn_jax.evaluation.style_classifier import frechet_distance
from pfnn_jax.evaluation.transfer_metrics import (
    content_consistency,
    facing_poses,
    pose_distance,
    style_consistency,
    trajectory_distance,
)
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.motion.world_motion import WorldMotion, world_motion
from pfnn_jax.transfer.clip_rows import clip_root
from pfnn_jax.transfer.layout import LAYOUT_FPS

Record = dict[str, float | None]
"""Measures of one result; None where something to compare with is missing."""

MEASURES = {
    "style recognised": "share of results whose most probable style is the wanted one",
    "style probability": "probability of the wanted style",
    "content recognised": "share of results whose most probable content is that of the content clip",
    "content probability": "probability of the content",
    "SC++, cm": "distance from the real clip of the content in the style, frame by frame",
    "SC++ warped, cm": "the same with dynamic time warping",
    "CC, cm": "distance from the content clip, frame by frame",
    "CC warped, cm": "the same with dynamic time warping",
    "to style warped, cm": "distance from the style clip: small if the style clip is copied",
    "sliding": "CAMDM: step of toes below 1 cm over step of the root",
    "skating, cm/s": "RSMT: weighted speed of feet near the ground",
    "jitter, m/s³": "mean jerk",
    "jitter ratio": "jitter over that of the content",
    "bone error, cm": "mean difference of bones from the content's",
    "trajectory, m": "distance of the root's path from the content's",
    "trajectory shape, m": "the same after scaling the path for speed",
}
"""What `judge_transfer` measures."""

RESAMPLES = 1000
"""Bootstrap samples of an interval."""


@dataclass(frozen=True, eq=False)
class Recognisers:
    """Classifiers of clips that were trained on real clips, neither the result's content clip nor its ground truth.

    Attributes:
        style: classifier of styles, or None.
        content: classifier of contents, or None.
    """

    style: ClipClassifier | None = None
    content: ClipClassifier | None = None


def judge_transfer(
    content: MotionClip,
    style: MotionClip,
    result: MotionClip,
    truth: MotionClip | None = None,
    recognisers: Recognisers | None = None,
    *,
    fps: float = LAYOUT_FPS,
) -> Record:
    """Returns all `MEASURES` of one result.

    Args:
        content: what was to be done; its label `content` is what the result should be recognised as.
        style: how it was to be done; its label `style` is what the result should be recognised as.
        result: the clip to judge.
        truth: a real clip of the content in the style, if there is one.
        recognisers: classifiers; their measures are None without them.
        fps: frame rate at which all clips are compared. Clips of a lower rate are smoother than they were: use the
            lowest of all clips that are compared with each other.
    """
    recognisers, target = recognisers or Recognisers(), content.skeleton
    clips = [_on(clip, target, fps) for clip in (content, style, result)]
    source, example, judged = (world_motion(clip) for clip in clips)
    poses = facing_poses(judged)
    real = None if truth is None else [facing_poses(world_motion(_on(truth, target, fps)))]
    own = jitter(source.positions, fps)
    return {
        **_recognition("style", recognisers.style, clips[2], style.style),
        **_recognition("content", recognisers.content, clips[2], content.content),
        "SC++, cm": None if real is None else 100 * style_consistency(poses, real),
        "SC++ warped, cm": None if real is None else 100 * style_consistency(poses, real, warp=True),
        "CC, cm": 100 * content_consistency(poses, facing_poses(source)),
        "CC warped, cm": 100 * content_consistency(poses, facing_poses(source), warp=True),
        "to style warped, cm": 100 * pose_distance(poses, facing_poses(example), warp=True),
        **_feet(judged),
        "jitter, m/s³": jitter(judged.positions, fps),
        "jitter ratio": jitter(judged.positions, fps) / own if own > 0 else None,
        "bone error, cm": _bone_error(content, result),
        **_trajectory(judged, source),
    }


def _recognition(kind: str, classifier: ClipClassifier | None, clip: MotionClip, wanted: str) -> Record:
    if classifier is None or wanted not in classifier.labels:
        return {f"{kind} recognised": None, f"{kind} probability": None}
    likely = classifier.probabilities(clip)
    place = classifier.labels.index(wanted)
    return {f"{kind} recognised": float(likely.argmax() == place), f"{kind} probability": float(likely[place])}


def _feet(judged: WorldMotion) -> Record:
    """Returns the measures of feet, whose ground is where they rest in the same motion."""
    roles = judged.roles
    feet = judged.positions[:, [*roles.left_foot, *roles.right_foot]]
    sliding = sliding_over_travel(feet[:, [1, 3]], judged.positions[:, roles.hips])
    return {
        "sliding": sliding if np.isfinite(sliding) else None,
        "skating, cm/s": 100 * near_ground_skating(feet, judged.fps, planted_heights(feet)),
    }


def _bone_error(content: MotionClip, result: MotionClip) -> float | None:
    """Returns by how much bones differ from the content's in centimetres; None on a skeleton of other joints."""
    if result.skeleton.names != content.skeleton.names:
        return None
    lengths = np.linalg.norm(content.skeleton.offsets, axis=-1)
    return 100 * bone_length_error(world_motion(result).positions, content.skeleton.parents, lengths)


def _trajectory(judged: WorldMotion, source: WorldMotion) -> Record:
    paths = clip_root(judged).positions, clip_root(source).positions
    return {
        "trajectory, m": trajectory_distance(*paths),
        "trajectory shape, m": trajectory_distance(*paths, fit_speed=True),
    }


def _on(clip: MotionClip, skeleton: Skeleton, fps: float) -> MotionClip:
    own = clip if clip.skeleton is skeleton else retarget(clip, skeleton).clip
    return resample(own, fps)


def clips_frechet(classifier: ClipClassifier, clips: Sequence[MotionClip], real: Sequence[MotionClip]) -> float:
    """Returns the Fréchet distance between the features of two sets of clips (`frechet_distance`)."""
    a, b = (np.concatenate([classifier.features(clip) for clip in part]) for part in (clips, real))
    return frechet_distance(a, b)


@dataclass(frozen=True)
class Spread:
    """A mean over pairs with its interval.

    Attributes:
        mean: over the pairs that have the measure.
        low, high: 95 % interval of the mean, by bootstrap over pairs.
        std: standard deviation over pairs.
        count: number of pairs that have the measure.
    """

    mean: float
    low: float
    high: float
    std: float
    count: int


def summarise(records: Sequence[Mapping[str, float | None]]) -> dict[str, Spread]:
    """Returns the spread of each measure that at least one record has.

    Pairs that share a clip are not independent, so the intervals are too narrow rather than too wide.
    """
    found = {}
    for measure in MEASURES:
        values = np.array([value for record in records if (value := record.get(measure)) is not None])
        if len(values):
            found[measure] = _spread(values)
    return found


def _spread(values: np.ndarray) -> Spread:
    drawn = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    low, high = np.quantile(values[drawn].mean(axis=1), [0.025, 0.975])
    return Spread(float(values.mean()), float(low), float(high), float(values.std()), len(values))
