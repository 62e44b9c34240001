"""Confirms a humanoid map by geometry: lengths, sides, order, and whether the body is a human one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
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

LYING = (50.0, 130.0)
"""Degrees between the trunk and the line of the legs within which a body may stand on four legs. Above, the pose is not
that of a body: bones lie along one axis of their joints."""

UPRIGHT = 0.5
"""Cosine of the angle to the vertical up to which legs and trunk stand."""

HANDS_AT_FEET = 0.65
"""Share of the legs' length below the hips from which hands are as low as feet: forefeet are."""

LIKE_A_LEG = 0.6
"""Share of a leg's reach from which another limb counts as a leg, if it ends as low as the feet."""

CONTROL = 0.1
"""Share of a leg's length from a joint of the body within which a chain ends that is a control of that joint."""

LOOSE_WORDS = ("skirt", "dress", "cloth", "coat", "cape", "hair", "tail", "string", "ribbon", "belt", "strap", "wing")
"""Words for joints of clothes and hair, which may hang as low as the feet."""

NO_LENGTH = 1e-3
"""Share of the body's size up to which a bone has no length."""

DOUBT = 0.8
"""Factor of the confidence for a doubt."""

NO_POSE = 0.5
"""Factor of the confidence where geometry cannot confirm the map, as the pose is that of no body."""

DOUBTFUL = "doubtful: "
"""Beginning of the lines that say what is doubtful."""


@dataclass
class Finding:
    """What is decided while a map is found.

    Attributes:
        lines: one for each thing that was decided or is doubtful.
        confidence: in [0, 1].
    """

    lines: list[str] = field(default_factory=list)
    confidence: float = 1.0

    @property
    def doubtful(self) -> bool:
        """Whether anything is doubtful."""
        return any(line.startswith(DOUBTFUL) for line in self.lines)

    def decide(self, line: str, factor: float = 1.0) -> None:
        """Adds a line, and multiplies the confidence by a factor."""
        self.lines.append(line)
        self.confidence *= factor

    def doubt(self, line: str, factor: float = DOUBT) -> None:
        """Adds a doubt, and multiplies the confidence by a factor."""
        self.decide(f"{DOUBTFUL}{line}", factor)


@dataclass(frozen=True)
class Body:
    """A map with the places of its joints.

    Attributes:
        found: bone -> joint.
        labels: [J] what the joints' names say.
        tree: of J joints.
        poses: [N, J, 3] positions, in any unit and with any axis up.
        by_geometry: whether the legs were found without names.
    """

    found: Mapping[str, Any]
    labels: Sequence[JointName]
    tree: JointTree
    poses: np.ndarray
    by_geometry: bool = False

    def trunk(self) -> np.ndarray | None:
        """Returns the vector [N, 3] from the hips to the end of the spine, or the first joint above it; else None."""
        above = [*self.found["spine"][::-1], *self.found["neck"], self.found["head"]]
        hips = self.poses[:, self.found["hips"]]
        vectors = (self.poses[:, joint] - hips for joint in above if joint is not None)
        least = NO_LENGTH * body_size(self.poses[0])
        return next((vector for vector in vectors if np.linalg.norm(vector[0]) > least), None)

    def middle(self, *parts: str) -> np.ndarray | None:
        """Returns the middle [N, 3] of both sides' first part that the body has, or None."""
        for part in parts:
            left, right = (self.found[f"{side}_{part}"] for side in SIDES)
            if left is not None and right is not None:
                return (self.poses[:, left] + self.poses[:, right]) / 2
        return None


def check_geometry(body: Body, finding: Finding, source: str | Path, *, insist: bool = False) -> None:
    """Adds what geometry doubts to a finding.

    Args:
        body: the map to check.
        finding: gets lines and factors of the confidence.
        source: file to name in messages.
        insist: whether a user named both thighs, so that a strange body is doubted only.

    Raises:
        InputError: if the body is not a human one.
    """
    if is_no_pose(body.found, body.poses):
        finding.doubt("the pose is not that of a body, so geometry cannot confirm the names", NO_POSE)
        return
    _check_lengths(body, finding)
    _check_sides(body, finding)
    reasons = [reason for reason in (_on_all_fours(body), _many_legs(body)) if reason]
    if reasons and insist:
        finding.doubt(f"{' and '.join(reasons)}, as in an animal", 0.5)
    elif reasons:
        rule = "this may not be a humanoid; if it is, name left_thigh and right_thigh in a file of overrides (--roles)"
        raise InputError(source, "skeleton", " and ".join(reasons), rule)


def stands(body: Body) -> bool:
    """Returns whether legs and trunk of a body are upright, with Y up, in half of its poses."""
    hips, feet, trunk = body.middle("thigh"), body.middle("foot", "shin"), body.trunk()
    if hips is None or feet is None:
        return False
    upright = [_rise(hips - feet), *([] if trunk is None else [_rise(trunk)])]
    return min(np.median(rise) for rise in upright) > UPRIGHT


def _rise(vectors: np.ndarray) -> np.ndarray:
    """Returns the share [N] of vectors [N, 3] that goes up."""
    return vectors[:, 1] / np.maximum(np.linalg.norm(vectors, axis=1), 1e-9)


def is_no_pose(limbs: Mapping[str, Any], poses: np.ndarray) -> bool:
    """Returns whether the legs have no length, or point away from each other.

    So they do where a file's positions are all zero, and where bones lie along one axis of their joints.

    Args:
        limbs: bone -> joint, with thighs and shins.
        poses: [N, J, 3].
    """
    left, right = (poses[:, limbs[f"{side}_shin"]] - poses[:, limbs[f"{side}_thigh"]] for side in SIDES)
    size = np.linalg.norm(left, axis=1), np.linalg.norm(right, axis=1)
    if size[0][0] <= NO_LENGTH * body_size(poses[0]):
        return True
    return bool((np.einsum("nc,nc->n", left, right) < -0.5 * size[0] * size[1]).all())


def _check_lengths(body: Body, finding: Finding) -> None:
    """Doubts limbs whose sides differ in length, or whose upper and lower bones do not belong to one limb."""
    for what, parts in (("legs", ("thigh", "shin", "foot")), ("arms", ("upper_arm", "lower_arm", "hand"))):
        left, right = ([body.found[f"{side}_{part}"] for part in parts] for side in SIDES)
        count = 3 - (left + right).count(None) // 2  # joints of each side
        if None in left[:count] or None in right[:count] or count < 2:
            continue
        chains = body.poses[0][[left[:count], right[:count]]]
        one, other = np.sqrt(((chains[:, 1:] - chains[:, :-1]) ** 2).sum(axis=2)).tolist()
        total = sum(one), sum(other)
        if abs(total[0] - total[1]) > UNEQUAL * max(total):
            finding.doubt(f"left and right {what} differ in length: {total[0]:.3g} and {total[1]:.3g} units")
        if count == 3 and one[1] and not SHORTEST_PART <= one[0] / one[1] <= LONGEST_PART:
            finding.doubt(f"the bones of the {what} are {one[0]:.3g} and {one[1]:.3g} units long")


def _check_sides(body: Body, finding: Finding) -> None:
    """Doubts sides that the direction of the toes contradicts."""
    hips, feet, toes = body.middle("thigh"), body.middle("foot"), body.middle("toe")
    if feet is None or toes is None or hips is None:
        if toes is None:
            finding.decide("without toes the facing cannot confirm left and right", 0.95)
        return
    up, forward = hips - feet, toes - feet
    across = body.poses[:, body.found["left_thigh"]] - body.poses[:, body.found["right_thigh"]]
    x, y, z = (across[:, axis] for axis in range(3))  # (up × forward) · across, in components as arrays are short
    left = x * (up[:, 1] * forward[:, 2] - up[:, 2] * forward[:, 1])
    left += y * (up[:, 2] * forward[:, 0] - up[:, 0] * forward[:, 2])
    left += z * (up[:, 0] * forward[:, 1] - up[:, 1] * forward[:, 0])
    if np.count_nonzero(left < 0) > len(left) / 2:
        finding.doubt("the toes point to where the left leg is the right one", 0.5)


def _on_all_fours(body: Body) -> str:
    """Returns why the body goes on four legs, or an empty text: its trunk lies, with hands as low as feet."""
    hips, trunk = body.middle("thigh"), body.trunk()
    feet, hands = body.middle("foot", "shin"), body.middle("hand", "lower_arm")
    if trunk is None or feet is None or hands is None or hips is None:
        return ""
    legs = hips - feet
    size = np.maximum(np.einsum("nc,nc->n", legs, legs), 1e-18)
    if (np.einsum("nc,nc->n", legs, hips - hands) / size).min() <= HANDS_AT_FEET:
        return ""
    cosine = np.einsum("nc,nc->n", legs, trunk) / np.maximum(np.sqrt(size) * np.linalg.norm(trunk, axis=1), 1e-9)
    lying = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).min())
    if not LYING[0] < lying < LYING[1]:
        return ""
    return f"the trunk lies at {lying:.0f}° to the legs and the hands are as low as the feet"


def _many_legs(body: Body) -> str:
    """Returns why the body has too many legs, or an empty text.

    Two more limbs that reach as low as the feet are too many or, where no names tell arms from legs, three anywhere.
    """
    hips, feet = body.middle("thigh"), body.middle("foot", "shin")
    if hips is None or feet is None:
        return ""
    pose, down = body.poses[0], feet[0] - hips[0]
    length = float(np.linalg.norm(down))
    inner = set(body.tree.parents)
    tips = np.array([joint for joint in range(len(body.tree.parents)) if joint not in inner])
    low = (pose[tips] - hips[0]) @ down >= (1 - UNEQUAL) * length**2
    mapped = {joint for joint in body.found.values() if isinstance(joint, int)}
    more: dict[int, bool] = {}  # first joint of a limb -> whether it reaches as low as the feet
    for tip, is_low in zip(tips.tolist(), low.tolist(), strict=True):
        if not (is_low or body.by_geometry):
            continue
        limb = _own_limb(body, tip, mapped)
        beside = np.linalg.norm(pose[list(mapped)] - pose[tip], axis=1).min() < CONTROL * length
        if limb and not beside and _reach(pose, limb) >= LIKE_A_LEG * length:
            more[limb[0]] = more.get(limb[0], False) or is_low
    if sum(more.values()) >= 2:
        return f"{sum(more.values())} more limbs reach as low as the feet"
    return f"there are {len(more)} more limbs as long as legs" if body.by_geometry and len(more) >= 3 else ""


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
