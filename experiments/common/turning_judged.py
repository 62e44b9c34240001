"""Judges methods of adding a style along real turning takes, each in the published loop and in the controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from experiments.common.markdown import markdown_table
from pfnn_jax.control.controller import Embodiment, assemble_controller
from pfnn_jax.evaluation.driven_takes import DrivenTake, Walk, follow_takes, make_driven_take, track_takes
from pfnn_jax.evaluation.turning_judge import (
    MEASURES,
    STYLE_MEASURES,
    Judged,
    StyleRecogniser,
    judge_style,
    judge_walk,
    mean_measures,
    train_recogniser,
)
from pfnn_jax.inference.predictor import assemble_predictor
from pfnn_jax.models.network import Network
from pfnn_jax.models.style import Style
from pfnn_jax.motion.datasets.labelled import load_clip, load_labelled
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.features.layout import FrameLayout
from pfnn_jax.motion.features.normaliser import Normaliser
from pfnn_jax.motion.skeleton import Skeleton

WAYS = ("loop", "controller")
"""How characters are driven: by `follow_takes` and `track_takes`."""


@dataclass(frozen=True, eq=False)
class Body:
    """What a network was trained on: an `Embodiment` in memory."""

    layout: FrameLayout
    skeleton: Skeleton
    normaliser: Normaliser


@dataclass(frozen=True, eq=False)
class StyledNetwork:
    """A network with one style.

    Attributes:
        network, style: parameters. Without an adapter, the style is one of zeros, of the same sizes as the others, so
            that all compile once.
        body: of the network.
        speed: metres per second of the style in its data.
    """

    network: Network
    style: Style | None
    body: Embodiment
    speed: float


@dataclass(frozen=True, eq=False)
class JudgedWalks:
    """Measures of one method on one style.

    Attributes:
        takes: `MEASURES` of each take.
        style: `STYLE_MEASURES` of all of them.
    """

    takes: list[Judged]
    style: Judged

    def of_takes(self, measure: str) -> np.ndarray:
        """Returns one measure of all takes [N], for `share_closed`."""
        return np.array([judged[measure] for judged in self.takes])

    def means(self) -> Judged:
        """Returns the means of the measures of takes, and those of the style."""
        return mean_measures(self.takes) | self.style


def load_takes(files: Sequence[ClipFile], body: Embodiment) -> list[DrivenTake]:
    """Returns real takes as characters are driven along them."""
    return [make_driven_take(load_labelled(file, body.layout.fps), body) for file in files]


def recogniser_of(files: Sequence[ClipFile], fps: float) -> StyleRecogniser:
    """Returns a recogniser of the styles of all files."""
    styles = sorted({file.style for file in files})
    return train_recogniser({style: [load_clip(f, fps=fps) for f in files if f.style == style] for style in styles})


def judge_network(
    styled: StyledNetwork, takes: Sequence[DrivenTake], name: str, recogniser: StyleRecogniser | None
) -> dict[str, JudgedWalks]:
    """Returns the measures of a network with a style, by `WAYS`; `name` is that of the style for the recogniser."""
    walks = dict(zip(WAYS, drive(styled, takes), strict=True))
    return {way: judge_walks(takes, own, name, recogniser) for way, own in walks.items()}


def judge_walks(
    takes: Sequence[DrivenTake],
    walks: Sequence[Walk],
    name: str | None = None,
    recogniser: StyleRecogniser | None = None,
) -> JudgedWalks:
    """Returns the measures of walks along takes; arguments as of `judge_style`."""
    judged = [judge_walk(*pair) for pair in zip(takes, walks, strict=True)]
    return JudgedWalks(judged, judge_style(takes, walks, name, recogniser))


def drive(styled: StyledNetwork, takes: Sequence[DrivenTake]) -> tuple[list[Walk], list[Walk]]:
    """Returns the walks of a network with a style along takes, in the published loop and in the controller."""
    body, styles = styled.body, {} if styled.style is None else {"style": styled.style}
    predictor = assemble_predictor(styled.network, styled.style, body.normaliser)
    speeds = {name: styled.speed for name in styles}
    controller = assemble_controller(styled.network, styles, body, speeds=speeds)
    return follow_takes(predictor, body, takes), track_takes(controller, controller.style_weights(0), body, takes)


def judged_table(judged: Mapping[str, Mapping[str, JudgedWalks]], way: str) -> str:
    """Returns all measures (rows) of methods (columns) in one way as a Markdown table."""
    means = {name: found[way].means() for name, found in judged.items()}
    rows: list[list[Any]] = [
        [measure, *(None if np.isnan(own[measure]) else own[measure] for own in means.values())]
        for measure in (*MEASURES, *STYLE_MEASURES)
    ]
    return markdown_table([way, *means], rows)
