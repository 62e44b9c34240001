"""Classifiers of whole clips, by style or by content: the recognition of results by a network that saw real clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pfnn_jax.evaluation.motion_windows import STRIDE, WINDOW_FRAMES, point_windows
from pfnn_jax.evaluation.style_classifier import ClassifierConfig, StyleClassifier, features, scores, train_classifier
from pfnn_jax.motion.clip import MotionClip, mirror_clip
from pfnn_jax.motion.retargeting.retarget import retarget
from pfnn_jax.motion.skeleton import Skeleton

TIME_SCALES = (0.8, 0.9, 1.0, 1.1, 1.25)
"""Speeds at which each training clip is also played."""


@dataclass(frozen=True)
class WindowConfig:
    """The windows that a clip is cut into.

    Attributes:
        frames: of a window at 60 fps. Where the length of a clip tells its label, windows must not be longer than the
            shortest clip, or padding shows the label.
        stride: frames between the starts of two windows.
        mirror: whether mirror images train as well.
        time_scales: speeds at which each clip trains.
    """

    frames: int = WINDOW_FRAMES
    stride: int = STRIDE
    mirror: bool = True
    time_scales: tuple[float, ...] = TIME_SCALES


@dataclass(frozen=True, eq=False)
class ClipClassifier:
    """Networks that tell the label of a clip.

    Attributes:
        networks: classifiers of windows; their probabilities are averaged.
        labels: the labels, in the order of the networks' outputs.
        skeleton: what clips are put onto.
        windows: how clips are cut.
    """

    networks: tuple[StyleClassifier, ...]
    labels: tuple[str, ...]
    skeleton: Skeleton
    windows: WindowConfig

    def probabilities(self, clip: MotionClip) -> np.ndarray:
        """Returns the probability [L] of each label for a whole clip: the mean over networks and windows."""
        windows = self._windows_of(clip)
        logits = np.stack([scores(network, windows) for network in self.networks])
        likely = np.exp(logits - logits.max(axis=-1, keepdims=True))
        return (likely / likely.sum(axis=-1, keepdims=True)).mean(axis=(0, 1))

    def probability(self, clip: MotionClip, label: str) -> float:
        """Returns the probability of one label for a whole clip."""
        return float(self.probabilities(clip)[self.labels.index(label)])

    def label(self, clip: MotionClip) -> str:
        """Returns the most probable label of a clip."""
        return self.labels[int(self.probabilities(clip).argmax())]

    def features(self, clip: MotionClip) -> np.ndarray:
        """Returns the features [N, F] of a clip's windows under the first network, for the Fréchet distance."""
        return features(self.networks[0], self._windows_of(clip))

    def _windows_of(self, clip: MotionClip) -> np.ndarray:
        return _cut(clip, self.skeleton, self.windows)


def train_clip_classifier(
    clips: Sequence[MotionClip],
    labels: Sequence[str],
    *,
    windows: WindowConfig | None = None,
    config: ClassifierConfig | None = None,
    networks: int = 1,
) -> ClipClassifier:
    """Trains a classifier on real clips, with equal total weight for every label.

    Args:
        clips: real clips of any skeletons; all are put onto that of the first.
        labels: of each clip.
        windows: how clips are cut and varied.
        config: of each network; its seed is that of the first.
        networks: number of networks, with consecutive seeds.
    """
    windows, skeleton = windows or WindowConfig(), clips[0].skeleton
    parts = [training_windows(clip, skeleton, windows) for clip in clips]
    return train_on_windows(parts, labels, skeleton, windows, config=config, networks=networks)


def train_on_windows(
    parts: Sequence[np.ndarray],
    labels: Sequence[str],
    skeleton: Skeleton,
    windows: WindowConfig,
    *,
    config: ClassifierConfig | None = None,
    networks: int = 1,
) -> ClipClassifier:
    """Trains as `train_clip_classifier`, on windows that have been cut: where many classifiers share clips.

    Args:
        parts: windows of each clip, as `training_windows` returns them.
        labels: of each clip.
        skeleton, windows: that the windows were cut with.
        config: of each network; its seed is that of the first.
        networks: number of networks, with consecutive seeds.
    """
    config, known = config or ClassifierConfig(), tuple(sorted(set(labels)))
    rows = np.concatenate(parts)
    targets = np.repeat([known.index(label) for label in labels], [len(part) for part in parts])
    trained = [
        train_classifier(rows, targets, len(known), replace(config, seed=config.seed + number))
        for number in range(networks)
    ]
    return ClipClassifier(tuple(trained), known, skeleton, windows)


def clip_accuracy(classifier: ClipClassifier, clips: Sequence[MotionClip], labels: Sequence[str]) -> float:
    """Returns the share of clips whose most probable label is their own."""
    return float(np.mean([classifier.label(clip) == label for clip, label in zip(clips, labels, strict=True)]))


def training_windows(clip: MotionClip, skeleton: Skeleton, windows: WindowConfig) -> np.ndarray:
    """Returns the windows [N, frames, 126] of a clip, of its mirror image, and of both at other speeds."""
    images = (clip, mirror_clip(clip)) if windows.mirror else (clip,)
    played = [replace(image, fps=image.fps * scale) for image in images for scale in windows.time_scales]
    return np.concatenate([_cut(one, skeleton, windows) for one in played])


def _cut(clip: MotionClip, skeleton: Skeleton, windows: WindowConfig) -> np.ndarray:
    own = clip if clip.skeleton is skeleton else retarget(clip, skeleton).clip
    return point_windows(own, frames=windows.frames, stride=windows.stride)
