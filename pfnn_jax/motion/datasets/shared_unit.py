"""Finds one unit for files of one skeleton whose own lengths leave it open: children are recorded with adults."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip_files import is_gltf_file, read_joints
from pfnn_jax.motion.datasets.sources import ClipFile
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.find import find_humanoid
from pfnn_jax.motion.length_unit import UNITS, log_likelihoods
from pfnn_jax.motion.skeleton import plain_names

DOUBT = math.log(1000.0)
"""Log ratio of likelihoods up to which a file may have the unit of the others instead of its own likeliest."""


def share_units(clips: Sequence[ClipFile]) -> list[ClipFile]:
    """Returns the clips with their unit where files of one data set with the same joints would be given different ones.

    Files whose unit is known keep it. A file far from human size in the others' unit keeps its own guess.

    Args:
        clips: of one data set or several (`ClipFile.data_set`).
    """
    groups: dict[tuple[str, ...], dict[int, dict[str, float]]] = defaultdict(dict)
    for index, clip in enumerate(clips):
        if clip.read_options.unit is None and (found := _likely_units(clip.path)) is not None:
            names, likely = found
            groups[clip.data_set, *names][index] = likely
    shared = list(clips)
    for group in groups.values():
        best = {index: max(each.values()) for index, each in group.items()}
        losses = {name: sum(min(best[index] - each[name], DOUBT) for index, each in group.items()) for name in UNITS}
        unit = min(losses, key=losses.__getitem__)
        for index, each in group.items():
            if best[index] - DOUBT < each[unit] < best[index]:
                shared[index] = replace(clips[index], unit=UNITS[unit])
    return shared


def _likely_units(path: Path) -> tuple[tuple[str, ...], dict[str, float]] | None:
    """Returns a file's joints and the log likelihood of each unit; None without legs, or if it states its unit or is bad."""
    if is_gltf_file(path):
        return None  # its unit is stated
    try:
        skeleton = read_joints(path)
        body = find_humanoid(skeleton, source=str(path))
        leg = 0.0 if None in (body.left_foot, body.right_foot) else leg_length_of(skeleton, body)
    except (InputError, ValueError):
        return None  # reading the clip reports what is wrong
    return (plain_names(skeleton.names), log_likelihoods(leg)) if leg > 0 else None
