"""Gives legs that end in the shin an ankle, so that bodies without feet can stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.retargeting.body import SIDES, limb
from pfnn_jax.motion.skeleton import Skeleton


def with_ankles(skeleton: Skeleton, body: HumanoidMap) -> tuple[Skeleton, HumanoidMap]:
    """Returns the skeleton and its map with an ankle at the End Site of each shin that has no foot below it.

    The new joints come last, so that the others keep their indices. A skeleton with feet, or whose shins end in
    nothing, is returned as it is.
    """
    added = {}
    for side in SIDES:
        shin, foot = limb(body, side, "shin", "foot")
        ends = [site for joint, site in skeleton.end_sites if joint == shin and np.linalg.norm(site) > 0]
        if foot is None and ends:
            added[f"{side}_foot"] = (shin, max(ends, key=lambda end: float(np.linalg.norm(end))))
    if len(added) < len(SIDES):
        return skeleton, body
    count = skeleton.num_joints
    body = replace(body, **{name: count + number for number, name in enumerate(added)})
    shins, offsets = (np.array(values) for values in zip(*added.values(), strict=True))
    unit = np.array([[1.0, 0.0, 0.0, 0.0]])
    extended = replace(
        skeleton,
        names=(*skeleton.names, *added),
        parents=np.append(skeleton.parents, shins),
        offsets=np.concatenate([skeleton.offsets, offsets]),
        mirror=np.append(skeleton.mirror, [count + 1, count]),
        humanoid=body,
        poses=None if skeleton.poses is None else _with_rows(skeleton.poses, unit),
        reference=None
        if skeleton.reference is None
        else np.concatenate([skeleton.reference, skeleton.reference[shins]]),
    )
    return extended, body


def _with_rows(poses: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Returns poses [N, J, 4] with two more joints at rest."""
    return np.concatenate([poses, np.broadcast_to(row, (len(poses), 2, 4))], axis=1)
