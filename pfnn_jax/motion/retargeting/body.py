"""The parts of a human body in a skeleton: the joint that turns each, and where its bone points in a T pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.humanoid.find import need_humanoid
from pfnn_jax.motion.humanoid.map import ARM, LEG, HumanoidMap
from pfnn_jax.motion.roles import chain_up
from pfnn_jax.motion.skeleton import Skeleton, rest_pose

LEFT, UP, FORWARD = np.eye(3)
"""Axes of the reference pose."""
SIDES = {"left": 1.0, "right": -1.0}
"""Sign of x of each side in a T pose that faces +Z."""

MIN_LENGTH = 1e-4
"""Share of the leg length below which a bone has no direction."""


@dataclass(frozen=True)
class Part:
    """A part of the body and the joint that turns it.

    Attributes:
        name: such as `spine`, `left_thigh`.
        joint: index.
        above: joint of the part that carries it; -1 for the hips.
        below: joint at the far end of its bone, None if the map names none.
        direction: [3] of its bone in a T pose that faces +Z.
    """

    name: str
    joint: int
    above: int
    below: int | None
    direction: np.ndarray


def humanoid_of(skeleton: Skeleton, source: str | Path = "skeleton") -> HumanoidMap:
    """Returns the humanoid map of a skeleton, found by names and rest geometry if none is stored in it.

    Args:
        skeleton: the joints.
        source: file to name in messages.

    Raises:
        InputError: if it has none, no ankles, or feet that do not descend from their legs.
    """
    body = need_humanoid(skeleton, source)
    for side in SIDES:
        shin, foot = limb(body, side, "shin", "foot")
        if foot is None or shin not in chain_up(skeleton.parents, foot):
            found = f"{side} leg {skeleton.names[shin]}"
            rule = "must have an ankle below the knee, or name it in a file of overrides (--roles)"
            raise InputError(source, "skeleton", found, rule)
    return body


def torso_chain(body: HumanoidMap) -> tuple[int, ...]:
    """Returns the joints from the hips to the chest, the last joint below neck and arms."""
    return (body.hips, *body.spine)


def neck_chain(body: HumanoidMap) -> tuple[int, ...]:
    """Returns the joints of neck and head."""
    return (*body.neck, *(() if body.head is None else (body.head,)))


def limb(body: HumanoidMap, side: str, *names: str) -> tuple[Any, ...]:
    """Returns the joints of these parts of one side: an index each, or None where the skeleton has none."""
    return body.limb(side, names)


def parts_of(body: HumanoidMap) -> Iterator[Part]:
    """Yields the parts of a body, each after the part that carries it."""
    trunk = (*torso_chain(body), *neck_chain(body))
    for number, joint in enumerate(trunk):
        name = "hips" if not number else "spine" if number <= len(body.spine) else "neck"
        name = "head" if joint == body.head else name
        below = trunk[number + 1] if number + 1 < len(trunk) else None
        yield Part(name, joint, trunk[number - 1] if number else -1, below, UP)
    for side, sign in SIDES.items():
        outward = np.array([sign, 0.0, 0.0])
        yield from _limb_parts(body, side, ARM, torso_chain(body)[-1], [outward] * 4)
        yield from _limb_parts(body, side, LEG, body.hips, [-UP, -UP, FORWARD, FORWARD])


def body_joints(body: HumanoidMap) -> list[int]:
    """Returns the joints that turn the parts of a body, in the skeleton's order."""
    return sorted({part.joint for part in parts_of(body)})


def _limb_parts(
    body: HumanoidMap, side: str, names: tuple[str, ...], above: int, directions: list[np.ndarray]
) -> Iterator[Part]:
    """Yields those parts of an arm or leg that the skeleton has, from the body outwards."""
    rows = zip(names, directions, body.limb(side, names), strict=True)
    chain = [(name, direction, joint) for name, direction, joint in rows if joint is not None]
    for number, (name, direction, joint) in enumerate(chain):
        below = chain[number + 1][2] if number + 1 < len(chain) else None
        yield Part(f"{side}_{name}", joint, above, below, direction)
        above = joint


def bone_of(skeleton: Skeleton, part: Part) -> np.ndarray:
    """Returns the bone [3] of a part in its joint's own frame, in metres; zero if it has none.

    Joints between both ends are taken at rest. A part without a joint below ends at the mean of its children and End
    Sites.
    """
    rest = rest_pose(skeleton)
    if part.below is not None:
        return rest[part.below] - rest[part.joint]
    tips = [site for joint, site in skeleton.end_sites if joint == part.joint]
    tips += list(skeleton.offsets[skeleton.parents == part.joint])
    return np.mean(tips, axis=0) if tips else np.zeros(3)
