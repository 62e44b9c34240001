"""The skeleton of procedural walkers: 21 joints with the proportions of a person 1.73 m tall."""

from __future__ import annotations

import numpy as np

from pfnn_jax.motion.roles import assign_roles
from pfnn_jax.motion.skeleton import Skeleton

THIGH, SHIN = 0.42, 0.41
"""Lengths of the upper and lower leg in metres."""
ANKLE_HEIGHT = 0.085
"""Height of the ankle joint above the sole in metres."""
TOE_HEIGHT = ANKLE_HEIGHT - 0.065
"""Height of the toe joint above the sole in metres."""

# One row per joint of the midline and of the left side: name, parent, offset in metres. The rest pose is a T pose.
_MIDLINE = (
    ("Hips", "", (0.0, 0.0, 0.0)),
    ("Spine", "Hips", (0.0, 0.09, -0.01)),
    ("Spine1", "Spine", (0.0, 0.17, -0.01)),
    ("Neck", "Spine1", (0.0, 0.25, 0.015)),
    ("Head", "Neck", (0.0, 0.09, 0.02)),
)
_ARM = (
    ("Shoulder", "Spine1", (0.045, 0.18, 0.01)),
    ("Arm", "Shoulder", (0.135, 0.0, -0.01)),
    ("ForeArm", "Arm", (0.28, 0.0, 0.0)),
    ("Hand", "ForeArm", (0.25, 0.0, 0.0)),
)
_LEG = (
    ("UpLeg", "Hips", (0.095, -0.03, 0.0)),
    ("Leg", "UpLeg", (0.0, -THIGH, 0.0)),
    ("Foot", "Leg", (0.0, -SHIN, 0.0)),
    ("ToeBase", "Foot", (0.0, -0.065, 0.14)),
)
_END_SITES = {"Head": (0.0, 0.19, 0.01), "Hand": (0.16, 0.0, 0.0), "ToeBase": (0.0, -0.005, 0.07)}
_FLIP = np.array([-1.0, 1.0, 1.0])


def _rows() -> list[tuple[str, str, np.ndarray]]:
    sided = {row[0] for row in _ARM + _LEG}
    rows = [(name, parent, np.array(offset)) for name, parent, offset in _MIDLINE]
    sides = (("Left", np.ones(3)), ("Right", _FLIP))
    for limb, (side, flip) in ((limb, side) for limb in (_ARM, _LEG) for side in sides):
        for name, parent, offset in limb:
            parent = side + parent if parent in sided else parent
            rows.append((side + name, parent, np.array(offset) * flip))
    return _depth_first(rows, "")


def _depth_first(rows: list[tuple[str, str, np.ndarray]], parent: str) -> list[tuple[str, str, np.ndarray]]:
    """Sorts joints into the order of a BVH file, so that a clip has the same skeleton after writing and reading."""
    return [found for row in rows if row[1] == parent for found in (row, *_depth_first(rows, row[0]))]


def _end_sites(names: tuple[str, ...]) -> tuple[tuple[int, np.ndarray], ...]:
    sites = []
    for joint, name in enumerate(names):
        part = name.removeprefix("Left").removeprefix("Right")
        if part in _END_SITES:
            sites.append((joint, np.array(_END_SITES[part]) * (_FLIP if name.startswith("Right") else 1.0)))
    return tuple(sites)


def synthetic_skeleton() -> Skeleton:
    """Returns the skeleton of every procedural walker.

    Returns:
        Skeleton of 21 joints in a T pose that faces +Z, with left at +X, with humanoid map, roles and mirror.
    """
    rows = _rows()
    names = tuple(row[0] for row in rows)
    index = {name: joint for joint, name in enumerate(names)}
    skeleton = Skeleton(
        names=names,
        parents=np.array([index.get(row[1], -1) for row in rows]),
        offsets=np.stack([row[2] for row in rows]),
        end_sites=_end_sites(names),
        mirror=np.arange(len(names)),
        resting_heights=np.array([[ANKLE_HEIGHT, TOE_HEIGHT]] * 2),
    )
    return assign_roles(skeleton, source="procedural walker")
