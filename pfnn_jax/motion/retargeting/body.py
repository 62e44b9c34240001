"""The parts of a human body in a skeleton: the joint that turns each, and where its bone points in a T pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.roles import rest_pose
from pfnn_jax.motion.skeleton import Skeleton

UP, FORWARD = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
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


def torso_chain(body: HumanoidMap) -> tuple[int, ...]:
    """Returns the joints from the hips to the chest, the last joint below neck and arms."""
    return (body.hips, *body.spine)


def neck_chain(body: HumanoidMap) -> tuple[int, ...]:
    """Returns the joints of neck and head."""
    return (*body.neck, *(() if body.head is None else (body.head,)))


def limb(body: HumanoidMap, side: str, *names: str) -> tuple[Any, ...]:
    """Returns the joints of these parts of one side: an index each, or None where the skeleton has none."""
    return tuple(getattr(body, f"{side}_{name}") for name in names)


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
        clavicle, *arm = limb(body, side, "clavicle", "upper_arm", "lower_arm", "hand")
        chain = [joint for joint in (clavicle, *arm) if joint is not None]
        names = ["clavicle"] * (clavicle is not None) + ["upper_arm", "lower_arm", "hand"]
        yield from _chain(side, names, chain, torso_chain(body)[-1], [outward] * 4)
        leg = [joint for joint in limb(body, side, "thigh", "shin", "foot", "toe") if joint is not None]
        yield from _chain(side, ["thigh", "shin", "foot", "toe"], leg, body.hips, [-UP, -UP, FORWARD, FORWARD])


def _chain(side: str, names: list[str], joints: list[int], above: int, directions: list[np.ndarray]) -> Iterator[Part]:
    for number, joint in enumerate(joints):
        below = joints[number + 1] if number + 1 < len(joints) else None
        yield Part(f"{side}_{names[number]}", joint, joints[number - 1] if number else above, below, directions[number])


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


def leg_length_of(skeleton: Skeleton, body: HumanoidMap) -> float:
    """Returns the length from hip over knee to ankle in metres, the mean of both legs."""
    rest = rest_pose(skeleton)
    legs = [rest[list(limb(body, side, "thigh", "shin", "foot"))] for side in SIDES]
    return float(np.mean([np.linalg.norm(np.diff(leg, axis=0), axis=-1).sum() for leg in legs]))
