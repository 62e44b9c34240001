"""Pairs contents with clips of a style by gait: the clips whose Gram matrix a content's result must have.

The paper pairs running with the style's run and walking with its walk (Holden et al. 2017, Style). Labels decide where
both sides have them, else the gait is measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.body_points import POINT_NAMES
from pfnn_jax.motion.labels.contacts import GRAVITY, JOG_SPEED, STAND_SPEED
from pfnn_jax.transfer.layout import LAYOUT_FPS, ClipLayout
from pfnn_jax.transfer.losses import root_rates, row_points

Gait = Literal["stand", "walk", "run"]

ALL = "every gait"
"""Name of the group of all clips of a style, for contents of a gait that it does not have."""


@dataclass(frozen=True, eq=False)
class GaitClip:
    """Rows of a clip, with what is known about its content.

    Attributes:
        rows: [T, D] in layout units.
        content: label of the content, such as `walk-turn-left`; empty if unknown.
        name: for messages.
    """

    rows: np.ndarray
    content: str = ""
    name: str = "clip"


@dataclass(frozen=True, eq=False)
class Pairing:
    """Which clips of a style go with each content.

    Attributes:
        groups: names of the G groups that some content needs: a label, a measured gait, or `ALL`.
        members: indices of the style's clips in each group.
        group_of: [N] group of each content.
        notes: what was measured or is missing, one line each.
    """

    groups: tuple[str, ...]
    members: tuple[tuple[int, ...], ...]
    group_of: np.ndarray
    notes: tuple[str, ...] = ()


def pair_by_gait(contents: Sequence[GaitClip], styles: Sequence[GaitClip], layout: ClipLayout) -> Pairing:
    """Pairs every content with the style's clips of its label, else with those of its measured gait, else with all.

    Raises:
        InputError: if there is no clip of the style.
    """
    if not styles:
        raise InputError("pair_by_gait", "styles", "none", "must be at least one clip of the style")
    labels = [clip.content for clip in styles]
    gaits: list[Gait] = [measure_gait(clip.rows, layout) for clip in styles]
    groups, group_of, notes = {}, [], {}
    for clip in contents:
        name, members = _matches(clip, labels, gaits, layout, notes)
        groups.setdefault(name, members)
        group_of.append(list(groups).index(name))
    return Pairing(tuple(groups), tuple(groups.values()), np.array(group_of, np.int32), tuple(notes))


def measure_gait(rows: np.ndarray, layout: ClipLayout) -> Gait:
    """Returns the gait of rows [T, D] by speed over leg length, with the limits of `estimate_gait`."""
    at = row_points(np.asarray(rows, float), layout)
    hip, ankle = (at[:, POINT_NAMES.index(name)] for name in ("left_thigh", "left_foot"))
    leg = float(np.linalg.norm(hip - ankle, axis=-1).max())
    speed = float(np.median(np.linalg.norm(_path_velocity(rows, layout), axis=-1))) / np.sqrt(GRAVITY * leg)
    return "stand" if speed < STAND_SPEED else "run" if speed > JOG_SPEED else "walk"


def _path_velocity(rows: np.ndarray, layout: ClipLayout) -> np.ndarray:
    """Returns the root's velocity [T, 2], averaged over a third of a second: speed swings within a step."""
    velocity, _ = root_rates(np.asarray(rows, float), layout)
    width = min(int(LAYOUT_FPS) // 3, len(velocity))
    kernel = np.ones(width) / width
    return np.stack([np.convolve(column, kernel, mode="valid") for column in velocity.T], axis=-1)


def _matches(
    clip: GaitClip, labels: list[str], gaits: list[Gait], layout: ClipLayout, notes: dict[str, None]
) -> tuple[str, tuple[int, ...]]:
    """Returns the name and the members of a content's group; adds to `notes` what was measured."""
    if clip.content and clip.content in labels:
        return clip.content, tuple(i for i, label in enumerate(labels) if label == clip.content)
    gait = measure_gait(clip.rows, layout)
    members = tuple(i for i, own in enumerate(gaits) if own == gait)
    reason = f"content {clip.content} is not in the style" if clip.content else "no label of its content"
    found = f"paired with the style's {len(members)}" if members else "the style has no such clip, all of it is used"
    notes[f"{clip.name}: {reason}; its speed is that of a {gait}, {found}"] = None
    return (f"gait {gait}", members) if members else (ALL, tuple(range(len(gaits))))
