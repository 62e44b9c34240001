"""Takes of several styles as rows in memory, and networks that are pretrained on some of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from pfnn_jax.models.network import Network
from pfnn_jax.motion.clip import mirror_clip
from pfnn_jax.motion.datasets.labelled import load_labelled
from pfnn_jax.motion.datasets.sources import list_clips
from pfnn_jax.motion.features.encode import Features, clip_features, join_rows, select_rows
from pfnn_jax.motion.features.layout import FrameLayout, mason2018
from pfnn_jax.motion.features.normaliser import Normaliser, fit_normaliser
from pfnn_jax.motion.labels.phase import mirror_phase
from pfnn_jax.motion.skeleton import Skeleton
from pfnn_jax.training.config import PretrainConfig
from pfnn_jax.training.data import Rows
from pfnn_jax.training.pretraining import pretrain


@dataclass(frozen=True, eq=False)
class Take:
    """The rows of one take and of its mirror image."""

    style: str
    content: str
    name: str
    rows: Features
    mirrored: Features


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A pretrained network.

    Attributes:
        shared: style-agnostic parameters.
        bank: the styles it was trained on, leaves [S, ...].
        normaliser: statistics of their rows.
        loss: mean loss of the last dispatch.
    """

    shared: Network
    bank: Any
    normaliser: Normaliser
    loss: float


def load_takes(data: Path, limit: int = 0) -> tuple[list[Take], FrameLayout, Skeleton]:
    """Returns the takes of a folder as rows of `mason2018`, with their layout and skeleton.

    Args:
        data: folder of clips on one skeleton.
        limit: largest number of takes of each style and content, 0 for all.
    """
    takes, counts, layout, skeleton = [], {}, None, None
    for clip_file in list_clips(data):
        key = (clip_file.style, clip_file.content)
        counts[key] = counts.get(key, 0) + 1
        if limit and counts[key] > limit:
            continue
        found = load_labelled(clip_file)
        skeleton = skeleton or found.clip.skeleton
        layout = layout or mason2018(skeleton.num_joints)
        mirrored = clip_features(mirror_clip(found.clip), layout, mirror_phase(found.labels))
        rows = clip_features(found.clip, layout, found.labels)
        takes.append(Take(*key, clip_file.path.stem, rows, mirrored))
    assert layout is not None and skeleton is not None  # list_clips refuses an empty folder
    return takes, layout, skeleton


def rows_of(takes: Sequence[Take]) -> Features:
    """Returns the rows of takes and of their mirror images, one take after another."""
    return join_rows([part for take in takes for part in (take.rows, take.mirrored)])


def adaptation_clip(walk: Take, frames: int) -> tuple[Features, Features]:
    """Returns the first rows of a walk and of its mirror image."""
    return select_rows(walk.rows, slice(0, frames)), select_rows(walk.mirrored, slice(0, frames))


def balanced(takes: Sequence[Take], styles: Sequence[str], seed: int) -> dict[str, Features]:
    """Returns equal numbers of random rows of each style, mirror images included."""
    rng = np.random.default_rng(seed)
    rows = {style: rows_of([take for take in takes if take.style == style]) for style in styles}
    count = min(len(part.x) for part in rows.values())
    picks = {style: rng.permutation(len(part.x))[:count] for style, part in rows.items()}
    return {style: select_rows(part, picks[style]) for style, part in rows.items()}


def pretrain_on(parts: Mapping[str, Features], layout: FrameLayout, config: PretrainConfig) -> TrainedNetwork:
    """Pretrains a network on the rows of some styles."""
    normaliser = fit_normaliser([p.x for p in parts.values()], [p.y for p in parts.values()], layout, grouped=True)
    data = Rows.from_features({style: [part] for style, part in parts.items()}, layout, normaliser)
    losses: list[float] = []
    state = pretrain(data, config, progress_callback=lambda progress: losses.append(progress.loss))
    shared, bank = (jax.tree.map(np.asarray, tree) for tree in (state.params.shared, state.params.modulation))
    return TrainedNetwork(shared, bank, normaliser, losses[-1])
