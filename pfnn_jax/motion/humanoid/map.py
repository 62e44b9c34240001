"""The humanoid map: which joint of a skeleton plays which part of a human body."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from pfnn_jax.errors import InputError

CHAINS = ("spine", "neck")
"""Bones of the map that consist of any number of joints, from the hips upwards."""

LEG = ("thigh", "shin", "foot", "toe")
ARM = ("clavicle", "upper_arm", "lower_arm", "hand")
"""Parts of a limb, from the body outwards."""

SIDES = ("left", "right")


@dataclass(frozen=True)
class HumanoidMap:
    """Which joint of a skeleton plays which part of a human body.

    A limb that the skeleton does not have is None in all its parts: a capture of legs and trunk has no arms. Twist,
    helper, control and leaf joints are in no part.

    Attributes:
        hips: joint from which both legs and the spine descend.
        spine: joints between hips and neck (or head), from the hips upwards; may be empty.
        neck: joints between the last spine joint and the head; may be empty.
        head: head joint, or None.
        left_clavicle, right_clavicle: joint between the spine and the upper arm, or None.
        left_upper_arm, right_upper_arm, left_lower_arm, right_lower_arm: None only where the skeleton has no arms.
        left_hand, right_hand: wrist joint, or None.
        left_thigh, left_shin, right_thigh, right_shin: upper and lower leg.
        left_foot, right_foot: ankle joint, or None where the leg ends with the shin.
        left_toe, right_toe: joint of the toes, or None.
        confidence: in [0, 1]: 1 where names and geometry agree on everything.
        explanation: one line for each thing that was decided or is doubtful.
    """

    hips: int
    spine: tuple[int, ...]
    neck: tuple[int, ...]
    head: int | None
    left_clavicle: int | None
    left_upper_arm: int | None
    left_lower_arm: int | None
    left_hand: int | None
    right_clavicle: int | None
    right_upper_arm: int | None
    right_lower_arm: int | None
    right_hand: int | None
    left_thigh: int
    left_shin: int
    left_foot: int | None
    left_toe: int | None
    right_thigh: int
    right_shin: int
    right_foot: int | None
    right_toe: int | None
    confidence: float = 1.0
    explanation: tuple[str, ...] = ()

    def joints(self) -> dict[str, int | tuple[int, ...] | None]:
        """Returns bone -> joint, or joints for spine and neck, without confidence and explanation."""
        return {bone: getattr(self, bone) for bone in BONES}

    def names(self, names: tuple[str, ...]) -> dict[str, str | list[str] | None]:
        """Returns bone -> joint name, or list of names for spine and neck, as a file of overrides has them.

        Args:
            names: of the skeleton's joints.
        """
        return {
            bone: [names[j] for j in joint] if isinstance(joint, tuple) else None if joint is None else names[joint]
            for bone, joint in self.joints().items()
        }

    def limb(self, side: str, parts: tuple[str, ...]) -> tuple[int | None, ...]:
        """Returns the joints of a limb, from the body outwards.

        Args:
            side: `left` or `right`.
            parts: `LEG` or `ARM`.
        """
        return tuple(getattr(self, f"{side}_{part}") for part in parts)

    def move(self, place: Callable[[int], int]) -> HumanoidMap:
        """Returns the map with each joint replaced by `place(joint)`, its index in another skeleton."""
        moved: dict[str, Any] = {
            bone: tuple(place(j) for j in joint)
            if isinstance(joint, tuple)
            else None
            if joint is None
            else place(joint)
            for bone, joint in self.joints().items()
        }
        return replace(self, **moved)


BONES = tuple(field.name for field in fields(HumanoidMap) if field.name not in ("confidence", "explanation"))
"""Names of the bones of a map, as attributes of `HumanoidMap`."""

KEYS = frozenset((*BONES, "confidence", "explanation"))


def map_to_json(humanoid: HumanoidMap) -> dict[str, Any]:
    """Returns a map as JSON data."""
    joints = {bone: list(joint) if isinstance(joint, tuple) else joint for bone, joint in humanoid.joints().items()}
    return {**joints, "confidence": humanoid.confidence, "explanation": list(humanoid.explanation)}


def map_from_json(data: Mapping[str, Any], source: str | Path = "skeleton") -> HumanoidMap:
    """Returns the map that `map_to_json` described.

    Args:
        data: as `map_to_json` returns it.
        source: file it was read from, for messages.

    Raises:
        InputError: if a bone is missing.
    """
    missing = [bone for bone in BONES if bone not in data]
    if missing:
        rule = "must have all bones of a humanoid map"
        raise InputError(source, "skeleton.humanoid", f"no {', '.join(missing)}", rule)
    joints: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in data.items() if key in KEYS
    }
    return HumanoidMap(**joints)
