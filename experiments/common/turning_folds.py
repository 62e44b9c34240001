"""Folds of experiments on few-shot learning: a style is learned from one straight walk and judged on its real turns.

A fold is a held-out style of Bandai-Namco-2 and a seed. Its adaptation clip is the beginning of one straight walk and
its mirror image; its test takes are every second turning take of the style, along which `turning_judged` drives every
learned style. Two networks belong to it: one that knows the other styles alone, and one that also knows the held-out
style, from all takes but the test takes. Networks and judged walks are kept in the folder of results, so that an
experiment resumes where it stopped, experiments share them, and tables are made again without running.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any

import jax
import numpy as np

from experiments.common.style_takes import (
    Take,
    TrainedNetwork,
    adaptation_clip,
    balanced,
    load_takes,
    pretrain_on,
)
from experiments.common.turning_judged import Body, JudgedWalks, StyledNetwork, judge_network, recogniser_of
from experiments.common.turning_judged import load_takes as load_driven_takes
from experiments.common.turning_table import Results, load_judged, save_judged, write_tables
from pfnn_jax.evaluation.driven_takes import DrivenTake
from pfnn_jax.evaluation.turning_judge import StyleRecogniser
from pfnn_jax.io.checkpoint import load_record, save_record
from pfnn_jax.io.files import locate, read_note
from pfnn_jax.models.network import init_network
from pfnn_jax.models.style import Style, init_bank
from pfnn_jax.motion.datasets.sources import ClipFile, list_clips
from pfnn_jax.motion.features.decode import median_speed
from pfnn_jax.motion.features.encode import Features
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import load_normaliser, save_normaliser
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.pretraining import POSE_NOISE

NOTE = "network.json"

CHOOSING, CONFIRMING = ("active", "elderly", "feminine", "normal"), ("exhausted", "masculine", "youthful")
"""Styles on which methods are chosen, and those on which the choice is confirmed once."""


@dataclass(frozen=True)
class FoldConfig:
    """The settings that experiments on these folds share.

    Attributes:
        data: folder of Bandai-Namco-2 BVH files.
        out: folder of networks, judged walks and tables.
        styles: held-out styles.
        seeds: each has its own networks, adaptation clip and learning.
        seconds: length of the adaptation clip.
        hidden, steps, batch_size, learning_rate: settings of pretraining; the learning rate is 10 times the paper's,
            because batches are 8 times larger and steps fewer.
        limit: largest number of takes of each style and content, 0 for all.
    """

    data: Path
    out: Path
    styles: tuple[str, ...] = CHOOSING
    seeds: tuple[int, ...] = (0,)
    seconds: float = 5.0
    hidden: int = 512
    steps: int = 2000
    batch_size: int = 256
    learning_rate: float = 1e-3
    limit: int = 0


@dataclass(frozen=True)
class NetworkKind:
    """What a network of a fold is pretrained on, and how.

    Attributes:
        full: whether it knows the held-out style too, from all takes but the test takes.
        num_known: number of other styles, the first by name; None for all.
        dropout: of pretraining.
        pose_noise: of pretraining.
    """

    full: bool = False
    num_known: int | None = None
    dropout: float = 0.3
    pose_noise: float = 0.0

    @property
    def name(self) -> str:
        """Its name in file names, e.g. `without` or `full_noise0.1_dropout0.2`."""
        parts = ["full" if self.full else "without"]
        if self.num_known is not None:
            parts.append(f"known{self.num_known}")
        if self.pose_noise:
            parts.append(f"noise{self.pose_noise:g}")
        if self.dropout != NetworkKind.dropout:
            parts.append(f"dropout{self.dropout:g}")
        return "_".join(parts)


WITHOUT, FULL = NetworkKind(), NetworkKind(full=True)
"""The networks without the held-out style and with it, pretrained as in the paper."""

NOISY, FULL_NOISY = NetworkKind(pose_noise=POSE_NOISE), NetworkKind(full=True, pose_noise=POSE_NOISE)
"""The same, pretrained with noise on poses, as is the default."""


@dataclass(frozen=True)
class Method:
    """A method of learning a style.

    Attributes:
        learn: returns the style for a fold and a kind of network; or (network, style) where the network changes too.
        kind: of the network.
    """

    learn: Callable[[Fold, NetworkKind], Any]
    kind: NetworkKind = NOISY


class TurningFolds:
    """The takes of a folder, the networks that are pretrained on them, and the judge.

    Attributes:
        takes: of all styles.
        layout, skeleton: of all takes.
        styles: names of all styles.
    """

    def __init__(self, config: FoldConfig) -> None:
        self.config = config
        self.takes, self.layout, self.skeleton = load_takes(config.data, config.limit)
        self.styles = tuple(sorted({take.style for take in self.takes}))

    def folds(self) -> Iterator[Fold]:
        """Yields the folds of all configured styles and seeds."""
        for style in self.config.styles:
            for seed in self.config.seeds:
                yield Fold(self, style, seed)

    @cached_property
    def files(self) -> dict[str, ClipFile]:
        """The files of all takes, by name."""
        return {file.path.stem: file for file in list_clips(self.config.data)}

    @cached_property
    def recogniser(self) -> StyleRecogniser:
        """A classifier that saw all takes of all styles."""
        return recogniser_of([self.files[take.name] for take in self.takes], self.layout.fps)


@dataclass(frozen=True, eq=False)
class Fold:
    """One held-out style and seed.

    Attributes:
        everything: the takes of all styles.
        style: the held-out style.
        seed: of networks, adaptation clip and learning.
    """

    everything: TurningFolds
    style: str
    seed: int

    @property
    def layout(self) -> FrameLayout:
        return self.everything.layout

    @cached_property
    def own(self) -> list[Take]:
        """All takes of the held-out style."""
        return [take for take in self.everything.takes if take.style == self.style]

    @cached_property
    def walks(self) -> list[Take]:
        """Its straight walks; that of the adaptation clip is the first."""
        walks = [take for take in self.own if take.content == "walk"]
        first = self.seed % len(walks)
        return [walks[first], *walks[:first], *walks[first + 1 :]]

    @cached_property
    def clip(self) -> tuple[Features, Features]:
        """The adaptation clip and its mirror image."""
        return adaptation_clip(self.walks[0], round(self.everything.config.seconds * self.layout.fps))

    @cached_property
    def other_turns(self) -> list[Take]:
        """The turning takes of the held-out style that are not test takes."""
        return self._turns[0::2]

    @cached_property
    def test_takes(self) -> list[Take]:
        """Every second turning take of the held-out style, which no method and no network sees."""
        return self._turns[1::2]

    @cached_property
    def _turns(self) -> list[Take]:
        return [take for take in self.own if "turn" in take.content]

    def known_styles(self, kind: NetworkKind = WITHOUT) -> tuple[str, ...]:
        """Returns the styles that a network knows, in the order of its bank."""
        others = tuple(style for style in self.everything.styles if style != self.style)[: kind.num_known]
        return tuple(sorted((*others, self.style))) if kind.full else others

    def known_takes(self, kind: NetworkKind = WITHOUT) -> dict[str, list[Take]]:
        """Returns the takes that a network is pretrained on, by style."""
        tested = {take.name for take in self.test_takes}
        learnable = [take for take in self.everything.takes if take.name not in tested]
        return {style: [take for take in learnable if take.style == style] for style in self.known_styles(kind)}

    @cached_property
    def speed(self) -> float:
        """Metres per second of the adaptation clip."""
        return float(median_speed(self.layout, self.clip[0].y))

    @cached_property
    def driven_takes(self) -> list[DrivenTake]:
        """The test takes, as characters are driven along them."""
        return self.drivable(self.test_takes)

    def drivable(self, takes: Sequence[Take]) -> list[DrivenTake]:
        """Returns takes as characters are driven along them."""
        # Only layout and skeleton of the body are read.
        return load_driven_takes([self.everything.files[take.name] for take in takes], self.body(self.network()))

    def body(self, network: TrainedNetwork) -> Body:
        """Returns what a network of the fold was trained on."""
        return Body(self.layout, self.everything.skeleton, network.normaliser)

    def styled(self, style: Style, kind: NetworkKind) -> StyledNetwork:
        """Returns a network with a style, at the speed of the adaptation clip."""
        network = self.network(kind)
        return StyledNetwork(network.shared, jax.tree.map(np.asarray, style), self.body(network), self.speed)

    def network(self, kind: NetworkKind = WITHOUT) -> TrainedNetwork:
        """Returns a network of this fold: the one that was kept, or one that is pretrained and kept now."""
        folder = self.everything.config.out / "networks" / f"{kind.name}_{self.style}_{self.seed}"
        settings = self._settings(kind)
        if locate(folder / "parameters") is None:
            takes = [take for own in self.known_takes(kind).values() for take in own]
            parts = balanced(takes, self.known_styles(kind), self.seed)
            save_network(folder, pretrain_on(parts, self.layout, settings))
        return load_network(folder, settings, self.layout, len(self.known_styles(kind)))

    def _settings(self, kind: NetworkKind) -> PretrainConfig:
        config = self.everything.config
        return PretrainConfig(
            hidden=config.hidden,
            steps=config.steps,
            batch_size=config.batch_size,
            learning_rate=config.learning_rate,
            dropout=kind.dropout,
            pose_noise=kind.pose_noise,
            seed=self.seed,
        )

    def own_style(self, kind: NetworkKind = FULL) -> Style:
        """Returns the held-out style of a network that knows it."""
        return style_of(self.network(kind), self.known_styles(kind).index(self.style))

    def judge(
        self,
        name: str,
        learn: Callable[[], Style],
        kind: NetworkKind = WITHOUT,
    ) -> None:
        """Learns the held-out style and judges it along the test takes, unless that was done before.

        Args:
            name: of the method.
            learn: returns the parameters of the style.
            kind: of the network.
        """
        file = judged_file(self.everything.config, self.style, self.seed, name)
        if file.exists():  # before networks and the recogniser are trained for nothing
            return
        self.network(kind)  # not to be trained while learning is timed
        judge_once(file, lambda: self.styled(learn(), kind), self.driven_takes, self.style, self.everything.recogniser)


def judge_once(
    file: Path,
    learn: Callable[[], StyledNetwork],
    takes: Sequence[DrivenTake],
    style: str,
    recogniser: StyleRecogniser | None,
) -> None:
    """Learns a style and judges it along takes, unless the file of its measures exists.

    Args:
        file: of the measures, as `turning_table.save_judged` writes it.
        learn: returns the network with the style; it is timed.
        takes: along which the style is driven.
        style: its name, for the recogniser.
        recogniser: of styles, or None.
    """
    if file.exists():
        return
    started = time.perf_counter()
    styled = learn()
    seconds = time.perf_counter() - started
    judged = judge_network(styled, takes, style, recogniser)
    save_judged(file, judged, seconds=seconds)
    found = ", ".join(f"{way} {walks.means()['distance']:.2f}" for way, walks in judged.items())
    print(f"{file.parent.name} {file.stem}: {found} cm, learned in {seconds:.1f} s", flush=True)


def style_of(network: TrainedNetwork, number: int) -> Style:
    """Returns one style of the bank of a network."""
    return jax.tree.map(lambda leaf: leaf[number], network.bank)


def no_style(network: TrainedNetwork) -> Style:
    """Returns a style that changes nothing, of the form of the bank's."""
    return jax.tree.map(lambda leaf: np.zeros_like(leaf[0]), network.bank)


def save_network(folder: Path, network: TrainedNetwork) -> None:
    """Writes the parameters and the normaliser of a network into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    save_normaliser(folder / "normaliser", network.normaliser)
    tree = {"shared": network.shared, "bank": network.bank}
    save_record(folder / "parameters", tree, NOTE, {"loss": network.loss})


def load_network(folder: Path, config: PretrainConfig, layout: FrameLayout, num_styles: int) -> TrainedNetwork:
    """Returns the network that `save_network` wrote, of the sizes of a configuration."""

    def fresh() -> dict[str, Any]:
        key, sizes = jax.random.key(0), config.network(layout)
        bank = init_bank(config.adapter, sizes, num_styles, key=key)
        return {"shared": init_network(sizes, key=key), "bank": bank}

    tree = jax.tree.map(np.asarray, load_record(folder / "parameters", jax.eval_shape(fresh)))
    loss = read_note(folder / "parameters", NOTE, "must be a network that save_network wrote")["loss"]
    return TrainedNetwork(tree["shared"], tree["bank"], load_normaliser(folder / "normaliser"), loss)


def load_results(config: FoldConfig, methods: Sequence[str]) -> Results:
    """Returns the judged walks of methods on the configured folds, as far as they exist in the folder of results."""
    found: dict[str, dict[tuple[str, int], dict[str, JudgedWalks]]] = {}
    for method in methods:
        for style, seed in product(config.styles, config.seeds):
            if (file := judged_file(config, style, seed, method)).exists():
                found.setdefault(method, {})[style, seed] = load_judged(file)
    return found


def judged_file(config: FoldConfig, style: str, seed: int, method: str) -> Path:
    """Returns where the measures of a method on a fold are kept."""
    return config.out / "judged" / f"{style}_{seed}" / f"{method}.json"


def run_methods(config: FoldConfig, name: str, methods: Mapping[str, Method], others: Sequence[str] = ()) -> None:
    """Judges the methods of an experiment on all folds, and writes their tables as `NAME.md`.

    Args:
        config: the folds.
        name: of the experiment.
        methods: by name.
        others: methods of other experiments that the tables show too, where they were judged.
    """
    for fold in TurningFolds(config).folds():
        for method, how in methods.items():
            fold.judge(method, partial(how.learn, fold, how.kind), how.kind)
    write_tables(config.out, name, load_results(config, [*others, *methods]))
