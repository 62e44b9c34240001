"""Restyled rows of known styles, learned in a loop whose parts experiments can vary."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from experiments.common.few_shot_recipes import Learning, clip_rows, known_differences, learn_rows
from experiments.common.style_takes import Take, TrainedNetwork, rows_of
from experiments.common.turning_folds import Fold, NetworkKind
from pfnn_jax.evaluation.style_test import is_turning
from pfnn_jax.models.style import Style
from pfnn_jax.motion.features.decode import median_speed, root_steps
from pfnn_jax.motion.features.encode import Features, select_rows
from pfnn_jax.training.data import Batch, join_batches, to_batch
from pfnn_jax.training.restyling import (
    StyleDifferences,
    fit_mean_row,
    joint_scale,
    joint_shares,
    mean_row,
    restyle,
    speed_scale,
)

BASE = "restyled rows, plain loop"
"""Name of the method that experiments vary: the rows of the default, learned by `few_shot_recipes.minimise` with an
adapter of the paper's form, CP of rank 30 on the second layer."""


def straight_and_turning(takes: Mapping[str, list[Take]]) -> dict[str, tuple[Features, Features]]:
    """Returns the rows of the straight walks and of the turning takes of every style."""
    return {
        style: (
            rows_of([take for take in own if take.content == "walk"]),
            rows_of([take for take in own if "turn" in take.content]),
        )
        for style, own in takes.items()
    }


def draw_rows(parts: Mapping[str, tuple[Features, Features]], count: int, seed: int) -> dict[str, Features]:
    """Returns equally many random turning rows of every style, `count` in all."""
    rng, each = np.random.default_rng(seed), -(-count // len(parts))
    return {style: select_rows(turns, rng.permutation(len(turns.x))[:each]) for style, (_, turns) in parts.items()}


def restyle_turns(
    fold: Fold,
    network: TrainedNetwork,
    parts: Mapping[str, tuple[Features, Features]],
    turns: Mapping[str, Features],
    *,
    clip: Batch | None = None,
    by_speed: bool = True,
    by_joint: bool = True,
) -> Batch:
    """Returns rows of known styles in the style of a clip.

    Args:
        fold: of the new style.
        network: whose normaliser is used.
        parts: straight and turning rows of the known styles, which give mean rows, speeds and shares.
        turns: the rows of these styles that are restyled.
        clip: normalised rows of the new style; by default those of the adaptation clip.
        by_speed: whether differences grow with the walking speed.
        by_joint: whether each joint keeps only the share of its difference that styles have in common.
    """
    layout, clip = fold.layout, clip_rows(fold, network) if clip is None else clip
    speed = float(median_speed(layout, np.asarray(network.normaliser.outputs.invert(clip.y))))
    means, scales, left = {}, {}, []
    for style, (straight, turning) in parts.items():
        means[style] = fit_mean_row(to_batch([straight], network.normaliser))
        known_speed = median_speed(layout, straight.y) if by_speed else speed
        scales[style] = speed_scale(layout, 1 / known_speed)
        turned = to_batch([_to_the_left(fold, turning)], network.normaliser)
        left.append(scales[style] * (fit_mean_row(turned) - means[style]))
    share = joint_scale(layout, joint_shares(layout, np.stack(left))) if by_joint else 1.0
    found = []
    for style, rows in turns.items():
        batch = to_batch([rows], network.normaliser)
        values = np.concatenate([batch.x, batch.y], axis=1) - mean_row(means[style], batch.phase)
        found.append((share * scales[style] * values, batch.phase))
    values, phase = (np.concatenate(leaves).astype(np.float32) for leaves in zip(*found, strict=True))
    x, y = np.split(values, [layout.input_size], axis=1)
    return restyle(StyleDifferences(x, y, phase), clip, layout, network.normaliser)


def _to_the_left(fold: Fold, rows: Features) -> Features:
    turns = is_turning(rows.y, fold.layout) & (root_steps(fold.layout, rows.y)[1] > 0)
    return select_rows(rows, turns)


def default_rows(fold: Fold, kind: NetworkKind) -> Batch:
    """Returns the restyled rows that `few-shot` learns from by default."""
    network = fold.network(kind)
    return restyle(known_differences(fold, kind), clip_rows(fold, network), fold.layout, network.normaliser)


def learn_base(
    fold: Fold,
    kind: NetworkKind,
    learning: Learning = Learning(),  # noqa: B008 - frozen
    **options,
) -> Style:
    """Returns the adapter that is learned from the clip and restyled rows; `options` are those of `learn_rows`."""
    network = fold.network(kind)
    rows = join_batches([clip_rows(fold, network), default_rows(fold, kind)])
    return learn_rows(fold, network, rows, learning, **options)
