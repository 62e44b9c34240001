"""Blends two motions of one skeleton joint by joint: by how much, and in which parts of the body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.humanoid.map import ARM, LEG, SIDES
from pfnn_jax.motion.kinematics import quat_align, quat_conjugate, quat_exp, quat_multiply
from pfnn_jax.motion.retargeting.body import humanoid_of
from pfnn_jax.motion.roles import chain_up
from pfnn_jax.motion.skeleton import Skeleton

Parts = Literal["all", "upper", "lower", "arms"]
PARTS: tuple[Parts, ...] = get_args(Parts)
"""Parts of a body that can be blended; upper and lower are all of it."""

MOST_TURN = np.deg2rad(135.0)
"""Half of the angle (270 degrees) between two rotations from which on less than their share of it is turned."""


def blend_clips(content: MotionClip, result: MotionClip, weights: np.ndarray, root_weight: float) -> MotionClip:
    """Returns the content with the rotations of each joint moved towards those of a result.

    At weight 0 a joint keeps the content's rotation, at 1 it takes the result's, both to the last bit. Between them and
    beyond 1 the rotation from one to the other is scaled: the shorter way round where both are nearest, and without a
    jump from frame to frame in the others, also where that is more than half a turn (`limit_turns` near a whole one).

    Args:
        content: T frames on J joints.
        result: T frames on the same skeleton.
        weights: [J], at least 0.
        root_weight: of the position of joint 0, which is interpolated linearly.

    Raises:
        ValueError: if the shapes of the clips or weights differ.
    """
    if content.rotations.shape != result.rotations.shape or weights.shape != content.rotations.shape[1:2]:
        found = f"{content.rotations.shape}, {result.rotations.shape} and {weights.shape}"
        raise ValueError(f"Both clips must have rotations [T, J, 4] and weights be [J], got {found}.")
    rotations, positions = content.rotations.copy(), content.root_positions
    rotations[:, weights == 1.0] = result.rotations[:, weights == 1.0]
    partly = np.flatnonzero((weights != 0.0) & (weights != 1.0))
    if len(partly):
        between = continuous_turns(content.rotations[:, partly], result.rotations[:, partly])
        near = weights[partly, None] >= 0.5
        first = np.where(near, result.rotations[:, partly], rotations[:, partly])
        rotations[:, partly] = quat_multiply(first, quat_exp((weights[partly, None] - near) * limit_turns(between)))
    if root_weight == 1.0:
        positions = result.root_positions
    elif root_weight != 0.0:
        positions = positions + root_weight * (result.root_positions - positions)
    return replace(content, root_positions=positions, rotations=rotations)


def continuous_turns(rotations: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Returns half-angle vectors [T, J, 3] of the rotations from some [T, J, 4] to others, continuous over time.

    The shorter way round changes sides where the angle passes half a turn, and a part of it would jump there.
    """
    between = quat_align(quat_multiply(quat_conjugate(rotations), others))
    nearest = np.abs(between[..., 0]).argmax(axis=0)
    between = np.where(between[nearest, np.arange(between.shape[1]), :1] < 0, -between, between)
    sine = np.linalg.norm(between[..., 1:], axis=-1, keepdims=True)
    return between[..., 1:] * np.where(
        sine > 0, np.arctan2(sine, between[..., :1]) / np.where(sine > 0, sine, 1.0), 1.0
    )


def check_parts(parts: str, source: str | Path) -> None:
    """Checks the name of parts of the body.

    Raises:
        InputError: unless it is one of `PARTS`, naming `source`.
    """
    if parts not in PARTS:
        raise InputError(source, "parts", parts, f"must be one of {', '.join(PARTS)}")


def limit_turns(turns: np.ndarray) -> np.ndarray:
    """Returns half-angle vectors [..., 3] that beyond `MOST_TURN` are reduced, to reach 0 at a whole turn.

    There both rotations are the same, the axis between them is any, and a part of a whole turn about it would jump.
    """
    half = np.linalg.norm(turns, axis=-1, keepdims=True)
    limited = np.clip(MOST_TURN * (np.pi - half) / (np.pi - MOST_TURN), 0.0, half)
    return turns * np.where(half > MOST_TURN, limited / np.where(half > 0, half, 1.0), 1.0)


def part_weights(skeleton: Skeleton, parts: Parts, source: str | Path = "skeleton") -> tuple[np.ndarray, float]:
    """Returns which joints belong to parts of the body, and whether the root's path does.

    Pelvis, legs and the root's path are `lower`; spine, neck, head and arms with their clavicles `upper`. A joint of no
    part, such as a twist joint, belongs to the part below it; one with nothing below it, such as a finger, to none.

    Args:
        skeleton: J joints with a humanoid map.
        parts: one of `PARTS`.
        source: file to name in messages.

    Returns:
        Weights [J] of 0 and 1, and 0 or 1 for the root's path.

    Raises:
        InputError: if `parts` is unknown, or the skeleton has no humanoid map.
    """
    check_parts(parts, source)
    body = humanoid_of(skeleton, source)
    arms = [joint for side in SIDES for joint in body.limb(side, ARM) if joint is not None]
    legs = [joint for side in SIDES for joint in body.limb(side, LEG) if joint is not None]
    trunk = [*body.spine, *body.neck, *([] if body.head is None else [body.head])]
    part = np.zeros(skeleton.num_joints, dtype=int)  # 0 none, 1 arms, 2 trunk, 3 legs and pelvis
    for number, joints in enumerate((arms, trunk, [*legs, body.hips]), start=1):
        for joint in joints:
            chain = chain_up(skeleton.parents, joint)
            part[[above for above in chain if part[above] < number]] = number
    chosen = {"all": part > 0, "upper": (part == 1) | (part == 2), "lower": part == 3, "arms": part == 1}[parts]
    return chosen.astype(float), float(parts in ("all", "lower"))
