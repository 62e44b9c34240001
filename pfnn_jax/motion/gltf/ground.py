"""Adds to a character's skeleton how it stands in its bind pose, whose ground is y = 0: feet are put there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.motion.retargeting.body import SIDES, limb
from pfnn_jax.motion.skeleton import Skeleton

ANKLE_SHARE = 0.09
"""Height of an ankle above the ground over the height of the knee, where a leg has none; people's is 0.13 with bare
feet, and simple figures' less."""


def with_ground(skeleton: Skeleton, bind_positions: np.ndarray) -> Skeleton:
    """Returns the skeleton with the resting heights of its feet, and with ends of shins that have no foot.

    Args:
        skeleton: J joints, whose zero pose is the bind pose.
        bind_positions: [J, 3] metres above the ground in the bind pose.
    """
    body = skeleton.humanoid
    if body is None:
        return skeleton
    heights, ends = [], []
    for side in SIDES:
        thigh, shin, foot, toe = limb(body, side, "thigh", "shin", "foot", "toe")
        if foot is None:
            height = ANKLE_SHARE * bind_positions[shin, 1]
            ends.append((shin, _end_of_shin(bind_positions[thigh], bind_positions[shin], height)))
            heights.append([height, height])
        else:
            heights.append([bind_positions[foot, 1], bind_positions[foot if toe is None else toe, 1]])
    kept = tuple(site for site in skeleton.end_sites if site[0] not in {joint for joint, _ in ends})
    return replace(skeleton, end_sites=(*kept, *ends), resting_heights=np.array(heights))


def _end_of_shin(hip: np.ndarray, knee: np.ndarray, height: float) -> np.ndarray:
    """Returns the vector [3] from the knee to an ankle at a height: the shin goes on as the thigh comes."""
    thigh = knee - hip
    down = min(float(thigh[1]), -1e-6)
    return thigh * (height - knee[1]) / down
