"""Pairs of content and style clips on which style transfer is judged, and classifiers that have seen neither."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from pfnn_jax.evaluation.clip_classifier import (
    ClipClassifier,
    WindowConfig,
    clip_accuracy,
    train_on_windows,
    training_windows,
)
from pfnn_jax.evaluation.style_classifier import ClassifierConfig
from pfnn_jax.evaluation.transfer_judge import Recognisers
from pfnn_jax.motion.clip import MotionClip, resample
from pfnn_jax.motion.datasets.labelled import read_cut_clip
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.length_unit import CMU

OTHER_CONTENT, SAME_CONTENT, SAME_STYLE = "other content", "same content", "same style"
"""Kinds of pairs: the style clip shows another content; the content itself in the target style, which is the ground
truth; or another content in the content's own style, so that the content itself is the right answer."""

WINDOWS = WindowConfig(frames=30, stride=7)
"""Half a second: no clip of xia-test is shorter, so that no padding shows how long a clip is."""

CLASSIFIER = ClassifierConfig(filters=32, epochs=6)
"""The best of three settings on held-out real clips, before anything was judged: 20 epochs recognise 38 % of styles,
6 epochs 45 %, three networks of 6 epochs 48 %."""

PEER_FPS = 30.0
"""Frame rate of the outputs that others released, at which their pairs are judged."""

PARK = "Park 2021"
"""The file headers of its content and style say 24 fps, of its outputs 30; they have the same number of frames."""


@dataclass(frozen=True, eq=False)
class Pair:
    """What is to be transferred.

    Attributes:
        name: of the pair, and of files about it.
        kind: of the pair.
        content, style: the clips.
        truth: a real clip of the content in the style, or None.
    """

    name: str
    kind: str
    content: MotionClip
    style: MotionClip
    truth: MotionClip | None


@dataclass(frozen=True, eq=False)
class PeerPair:
    """A pair with the outputs of another system.

    Attributes:
        pair: at `PEER_FPS`.
        results: name of the output -> clip.
    """

    pair: Pair
    results: dict[str, MotionClip]


def load_xia(folder: Path) -> list[MotionClip]:
    """Returns the clips of xia-test at their own frame rate, with style and content."""
    return [read_cut_clip(file).clip for file in list_clips(folder, kind="xia")]


def xia_pairs(clips: Sequence[MotionClip], limit: int = 0, seed: int = 0) -> list[Pair]:
    """Returns the pairs of all clips.

    Args:
        clips: one clip for each style and content.
        limit: largest number of pairs of each kind, drawn at random; 0 for all.
        seed: of the draw.
    """
    by_label = {(clip.style, clip.content): clip for clip in clips}
    pairs: dict[str, list[Pair]] = {OTHER_CONTENT: [], SAME_CONTENT: [], SAME_STYLE: []}
    for content in clips:
        for style in clips:
            kind = _kind(content, style)
            if kind:
                truth = by_label.get((style.style, content.content))
                pairs[kind].append(Pair(f"{_label(content)}__{_label(style)}", kind, content, style, truth))
    rng = np.random.default_rng(seed)
    chosen = {
        kind: sorted(rng.permutation(len(own))[:limit].tolist()) if limit else range(len(own))
        for kind, own in pairs.items()
    }
    return [pairs[kind][number] for kind, numbers in chosen.items() for number in numbers]


def _kind(content: MotionClip, style: MotionClip) -> str | None:
    if content.style == style.style:
        return SAME_STYLE if content.content != style.content else None
    return SAME_CONTENT if content.content == style.content else OTHER_CONTENT


def _label(clip: MotionClip) -> str:
    return f"{clip.style}_{clip.content}"


@dataclass(frozen=True, eq=False)
class Folds:
    """Classifiers of held-out folds of the clips, each trained when it is first needed.

    Attributes:
        clips: one clip for each style and content.
        config: of the networks.
        networks: number of networks whose probabilities are averaged.
    """

    clips: tuple[MotionClip, ...]
    config: ClassifierConfig = CLASSIFIER
    networks: int = 3

    def recognisers(self, pair: Pair) -> Recognisers:
        """Returns classifiers that have seen neither a pair's content clip nor its ground truth.

        Styles are classified by networks that have seen no clip of the content, in any style. Contents are classified
        by networks that have seen no clip of the two styles. The style clip of a pair of another content has been seen
        with its style, and no more than any other clip of the style.
        """
        styles = frozenset({pair.content.style, pair.style.style})
        return Recognisers(self.of_styles(pair.content.content), self.of_contents(styles))

    @cache  # noqa: B019  folds live as long as the experiment
    def of_styles(self, content: str) -> ClipClassifier:
        """Returns a classifier of styles that has seen all contents but one."""
        return self._train([clip for clip in self.clips if clip.content != content], "style")

    @cache  # noqa: B019
    def of_contents(self, styles: frozenset[str]) -> ClipClassifier:
        """Returns a classifier of contents that has seen all styles but some."""
        return self._train([clip for clip in self.clips if clip.style not in styles], "content")

    @cache  # noqa: B019
    def of_all(self) -> ClipClassifier:
        """Returns a classifier of styles that has seen all clips, for features only."""
        return self._train(list(self.clips), "style")

    def accuracy(self, pairs: Iterable[Pair]) -> dict[str, float]:
        """Returns the share of real clips that the folds of these pairs recognise and have not seen."""
        pairs = list(pairs)
        found: dict[str, list[float]] = {"style": [], "content": []}
        for content in sorted({pair.content.content for pair in pairs}):
            own = [clip for clip in self.clips if clip.content == content]
            found["style"] += [clip_accuracy(self.of_styles(content), [clip], [clip.style]) for clip in own]
        for styles in sorted({frozenset({p.content.style, p.style.style}) for p in pairs}, key=sorted):
            own = [clip for clip in self.clips if clip.style in styles]
            found["content"] += [clip_accuracy(self.of_contents(styles), [clip], [clip.content]) for clip in own]
        return {kind: float(np.mean(values)) for kind, values in found.items()}

    def _train(self, clips: list[MotionClip], label: str) -> ClipClassifier:
        parts = [self._windows[_label(clip)] for clip in clips]
        labels, skeleton = [getattr(clip, label) for clip in clips], self.clips[0].skeleton
        return train_on_windows(parts, labels, skeleton, WINDOWS, config=self.config, networks=self.networks)

    @cached_property
    def _windows(self) -> dict[str, np.ndarray]:
        return {_label(clip): training_windows(clip, self.clips[0].skeleton, WINDOWS) for clip in self.clips}


def load_peers(folder: Path, clips: Sequence[MotionClip]) -> list[PeerPair]:
    """Returns the pairs of Aberman 2020 and Park 2021, with their outputs.

    Args:
        folder: of the released outputs.
        clips: those of xia-test, which hold the contents, styles and ground truths of Aberman 2020.
    """
    by_label = {(clip.style, clip.content): clip for clip in clips}

    def output(name: str) -> MotionClip:
        file = ClipFile(folder / f"{name}.bvh", "result", unit=CMU)
        return resample(replace(read_cut_clip(file).clip, fps=PEER_FPS), PEER_FPS)

    def aberman(name: str, content: tuple[str, str], style: tuple[str, str]) -> PeerPair:
        found = by_label[content], by_label[style], by_label[style[0], content[1]]
        pair = Pair(f"aberman_{name}", "Aberman 2020", *(resample(clip, PEER_FPS) for clip in found))
        results = {f"Aberman 2020, {form}": output(f"aberman_{name}_{form}") for form in ("raw", "fixed")}
        return PeerPair(pair, results)

    content = replace(output("park_walking_neutral"), style="neutral", content="walk")
    style = replace(output("park_jumping_old"), style="old", content="jump")
    results = {f"{PARK}, {form}": output(f"park_output_{form}_fs") for form in ("ref", "latent")}
    return [
        aberman("demo_3d_2", ("neutral", "jump"), ("angry", "run")),
        aberman("comp_3d_2", ("sexy", "walk"), ("depressed", "punch")),
        PeerPair(Pair("park", PARK, content, style, None), results),
    ]
