"""Confirms a humanoid map by geometry: lengths, sides, order, and whether the body is a human one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.humanoid.map import SIDES
from pfnn_jax.motion.humanoid.measured import body_size
from pfnn_jax.motion.humanoid.names import JointName
from pfnn_jax.motion.humanoid.tree import JointTree

UNEQUAL = 0.15
"""Relative difference between the bones of left and right from which they are doubtful."""

SHORTEST_PART, LONGEST_PART = 0.4, 2.5
"""Ratio of upper to lower leg, and to lower arm, outside of which the joints are doubtful."""

BENT = 50.0
"""Degrees between the trunk and the legs' line from which a body does not stand upright in a pose."""

HANDS_AT_FEET = 0.65
"""Share of the legs' length below the hips from which hands are as low as feet: forefeet are."""

LIKE_A_LEG = 0.6
"""Share of a leg's reach from which another limb counts as a leg, if it ends as low as the feet."""

LOOSE_WORDS = ("skirt", "dress", "cloth", "coat", "cape", "hair", "tail", "string", "ribbon", "belt", "strap", "wing")
"""Words for joints of clothes and hair, which may hang as low as the feet."""

NO_LENGTH = 1e-3
"""Share of the body's size up to which a bone has no length."""

DOUBT = 0.8
"""Factor of the confidence for a doubt."""


@dataclass
class Finding:
    """What is decided while a map is found.

    Attributes:
        lines: one for each thing that was decided or is doubtful.
        confidence: in [0, 1].
    """

    lines: list[str] = field(default_factory=list)
    confidence: float = 1.0

    def decide(self, line: str, factor: float = 1.0) -> None:
        """Adds a line, and multiplies the confidence by a factor."""
        self.lines.append(line)
        self.confidence *= factor

    def doubt(self, line: str, factor: float = DOUBT) -> None:
        """Adds a doubt, and multiplies the confidence by a factor."""
        self.decide(f"doubtful: {line}", factor)


@dataclass(frozen=True)
class Body:
    """A map with the places of its joints.

    Attributes:
        found: bone -> joint.
        labels: [J] what the joints' names say.
        tree: of J joints.
        poses: [N, J, 3] positions, in any unit and with any axis up.
    """

    found: Mapping[str, Any]
    labels: Sequence[JointName]
    tree: JointTree
    poses: np.ndarray

    def length(self, one: str, other: str) -> float:
        """Returns the distance between the joints of two bones, 0 if either is missing."""
        first, second = self.found.get(one), self.found.get(other)
        if first is None or second is None:
            return 0.0
        return float(np.linalg.norm(self.poses[0, first] - self.poses[0, second]))

    def middle(self, *parts: str) -> np.ndarray | None:
        """Returns the middle [N, 3] of both sides' first part that the body has, or None."""
        for part in parts:
            joints = [self.found[f"{side}_{part}"] for side in SIDES]
            if None not in joints:
                return self.poses[:, joints].mean(axis=1)
        return None


def check_geometry(body: Body, finding: Finding, source: str | Path, *, rest: np.ndarray, insist: bool = False) -> None:
    """Adds what geometry doubts to a finding.

    Args:
        body: the map to check.
        finding: gets lines and factors of the confidence.
        source: file to name in messages.
        rest: [J, 3] positions with all rotations zero: who crawls in a clip may stand there.
        insist: whether a user named both thighs, so that a strange body is doubted only.

    Raises:
        InputError: if the body is not a human one.
    """
    if _is_point(body):
        finding.doubt("all joints of the legs are at one place, so geometry cannot confirm the names", 0.5)
        return
    _check_lengths(body, finding)
    _check_sides(body, finding)
    reasons = [reason for reason in (_on_all_fours(body), _many_legs(body)) if reason]
    if not reasons:
        return
    standing = replace(body, poses=rest[None])
    if insist or not (_is_point(standing) or _on_all_fours(standing) or _many_legs(standing)):
        finding.doubt(f"{' and '.join(reasons)}, as in an animal", 0.5)
        return
    rule = "this may not be a humanoid; if it is one, name left_thigh and right_thigh in a file of overrides (--roles)"
    raise InputError(source, "skeleton", " and ".join(reasons), rule)


def _is_point(body: Body) -> bool:
    """Returns whether the legs have no length, as where a file's positions are all zero."""
    return body.length("left_thigh", "left_shin") <= NO_LENGTH * body_size(body.poses[0])


def _check_lengths(body: Body, finding: Finding) -> None:
    """Doubts limbs whose sides differ in length, or whose upper and lower bones do not belong to one limb."""
    for what, upper, lower, end in (("legs", "thigh", "shin", "foot"), ("arms", "upper_arm", "lower_arm", "hand")):
        sides = [
            (body.length(f"{side}_{upper}", f"{side}_{lower}"), body.length(f"{side}_{lower}", f"{side}_{end}"))
            for side in SIDES
        ]
        total = [sum(bones) for bones in sides]
        if abs(total[0] - total[1]) > UNEQUAL * max(total):
            finding.doubt(f"left and right {what} differ in length: {total[0]:.3g} and {total[1]:.3g} units")
        first, second = sides[0]
        if first and second and not SHORTEST_PART <= first / second <= LONGEST_PART:
            finding.doubt(f"the bones of the {what} are {first:.3g} and {second:.3g} units long")


def _check_sides(body: Body, finding: Finding) -> None:
    """Doubts sides that the direction of the toes contradicts."""
    hips, feet, toes = body.middle("thigh"), body.middle("foot"), body.middle("toe")
    if feet is None or toes is None or hips is None:
        if toes is None:
            finding.decide("without toes the facing cannot confirm left and right", 0.95)
        return
    up, forward = hips - feet, toes - feet
    across = body.poses[:, body.found["left_thigh"]] - body.poses[:, body.found["right_thigh"]]
    left = np.einsum("nc,nc->n", np.cross(up, forward), across)
    if np.median(left) < 0:
        finding.doubt("the toes point to where the left leg is the right one", 0.5)


def _on_all_fours(body: Body) -> str:
    """Returns why the body goes on four legs, or an empty text: its trunk lies, with hands as low as feet."""
    hips, shoulders = body.middle("thigh"), body.middle("upper_arm")
    feet, hands = body.middle("foot", "shin"), body.middle("hand", "lower_arm")
    if shoulders is None or feet is None or hands is None or hips is None:
        return ""
    legs, trunk = hips - feet, shoulders - hips
    length = np.linalg.norm(legs, axis=1)
    cosine = np.einsum("nc,nc->n", legs, trunk) / np.maximum(length * np.linalg.norm(trunk, axis=1), 1e-9)
    bent = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    depth = np.einsum("nc,nc->n", legs, hips - hands) / np.maximum(length, 1e-9) ** 2
    if bent.min() > BENT and depth.min() > HANDS_AT_FEET:
        return f"the trunk lies at {bent.min():.0f}° to the legs and the hands are as low as the feet"
    return ""


def _many_legs(body: Body) -> str:
    """Returns how many more limbs than two reach as low as the feet, or an empty text if at most one does."""
    hips, feet = body.middle("thigh"), body.middle("foot", "shin")
    if hips is None or feet is None:
        return ""
    tree, pose = body.tree, body.poses[0]
    down = feet[0] - hips[0]
    length = float(np.linalg.norm(down))
    mapped = {joint for joint in body.found.values() if isinstance(joint, int)}
    inner = set(tree.parents)
    more: set[int] = set()
    for tip in range(len(tree.parents)):
        if tip in inner or body.labels[tip].helper or (pose[tip] - hips[0]) @ down < (1 - UNEQUAL) * length**2:
            continue
        limb = _own_limb(body, tip, mapped)
        if limb and _reach(pose, limb) >= LIKE_A_LEG * length:
            more.add(limb[0])
    if len(more) < 2:
        return ""
    return f"{len(more)} more limbs reach as low as the feet"


def _own_limb(body: Body, tip: int, mapped: set[int]) -> list[int]:
    """Returns the joints from the body's nearest part to a tip, outwards; empty for legs, clothes and controls."""
    above = body.tree.above(tip)
    at = next((i for i, joint in enumerate(above) if joint in mapped or joint in body.found["spine"]), None)
    if at is None or at == 0:
        return []
    part = above[at]
    legs = {body.found[f"{side}_{name}"] for side in SIDES for name in ("thigh", "shin", "foot", "toe")}
    limb = list(above[:at][::-1])
    loose = any(any(word in body.labels[joint].part for word in LOOSE_WORDS) for joint in limb)
    return [] if part in legs or loose or any(body.labels[joint].helper for joint in limb) else limb


def _reach(pose: np.ndarray, limb: list[int]) -> float:
    """Returns the length of a chain of joints; 0 unless it has at least two bones."""
    return float(np.linalg.norm(np.diff(pose[limb], axis=0), axis=1).sum()) if len(limb) > 2 else 0.0
