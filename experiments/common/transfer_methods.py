"""The methods of style transfer that are judged, by name, each from a pair of clips to a clip."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import jax
import numpy as np

from experiments.common.transfer_pairs import Pair
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.transfer.clip_rows import encode_clip, prepare_clip
from pfnn_jax.transfer.config import LossWeights, OptimisationConfig, TransformationTrainingConfig
from pfnn_jax.transfer.finish import finish_clip
from pfnn_jax.transfer.optimisation import optimise
from pfnn_jax.transfer.pairing import GaitClip, pair_by_gait
from pfnn_jax.transfer.run import TransferRun
from pfnn_jax.transfer.transformation import TransformationNetwork
from pfnn_jax.transfer.transformation_training import apply_network, train_transformation

ANCHORS = ("content", "style clip", "ground truth")
"""Clips that no method made: nothing done, the style clip in place of a result, and the real clip."""

STRENGTHS = (0.0, 0.5, 1.0, 1.5)
"""Of the curve; 0 is the content, 1 the method itself."""


@dataclass(frozen=True)
class Finish:
    """How rows of a method become a clip.

    Attributes:
        rows: name of the method that the rows come from.
        strength: of the transfer.
        foot_ik: whether feet are held.
    """

    rows: str
    strength: float = 1.0
    foot_ik: bool = True


FINISHES = {
    "optimisation": Finish("optimisation"),
    "optimisation, no constraints": Finish("optimisation, no constraints"),
    "optimisation, no IK": Finish("optimisation", foot_ik=False),
    "optimisation, neither": Finish("optimisation, no constraints", foot_ik=False),
    "optimisation, whole motion": Finish("optimisation, whole motion"),
    "optimisation, 0.5": Finish("optimisation", strength=0.5),
    "optimisation, 1.5": Finish("optimisation", strength=1.5),
    "fast": Finish("fast"),
    "fast, whole motion": Finish("fast, whole motion"),
    "fast, no projection": Finish("fast, no projection"),
    "fast, no constraints": Finish("fast, no constraints"),
    "fast, no IK": Finish("fast", foot_ik=False),
    "fast, 0.5": Finish("fast", strength=0.5),
    "fast, 1.5": Finish("fast", strength=1.5),
}
"""Methods that make clips. "No constraints" leaves out the losses of feet, bones and the trajectory. "Whole motion" is
the form of the papers, in which all of the result passes the autoencoder, and not the change to the content alone; "no
projection" is the output of the same network itself."""


def without_constraints(weights: LossWeights) -> LossWeights:
    """Returns the weights without those of feet, bones and the trajectory."""
    return replace(weights, foot=0.0, bone=0.0, trajectory=0.0)


@dataclass(eq=False)
class Methods:
    """Makes results.

    Attributes:
        run: with the autoencoder.
        clips: the clips of xia-test, from which fast networks learn.
        contents: more contents for fast networks.
        optimisation: settings.
        training: settings of fast networks.
        seed: of noise and training.
        networks: fast networks that have been trained, by style, content that was left out, and settings.
        rows: rows that have been made, by method and pair.
    """

    run: TransferRun
    clips: Sequence[MotionClip]
    contents: Sequence[MotionClip] = ()
    optimisation: OptimisationConfig = OptimisationConfig()
    training: TransformationTrainingConfig = TransformationTrainingConfig()
    seed: int = 0
    networks: dict[tuple, TransformationNetwork] = field(default_factory=dict)
    rows: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)

    def result(self, name: str, pair: Pair) -> MotionClip | None:
        """Returns the result of a method for a pair; None where it has none."""
        if name in ANCHORS:
            return {"content": pair.content, "style clip": pair.style, "ground truth": pair.truth}[name]
        finish = FINISHES[name]
        key = finish.rows, pair.name
        if key not in self.rows:
            made = self._optimised if finish.rows.startswith("optimisation") else self._by_network
            self.rows[key] = made(finish.rows, pair)
        run = self.run
        return finish_clip(
            self.rows[key], pair.content, run.skeleton, run.layout, strength=finish.strength, foot_ik=finish.foot_ik
        )

    def encoded(self, clip: MotionClip) -> np.ndarray:
        """Returns the rows [T, D] of a clip, on the run's skeleton."""
        return encode_clip(prepare_clip(clip, self.run.skeleton), self.run.layout)

    def _optimised(self, name: str, pair: Pair) -> np.ndarray:
        config = self.optimisation
        if name.endswith("no constraints"):
            config = replace(config, weights=without_constraints(config.weights), constraint_iterations=0)
        if name.endswith("whole motion"):
            config = replace(config, keep_detail=False)
        content, style = self.encoded(pair.content), self.encoded(pair.style)
        return optimise(self.run, content, [style], config, key=jax.random.key(self.seed))

    def _by_network(self, name: str, pair: Pair) -> np.ndarray:
        config = self.training
        if name.endswith("no constraints"):
            config = replace(config, weights=without_constraints(config.weights))
        if name.endswith(("whole motion", "no projection")):
            config = replace(config, keep_detail=False)
        key = pair.style.style, pair.content.content, config
        if key not in self.networks:
            self.networks[key] = self._train(pair, config)
        project, rows = not name.endswith("no projection"), self.encoded(pair.content)
        return apply_network(self.run, self.networks[key], rows, project=project, keep_detail=config.keep_detail)

    def _train(self, pair: Pair, config: TransformationTrainingConfig) -> TransformationNetwork:
        """Trains a network of the pair's style that has seen no clip of the pair's content in xia-test."""

        def gaits(keep: Callable[[MotionClip], bool]) -> list[GaitClip]:
            return [GaitClip(self.encoded(clip), clip.content, clip.source) for clip in self.clips if keep(clip)]

        left_out, style = pair.content.content, pair.style.style
        styles = gaits(lambda clip: clip.content != left_out and clip.style == style)
        contents = gaits(lambda clip: clip.content != left_out and clip.style != style)
        contents += [GaitClip(self.encoded(clip), clip.content, clip.source) for clip in self.contents]
        pairing = pair_by_gait(contents, styles, self.run.layout)
        return train_transformation(self.run, contents, styles, pairing, config)[0]
