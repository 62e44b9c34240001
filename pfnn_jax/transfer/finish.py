"""Turns the rows of a result into a clip on the content's own skeleton, blended with the content, with planted feet."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pfnn_jax.errors import InputError
from pfnn_jax.motion.blending import Parts, blend_clips, part_weights
from pfnn_jax.motion.body_points import find_body_points
from pfnn_jax.motion.clip import MotionClip
from pfnn_jax.motion.filters import gaussian_filter
from pfnn_jax.motion.humanoid.describe import leg_length_of
from pfnn_jax.motion.humanoid.map import HumanoidMap
from pfnn_jax.motion.interpolation import interpolate, interpolate_rotations
from pfnn_jax.motion.joint_rotations import rotations_from_positions
from pfnn_jax.motion.kinematics import (
    forward_kinematics,
    quat_conjugate,
    quat_from_yaw,
    quat_multiply,
    quat_rotate,
)
from pfnn_jax.motion.labels.contacts import foot_contacts, foot_joints
from pfnn_jax.motion.planted_feet import plant_feet
from pfnn_jax.motion.retargeting.body import SIDES, humanoid_of, limb
from pfnn_jax.motion.retargeting.retarget import part_turns
from pfnn_jax.motion.skeleton import Roles, Skeleton
from pfnn_jax.motion.trajectory import Root
from pfnn_jax.transfer.clip_rows import clip_root, decode_rows, encode_clip, floor_height, prepare_clip
from pfnn_jax.transfer.layout import LAYOUT_FPS, ClipLayout

HELD_SPEED = 0.3
"""Leg lengths per second below which a foot of the content is held. Holding it for as long as contacts are labelled
would pull at legs that are straight when they leave the ground, and lower the hips by a centimetre."""

MAX_STRENGTH = 1.5
"""Largest strength: the difference between content and result is extrapolated by half."""

SMOOTH_SECONDS = (0.0, 1 / 30, 0.05, 0.0625, 0.08)
"""Standard deviations of the Gaussians that smooth what rows change, tried in turn. The last halves
2.3 Hz; more would take a quarter of what varies in a style and make its result hardly smoother."""

MAX_JITTER = 1.15
"""Mean jerk of a result over that of its content from which on its change is smoothed more."""


def finish_clip(
    rows: np.ndarray,
    content: MotionClip,
    skeleton: Skeleton,
    layout: ClipLayout,
    *,
    strength: float = 1.0,
    parts: Parts = "all",
    foot_ik: bool = True,
) -> MotionClip:
    """Returns the content with the motion of rows, on its own skeleton, at its own frame rate and with as many frames.

    What rows change on the run's skeleton is applied to the content's own rotations, so that what neither rows nor the
    run's skeleton show (fingers, twist, more joints) is kept, and rows of the content give back the content. Feet are
    then held where the content's are in contact.

    Args:
        rows: [T', D] in layout units, of the frames of `prepare_clip(content, skeleton)`; more frames are cut off.
        content: T frames of any humanoid.
        skeleton: of the run that the rows come from.
        layout: of the rows.
        strength: 0 is the content exactly, 1 the result; up to `MAX_STRENGTH`, the difference is extrapolated.
        parts: of the body that take the style.
        foot_ik: whether feet are held.

    Raises:
        InputError: if strength, parts or the number of rows are out of range, rows are not finite, or a skeleton has no
            roles.
    """
    source = content.source or "clip"
    check_strength(strength, source)
    weights, root_weight = part_weights(content.skeleton, parts, source)
    if strength == 0.0:
        return content
    result = smooth_result(rows, content, prepare_clip(content, skeleton), layout)
    blended = blend_clips(content, result, strength * weights, min(strength, 1.0) * root_weight)
    return hold_feet(blended, content) if foot_ik and root_weight else blended


def check_strength(strength: float, source: str | Path = "transfer") -> None:
    """Checks the strength of a transfer.

    Raises:
        InputError: unless it is from 0 to `MAX_STRENGTH`, naming `source`.
    """
    if not 0.0 <= strength <= MAX_STRENGTH:  # also where it is not a number
        raise InputError(source, "strength", strength, f"must be from 0 (the content) over 1 to {MAX_STRENGTH:g}")


def smooth_result(rows: np.ndarray, content: MotionClip, before: MotionClip, layout: ClipLayout) -> MotionClip:
    """Returns the content with the motion of rows, smoothed as little as it takes to be as smooth as the content.

    Only the change is smoothed: quick movements of the content remain.

    Args:
        rows: [T', D] in layout units.
        content: T frames on its own skeleton.
        before: the content as `prepare_clip` returns it, of at most T' frames.
        layout: of the rows.

    Raises:
        InputError: as `clip_from_rows`.
    """
    _check_rows(rows, before, layout)
    own = encode_clip(before, layout)
    change, limit = rows[: len(own)] - own, MAX_JITTER * _jerk(content)
    result = content
    for seconds in SMOOTH_SECONDS:
        smoothed = gaussian_filter(change, seconds * LAYOUT_FPS) if seconds else change
        result = carry_over(content, before, clip_from_rows(own + smoothed, before, layout))
        if _jerk(result) <= limit:
            break
    return result


def clip_from_rows(rows: np.ndarray, content: MotionClip, layout: ClipLayout) -> MotionClip:
    """Returns the motion that rows describe, with rigid bones, beginning at the content's first root.

    Args:
        rows: [T, D] or more, in layout units.
        content: T frames at 60 fps on the run's skeleton: it decides what positions do not show.
        layout: of the rows.

    Raises:
        InputError: if there are fewer rows than frames, or a value is not finite.
    """
    _check_rows(rows, content, layout)
    before = clip_root(content)
    positions, root = decode_rows(np.asarray(rows[: content.num_frames], float), layout, before)
    positions[..., 1] += floor_height(content)
    initial = _follow_root(content, before, root)
    points = find_body_points(content.skeleton, content.source or "clip")
    return rotations_from_positions(content.skeleton, points, positions, initial)


def carry_over(content: MotionClip, before: MotionClip, after: MotionClip) -> MotionClip:
    """Applies what changed between two motions on another skeleton to the content, part by part.

    Args:
        content: T frames on its own skeleton, at its own frame rate.
        before: the content on the other skeleton, at another frame rate.
        after: what became of it there.
    """
    source, own = (humanoid_of(clip.skeleton, content.source or "clip") for clip in (before, content))
    (old_joints, old), (new_joints, new) = (
        forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations) for clip in (before, after)
    )
    scale = leg_length_of(content.skeleton, own) / leg_length_of(before.skeleton, source)
    times = np.minimum(np.arange(content.num_frames) * (before.fps / content.fps), before.num_frames - 1)
    shift = interpolate(scale * (new_joints - old_joints)[:, source.hips], times)
    changes = interpolate_rotations(quat_multiply(new, quat_conjugate(old)), times)
    turns = part_turns(changes, source, own)
    joints, world = forward_kinematics(content.skeleton, content.root_positions, content.rotations)
    local = _turn_joints(content, world, turns, own.hips)
    at_origin, _ = forward_kinematics(content.skeleton, np.zeros_like(content.root_positions), local)
    return replace(content, root_positions=joints[:, own.hips] + shift - at_origin[:, own.hips], rotations=local)


def _turn_joints(content: MotionClip, world: np.ndarray, turns: dict[int, np.ndarray], hips: int) -> np.ndarray:
    """Returns the local rotations [T, J, 4] of a clip whose joints are turned in the world, each before its own.

    Joints without a turn keep their local rotation, except that a root above the hips turns with them.

    Args:
        content: T frames.
        world: [T, J, 4] its world rotations.
        turns: joint -> [T, 4] of the parts.
        hips: index of the hips.
    """
    turned, local = world.copy(), content.rotations.copy()
    for joint, parent in enumerate(content.skeleton.parents.tolist()):
        if joint in turns or parent < 0:
            turned[:, joint] = quat_multiply(turns.get(joint, turns[hips]), world[:, joint])
            above = turned[:, parent] if parent >= 0 else None
            local[:, joint] = (
                turned[:, joint] if above is None else quat_multiply(quat_conjugate(above), turned[:, joint])
            )
        else:
            turned[:, joint] = quat_multiply(turned[:, parent], local[:, joint])
    return np.where(np.sum(local * content.rotations, axis=-1, keepdims=True) < 0, -local, local)


def hold_feet(clip: MotionClip, content: MotionClip) -> MotionClip:
    """Returns the clip with feet that do not slide where the content's are in contact.

    Args:
        clip: T frames.
        content: T frames on the same skeleton.
    """
    roles = content.skeleton.roles or _roles_of_legs(humanoid_of(content.skeleton, content.source or "clip"))
    positions, _ = forward_kinematics(content.skeleton, content.root_positions, content.rotations)
    contacts = foot_contacts(positions, roles, content.fps, max_speed=HELD_SPEED)
    return plant_feet(clip, contacts, positions[:, foot_joints(roles), 1])


def _check_rows(rows: np.ndarray, content: MotionClip, layout: ClipLayout) -> None:
    source, count = content.source or "clip", content.num_frames
    if rows.ndim != 2 or len(rows) < count or rows.shape[1] != layout.size:
        raise InputError(source, "rows", f"shape {rows.shape}", f"must be at least {count} of {layout.size} numbers")
    if not np.isfinite(rows).all():
        raise InputError(source, "rows", "not finite", "must be finite numbers; the transfer diverged")


def _jerk(clip: MotionClip) -> float:
    """Returns the mean length of the third difference of joint positions, in metres; 0 for fewer than four frames."""
    positions, _ = forward_kinematics(clip.skeleton, clip.root_positions, clip.rotations)
    jerks = np.linalg.norm(np.diff(positions, n=3, axis=0), axis=-1)
    return float(jerks.mean()) if jerks.size else 0.0


def _roles_of_legs(body: HumanoidMap) -> Roles:
    """Returns roles of a body without arms or head, which contacts do not need; the hips stand in for these."""
    feet = [limb(body, side, "foot", "toe") for side in SIDES]
    left, right = ((ankle, ankle if toe is None else toe) for ankle, toe in feet)
    other = body.hips
    return Roles(other, body.left_thigh, body.right_thigh, other, other, left, right, other, other, other)


def _follow_root(clip: MotionClip, before: Root, after: Root) -> MotionClip:
    """Returns a clip turned and moved on the ground in every frame as its root is."""
    turn = quat_from_yaw(after.yaw - before.yaw)
    rotations = clip.rotations.copy()
    rotations[:, 0] = quat_multiply(turn, rotations[:, 0])
    offset = clip.root_positions.copy()
    offset[:, [0, 2]] -= before.positions
    positions = quat_rotate(turn, offset)
    positions[:, [0, 2]] += after.positions
    return replace(clip, root_positions=positions, rotations=rotations)
