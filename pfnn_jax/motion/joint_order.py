"""Gives a clip the joint order and names of a skeleton that has the same joints: exporters order them differently."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.hands import move_roles
from pfnn_jax.motion.skeleton import Skeleton, plain_names


def match_joints(clip: MotionClip, names: tuple[str, ...]) -> MotionClip:
    """Returns the clip with its joints named and ordered as `names`.

    A clip with other joints (by `plain_names`) is returned unchanged, and so is one in which a joint would come before
    its parent.

    Args:
        clip: of J joints.
        names: [J] of the wanted skeleton.
    """
    skeleton = clip.skeleton
    if skeleton.names == names:
        return clip
    own, wanted = plain_names(skeleton.names), plain_names(names)
    if sorted(own) != sorted(wanted) or len(set(own)) < len(own):
        return clip
    order = np.array([own.index(name) for name in wanted])  # old index of every new joint
    place = np.argsort(order)
    parents = skeleton.parents[order]
    parents = np.where(parents >= 0, place[parents], -1)
    if (parents >= np.arange(len(order))).any():
        return clip
    return replace(clip, skeleton=_reordered(skeleton, names, parents, order), rotations=clip.rotations[:, order])


def _reordered(skeleton: Skeleton, names: tuple[str, ...], parents: np.ndarray, order: np.ndarray) -> Skeleton:
    place = np.argsort(order)
    return replace(
        skeleton,
        names=names,
        parents=parents,
        offsets=skeleton.offsets[order],
        end_sites=tuple((int(place[joint]), site) for joint, site in skeleton.end_sites),
        mirror=place[skeleton.mirror[order]],
        roles=None if skeleton.roles is None else move_roles(skeleton.roles, place),
        humanoid=None if skeleton.humanoid is None else skeleton.humanoid.move(lambda joint: int(place[joint])),
        poses=None if skeleton.poses is None else skeleton.poses[:, order],
        reference=None if skeleton.reference is None else skeleton.reference[order],
    )
